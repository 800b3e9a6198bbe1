"""What a channel says beside its virtual sensor, also while it is isolated."""

from dataclasses import replace

import numpy as np
import pytest

from vsensor_ros import Plant
from vsensor_ros.bank import Bank
from vsensor_ros.reason import Reason

MS = 1_000_000
KEY = ('y1',), 'y1'


@pytest.fixture(name='static')
def _static(bench):
    """Make a design whose y1 is what y2 says, at once, and whose y2 is what y1 says."""
    return bench.design(
        bench.virtual_sensor(np.zeros((0, 0)), [], Q=[[1.0]]),
        bench.virtual_sensor(np.zeros((0, 0)), [], Q=[[1.0]], fault_set=('y2',), healthy=('y1',)),
        bench.virtual_sensor(np.zeros((0, 0)), [], Q=[[1.0, 0.0]], channel='v', fault_set=(),
                             healthy=('y1', 'y2')), wanted=('v',))


def test_it_is_the_reading_less_the_estimate_at_its_time(static):
    """Readings on a ramp of 1/s, those of y1 too high by 5 and between the grid's times."""
    bank = Bank(static, 100)
    assert bank.residual(*KEY) is None
    for now in range(0, 1000, 10):
        bank.take('y2', now * MS, now / 1e3)
        bank.take('y1', (now + 3) * MS, now / 1e3 + 5.003)
        bank.advance(now * MS)
        if now > 10:
            assert bank.residual(*KEY) == pytest.approx(5.0, abs=1e-12)
    for _ in range(3):  # the estimate goes on, the reading stays
        now += 10
        bank.take('y2', now * MS, now / 1e3)
        bank.advance(now * MS)
        assert bank.residual(*KEY) == pytest.approx(5.0, abs=1e-12)
    assert bank.residual((), 'v') is None  # nobody reads what is wanted
    assert bank.residual(('y1', 'y2'), 'y1') is None and bank.residual(('y9',), 'y9') is None


def test_it_shows_that_an_isolated_sensor_has_recovered(static):
    bank, isolated = Bank(static, 100), Reason.of('isolated')
    for now in range(0, 3000, 10):
        fault = 7.0 if 800 <= now < 2000 else 0.0
        if now in (1000, 2500):
            bank.distrust(['y1'] if now == 1000 else [])
        bank.take('y2', now * MS, 1.0)
        said = bank.take('y1', now * MS, 1.0 + fault)
        bank.advance(now * MS)
        assert said == (isolated if 1000 <= now < 2500 else None)
        assert bank.residual(*KEY) == pytest.approx(fault)
        # who reads the isolated sensor does not run
        assert (bank.residual(('y2',), 'y2') is None) is (1000 <= now < 2500)
    assert not bank.refused


def test_the_last_reading_before_the_isolation_counts_until_there_is_a_new_one(static):
    bank = Bank(static, 100)
    for now in range(0, 110, 10):
        bank.take('y1', now * MS, 4.0)
        bank.take('y2', now * MS, 1.0)
        bank.advance(now * MS)
    bank.distrust(['y1'])
    assert bank.residual(*KEY) == 3.0
    bank.take('y2', 110 * MS, 1.0)
    bank.take('y1', 110 * MS, 1.5)
    bank.advance(110 * MS)
    assert bank.residual(*KEY) == 0.5
    assert bank.take('y1', 50 * MS, 9.0) is not None  # from before: it is not the last one
    assert bank.residual(*KEY) == 0.5
    bank.take('y2', 10_000 * MS, 1.0)
    bank.advance(10_000 * MS)
    assert bank.residual(*KEY) is None  # too long ago
    bank.reset()
    assert bank.residual(*KEY) is None


def test_a_stamp_ahead_of_the_clock_does_not_shut_it_out(static):
    bank = Bank(static, 100)
    bank.distrust(['y1'])
    assert bank.take('y1', 10**18, 4.0) == Reason.of('isolated')  # before the clock is known
    for now in range(0, 50, 10):
        bank.take('y2', now * MS, 1.0)
        bank.advance(now * MS)
        bank.take('y1', now * MS, 4.0)
    assert bank.residual(*KEY) == 3.0 and not bank.refused


def test_it_sees_what_a_sensor_reads_of_commands(bench):
    plant = Plant.from_matrices([[-1.0]], [[1.0]], [[1.0], [1.0]], Cu=[[2.0], [0.0]])
    made = bench.design(
        bench.virtual_sensor(np.zeros((0, 0)), [], Q=[[1.0]], inputs=('u1',),
                             Qu=np.array([[2.0]])), names=plant.sensors, inputs=plant.inputs)
    bank = Bank(replace(made, Cu=plant.Cu), 100)
    bank.take('u1', 0, 3.0)
    for now in range(0, 200, 10):
        if now == 100:
            bank.distrust(['y1'])
        bank.take('y2', now * MS, 1.0)
        bank.take('y1', now * MS, 1.0 + 2.0 * 3.0 + 0.25)
        bank.advance(now * MS)
        assert bank.residual(*KEY) == pytest.approx(0.25)


@pytest.mark.slow
def test_what_is_kept_apart_changes_nothing(bench):
    """Two banks, one of which never gets what an isolated sensor says, to the last bit."""
    more = {'healthy': ('y2', 'y3')}
    made = bench.design(
        bench.virtual_sensor([[-2.0]], [[1.0, 1.0]], **more),
        bench.virtual_sensor([[-3.0]], [[1.0, 0.5]], fault_set=('y2',), healthy=('y1', 'y3')),
        bench.virtual_sensor([[-1.0]], [[1.0]], Q=[[0.3]], fault_set=('y1', 'y2'),
                             healthy=('y3',)), names=('y1', 'y2', 'y3'))
    banks, rng = [Bank(made, 100) for _ in range(2)], np.random.default_rng(3)
    faulty: set[str] = set()
    told = 0
    for tick in range(1, 2000):
        now = tick * 10 * MS
        if rng.random() < 0.02:
            faulty = {name for name in made.sensors if rng.random() < 0.4}
            for bank in banks:
                bank.distrust(faulty)
        for name in made.sensors:
            stamp, value = now - int(rng.integers(0, 4)) * 7 * MS, float(rng.normal())
            reasons = [banks[0].take(name, stamp, value)]
            if name not in faulty:
                reasons.append(banks[1].take(name, stamp, value))
                assert reasons[0] == reasons[1]
            else:
                assert reasons == [Reason.of('isolated')]
        for bank in banks:
            bank.advance(now)
        assert banks[0].time == banks[1].time and banks[0].refused == banks[1].refused
        for key in made.entries:
            one, other = ((b.estimate(*key), b.ready(*key), b.deviation(*key), b.started(*key),
                           b.disagreement(*key), b.why_not(*key)) for b in banks)
            assert one == other
            told += banks[0].residual(*key) is not None and banks[1].residual(*key) is None
    assert told > 100
