"""Isolated sensors: whoever has read one forgets it, whatever arrives when."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.bank import Bank

MS = 1_000_000
A, B = (('va',), 'va'), (('vb',), 'vb')


@pytest.fixture(scope='module')
def two(bench):
    """Make two lags z' = -2 z + 2 reading: va of a alone, vb of b that starts from a."""
    names = ('a', 'b')
    return bench.design(
        bench.virtual_sensor([[-2.0]], [[2.0, 0.0]], healthy=names, fault_set=('va',)),
        bench.virtual_sensor([[-2.0]], [[0.0, 2.0]], healthy=names, fault_set=('vb',),
                             z0_gain=[[3.0, 0.0]]), names=('va', 'vb', 'a', 'b'))


def run(bank, times, a=1.0, b=1.0):
    for now in times:
        for name, value in (('a', a), ('b', b)):
            bank.take(name, now * MS, value)
        bank.advance(now * MS)


def test_who_has_read_it_stops_and_starts_anew_when_it_is_back(two):
    bank = Bank(two, 100)
    run(bank, range(0, 4000, 10), a=7.0)
    assert bank.ready(*A) and bank.ready(*B)
    bank.distrust({'a'})
    for key in (A, B):  # vb started from it
        assert bank.estimate(*key) is None and bank.deviation(*key) == np.inf
        assert (bank.ready(*key), bank.waiting(*key)) == (False, np.inf)
        assert str(bank.why_not(*key)) == 'a is isolated'
    run(bank, range(4000, 5000, 10), a=99.0)
    assert str(bank.take('a', 4995 * MS, 99.0)) == 'isolated'
    assert bank.estimate(*A) is None
    assert not bank.refused
    bank.distrust(())
    assert str(bank.why_not(*A)) == 'no reading of a yet'
    assert str(bank.take('a', 4980 * MS, 99.0)) == 'isolated'  # from before it was trusted
    run(bank, range(5000, 5500, 10))
    assert bank.started(*A) == bank.started(*B) == 5000 * MS
    assert bank.estimate(*A) == pytest.approx(1 - np.exp(-2 * 0.49), abs=1e-9)  # from 0, not 99
    assert bank.estimate(*B) == pytest.approx(1 + 2 * np.exp(-2 * 0.49), abs=1e-9)
    assert not bank.ready(*A) and str(bank.why_not(*A)).startswith('converging')
    run(bank, range(5500, 9000, 10))
    assert bank.ready(*A)
    assert not bank.refused


def test_the_complete_set_is_told_and_only_known_names(two):
    bank = Bank(two, 100)
    bank.distrust({'a'})  # before anything was heard: a node that restarts in a fault
    run(bank, range(0, 500, 10))
    assert bank.estimate(*A) is None
    bank.distrust({'a', 'b'})
    bank.distrust({'b'})
    run(bank, range(500, 700, 10))
    assert bank.started(*A) == 500 * MS
    assert str(bank.why_not(*B)) == 'b is isolated'
    for names in ({'nobody'}, {'a', 'nobody'}):
        with pytest.raises(KeyError, match='nobody: no such sensor'):
            bank.distrust(names)
    assert bank.started(*A) == 500 * MS


def test_it_outlives_jumps_of_the_clock(two):
    bank = Bank(two, 100, jump_ahead=2.0)
    run(bank, range(10_000, 11_000, 10))
    bank.distrust({'a'})
    run(bank, range(20_000, 20_500, 10))
    run(bank, range(5_000, 5_500, 10))
    assert bank.jumps == {'forwards': 1, 'backwards': 1}
    assert bank.estimate(*A) is None and str(bank.why_not(*A)) == 'a is isolated'
    bank.distrust(())
    run(bank, range(5_500, 5_600, 10))
    assert bank.started(*A) == 5500 * MS


def test_what_was_read_before_it_is_trusted_is_refused_after_a_reset_too(two):
    bank = Bank(two, 10)
    run(bank, range(0, 5000, 100))
    bank.distrust({'a'})
    run(bank, range(5000, 6000, 100), a=99.0)
    bank.distrust(())  # 80 ms after the last tick
    assert str(bank.take('a', 5970 * MS, 99.0, 5980 * MS)) == 'isolated'
    bank.reset()
    bank.distrust(())
    assert str(bank.take('a', 5980 * MS, 99.0, 5990 * MS)) == 'isolated'
    assert bank.take('a', 6000 * MS, 1.0, 6000 * MS) is None
    bank.reset()
    assert str(bank.take('a', 5990 * MS, 99.0)) == 'isolated'  # though it has been read since
    run(bank, range(1000, 2000, 100))  # a clock that was set back
    assert bank.started(*A) <= 1100 * MS


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@given(data=st.data())
def test_no_order_of_arrival_brings_a_bad_reading_back(bench, two, data):
    """Isolate a at some time and trust it later: all else is as if its bad readings never came."""
    isolated, trusted = data.draw(st.integers(20, 60)) * 10, data.draw(st.integers(61, 90)) * 10
    bank, clean = Bank(two, 100), Bank(two, 100)
    queue = []
    for stamp in range(0, 1200, data.draw(st.integers(4, 30))):
        for name in 'ab':
            queue.append((stamp + data.draw(st.integers(0, 150)), stamp, name))
    queue.sort()
    for now in range(0, 1500, 10):
        for each in (bank, clean):
            if now == isolated:
                each.distrust({'a'})
            if now == trusted:
                each.distrust(())
        for arrival, stamp, name in queue:
            if now - 10 < arrival <= now:
                # so that both run on one grid, the first one is the same
                bad = name == 'a' and 0 < stamp < trusted - 10
                bank.take(name, stamp * MS, 1e6 if bad else np.sin(stamp / 100))
                clean.take(name, stamp * MS, np.sin(stamp / 100))
        for each in (bank, clean):
            each.advance(now * MS)
        if isolated <= now < trusted:
            assert bank.estimate(*A) is None and bank.estimate(*B) is None
        elif now >= trusted:
            value = bank.estimate(*A)
            assert value is None or abs(value) < 2.0
            assert value == clean.estimate(*A)
            assert bank.started(*A) is None or bank.started(*A) >= (trusted - 10) * MS
    assert bank.estimate(*A) is not None


def test_a_sensor_of_its_own_max_age_is_silent_after_it(two):
    bank = Bank(two, 100, max_age={'a': 0.2, 'b': 1.0})
    assert not bank.silent('a', 10_000 * MS)  # nothing began yet
    bank.advance(0)
    assert not bank.silent('a', 200 * MS) and bank.silent('a', 201 * MS)
    run(bank, range(10, 110, 10))
    assert not bank.silent('a', 300 * MS) and bank.silent('a', 301 * MS)
    assert not bank.silent('b', 1100 * MS) and bank.silent('b', 1101 * MS)
    for now in range(110, 1500, 10):
        bank.advance(now * MS)
        assert (bank.estimate(*A) is None) == (now > 300)
        assert (bank.estimate(*B) is None) == (now > 1100)
    bank.take('a', 1500 * MS, float('nan'))
    assert bank.silent('a', 1500 * MS)
    bank.distrust({'a'})  # it is still heard
    bank.take('a', 1500 * MS, 1.0)
    assert not bank.silent('a', 1510 * MS)


@pytest.mark.parametrize(('more', 'said'), [
    ({'max_age': {'nobody': 1.0}}, 'max_age: nobody is no sensor'),
    ({'max_age': {'a': 0.0}}, 'max_age: 0.0 is not a time'),
    ({'max_age': float('nan')}, 'max_age: nan is not a time'),
    ({'jump_ahead': -1.0}, 'jump_ahead: -1.0 is not a time')])
def test_refuses_times_that_are_none(two, more, said):
    with pytest.raises(ValueError, match=said):
        Bank(two, 100, **more)
