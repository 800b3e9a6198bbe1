"""The benchmark counts a false alarm once, however often it is told."""

from benchmark.isolator_run import Alarms, CLEARED


def test_an_alarm_that_stands_is_one_until_somebody_clears_it():
    alarms = Alarms()
    assert not alarms.take(1.0, 7, 'suspected')
    assert not alarms.take(2.0, 7, 'blamed')
    assert not alarms.take(3.0, 7, 'model')
    assert alarms.take(1.0 + CLEARED, 7, 'model')
    assert not alarms.take(2.0 + CLEARED, 7, 'model')
    assert not alarms.take(3.0 + CLEARED, 7, '')
    assert not alarms.take(4.0 + CLEARED, 8, '')
    assert alarms.all() == [(1.0, 7, 'blamed'), (2.0 + CLEARED, 7, 'model')]
