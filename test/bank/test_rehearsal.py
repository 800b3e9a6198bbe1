"""What is measured beside a healthy sensor, from the first samples on, and what it says later."""

import numpy as np
import pytest

from vsensor_ros.bank import Bank
from vsensor_ros.observers import Noise

MS = 1_000_000
KEY = (('y1',), 'y1')


@pytest.fixture
def lag(bench):
    """Make what stands in for y1 = y2: a lag of it, and its bank."""
    def build(rate=20.0, **more):
        v = bench.virtual_sensor([[-rate]], [[rate]], **{'start': np.eye(1), **more})
        return Bank(bench.design(v), 100)
    return build


def test_what_a_fault_did_since_its_onset_is_no_measure(lag):
    """It was found late: by then it was believed to be what the virtual sensor errs by."""
    found = {}
    for onset in (None, 30_000 * MS):
        bank = lag()
        follow(bank, range(0, 30_000, 10), 0.0)
        healthy = bank.deviation(*KEY)
        follow(bank, range(30_000, 45_000, 10), 5.0)
        bank.distrust({'y1'}, onsets={} if onset is None else {'y1': onset})
        found[onset] = bank.deviation(*KEY)
    assert found[None] > 1.0
    assert found[30_000 * MS] < 1.5 * healthy


def follow(bank, times, y1, y2=0.0, noise=0.1, seed=0, asked=True):
    """Let y1 and y2 say these at times [ms]; return by how much the estimate is above y1's."""
    rng, found = np.random.default_rng(seed), []
    for now in times:
        for name, mean in (('y1', y1), ('y2', y2)):
            bank.take(name, now * MS, mean + noise * rng.standard_normal())
        bank.advance(now * MS)
        found.append((bank.estimate(*KEY) - y1, bank.deviation(*KEY)))
    return np.array(found).T


def test_a_start_that_was_worse_than_stated_counts_until_there_is_better(lag):
    bank = lag(1.0, start=0.01 * np.eye(1), noise=Noise(0.02, 0.0, False))  # it is off by 10 sd
    error, deviation = follow(bank, range(0, 25_000, 10), 1.0, 1.0, noise=0.02)
    assert bank.warm_up(*KEY) < 2.0
    assert (np.abs(error) > 2 * deviation)[:200].any()  # or there is nothing to show
    for start, end in ((250, 500), (500, 1000), (1000, 2500)):
        assert (np.abs(error) <= 2 * deviation)[start:end].mean() >= 0.95
    assert deviation[260] > 3 * deviation[-1] and deviation[-1] == pytest.approx(0.02, rel=0.05)


def test_what_the_start_did_is_told_until_there_is_better(lag):
    bank = lag(1.0, start=np.eye(1), noise=Noise(0.02, 0.0, False))  # it is off by 1
    follow(bank, range(0, 4_000, 10), 1.0, 1.0, noise=0.02)
    assert bank.measured(*KEY).worst > 0.3 and bank.measured(*KEY).rms > 0.2
    follow(bank, range(4_000, 20_000, 10), 1.0, 1.0, noise=0.02)
    told = bank.measured(*KEY)
    assert told.worst < 0.1 and told.rms < 0.03 and told.seconds > 8.0


def test_a_bound_counts_while_few_were_compared(lag):
    bank = lag(noise=Noise(0.001, 0.0, False))
    _, deviation = follow(bank, range(0, 15_000, 10), 0.5, noise=0.01)
    assert deviation[100] < 0.1  # nothing is known yet
    assert 3.0 < deviation[260] < 4.0  # of one block: 7 times
    assert 0.5 < deviation[600] < 0.8 and 0.5 < deviation[-1] < 0.6


def test_a_fault_soon_after_the_start_does_not_enter(lag):
    """Two banks, in one of which y1 is wrong for nearly a second before it is isolated."""
    banks = [lag(noise=Noise(0.05, 0.0, False)) for _ in range(2)]
    for bank, fault in zip(banks, (0.0, 80.0)):
        follow(bank, range(0, 3_000, 10), 0.5)
        follow(bank, range(3_000, 3_900, 10), 0.5 + fault, seed=1)
        bank.distrust({'y1'})
        follow(bank, range(3_900, 9_000, 10), 0.5 + fault, seed=2)
    assert banks[0].deviation(*KEY) == banks[1].deviation(*KEY) < 2.0
    assert banks[0].measured(*KEY) == banks[1].measured(*KEY)
    assert banks[1].measured(*KEY).worst < 1.0


def test_what_rehearsal_showed_is_of_the_last_minute(lag):
    bank = lag(noise=Noise(0.05, 0.0, False))
    assert bank.measured(*KEY) is None and bank.measured(('y9',), 'y9') is None
    follow(bank, range(0, 65_000, 10), 0.0)
    usual = bank.measured(*KEY)
    assert usual.mean == pytest.approx(0.0, abs=0.01) and usual.rms == pytest.approx(0.1, rel=0.1)
    # of the reading's 0.1 the estimate has little: the lag's share of y2's
    assert usual.error < 0.06 and 0.3 < usual.worst < 0.6
    assert 0.93 < usual.within <= 1.0 and 59.0 < usual.seconds < 62.0
    bank.take('y1', 65_000 * MS, 30.0)  # a spike
    follow(bank, range(65_010, 70_000, 10), 0.0)
    spiked = bank.measured(*KEY)
    assert spiked.worst == pytest.approx(30.0, abs=1.0)
    assert spiked.error == pytest.approx(usual.error, rel=0.2)  # a lone one says nothing
    follow(bank, range(70_000, 135_000, 10), 0.4)
    after = bank.measured(*KEY)
    assert after.mean == pytest.approx(0.4, abs=0.02) and after.worst < 1.0
    assert after.error == pytest.approx(0.4, rel=0.1)
    assert bank.deviation(*KEY) > 0.99 * after.error
    bank.distrust({'y1'})
    follow(bank, range(135_000, 140_000, 10), 9.0)
    assert bank.measured(*KEY) == after  # nothing is compared meanwhile
