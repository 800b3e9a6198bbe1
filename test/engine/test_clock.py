"""The clock, alone: paused, ahead, back, set back."""

import pytest

from vsensor_ros.engine.clock import Clock

PERIOD = 10_000_000  # ns, of the bank and of the sensors
SECOND = 10**9


def test_a_clock_that_only_runs():
    c = Clock(10 * SECOND, False)
    times = iter([100 * SECOND, 101 * SECOND, 101 * SECOND, 111 * SECOND])
    assert [c.look(next(times)) for _ in range(4)] == [0] * 4
    assert c.now == 111 * SECOND and c.lasting() == 11 * SECOND and not c.jumps


@pytest.mark.parametrize('simulated, back, way', [
    (True, 1, 'backwards'), (False, SECOND, 'backwards'), (False, SECOND - 1, 'stood still'),
    (False, 11_000_000, 'stood still'), (False, 9_000_000, None)])
def test_a_clock_set_back(simulated, back, way):
    t = 100 * SECOND
    c = Clock(10 * SECOND, simulated)
    times = iter([t, t + SECOND, t + SECOND - back, t + SECOND - back + 1, t + 2 * SECOND])
    jumps = [c.look(next(times)) for _ in range(4)]
    if way == 'backwards':
        assert jumps == [0, 0, -back, 0] and c.now == t + SECOND - back + 1
        assert c.lasting() == SECOND + 1  # what has lasted a second has lasted a second
    else:
        assert jumps == [0] * 4 and c.now == t + SECOND and c.lasting() == SECOND
    assert dict(c.jumps) == ({way: 1} if way else {})
    c.look(next(times))
    assert c.now == t + 2 * SECOND


def test_a_clock_that_jumps_ahead():
    t = 100 * SECOND
    c, times = Clock(10 * SECOND, False), iter([t, t + SECOND, t + 12 * SECOND])
    assert [c.look(next(times)) for _ in range(3)] == [0, 0, 11 * SECOND]
    assert c.lasting() == SECOND and c.lasting(c.now - PERIOD) == SECOND - PERIOD
    assert c.jumps == {'forwards': 1}


def test_simulated_time_that_has_not_begun_or_is_paused():
    c, times = Clock(10 * SECOND, True), iter([None, 5, None, None, 7])
    seen = []
    for _ in range(5):
        assert c.look(next(times)) == 0
        seen.append(c.now)
    assert seen == [0, 5, 5, 5, 7] and c.lasting() == 2
