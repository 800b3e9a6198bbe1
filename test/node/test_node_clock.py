"""The clock of the node, alone and in a replacer: paused, ahead, back, set back."""

from dataclasses import replace
import time

import numpy as np
import pytest

from vsensor_ros.engine.clock import NodeClock

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns, of the bank and of the sensors
SECOND = 10**9


def clock(times, simulated, monkeypatch):
    """Return a clock that will show these times [ns] one after the other."""
    times = iter(times)
    monkeypatch.setattr('vsensor_ros.engine.clock.time.time_ns', lambda: next(times))
    return NodeClock(10 * SECOND, (lambda: next(times)) if simulated else None)


def test_a_clock_that_only_runs(monkeypatch):
    c = clock([100 * SECOND, 101 * SECOND, 101 * SECOND, 111 * SECOND], False, monkeypatch)
    assert [c.look() for _ in range(4)] == [0] * 4
    assert c.now == 111 * SECOND and c.lasting() == 11 * SECOND and not c.jumps


@pytest.mark.parametrize('simulated, back, way', [
    (True, 1, 'backwards'), (False, SECOND, 'backwards'), (False, SECOND - 1, 'stood still'),
    (False, 11_000_000, 'stood still'), (False, 9_000_000, None)])
def test_a_clock_set_back(simulated, back, way, monkeypatch):
    t = 100 * SECOND
    c = clock([t, t + SECOND, t + SECOND - back, t + SECOND - back + 1, t + 2 * SECOND],
              simulated, monkeypatch)
    jumps = [c.look() for _ in range(4)]
    if way == 'backwards':
        assert jumps == [0, 0, -back, 0] and c.now == t + SECOND - back + 1
        assert c.lasting() == SECOND + 1  # what has lasted a second has lasted a second
    else:
        assert jumps == [0] * 4 and c.now == t + SECOND and c.lasting() == SECOND
    assert dict(c.jumps) == ({way: 1} if way else {})
    c.look()
    assert c.now == t + 2 * SECOND


def test_a_clock_that_jumps_ahead(monkeypatch):
    t = 100 * SECOND
    c = clock([t, t + SECOND, t + 12 * SECOND], False, monkeypatch)
    assert [c.look() for _ in range(3)] == [0, 0, 11 * SECOND]
    assert c.lasting() == SECOND and c.lasting(c.now - PERIOD) == SECOND - PERIOD
    assert c.jumps == {'forwards': 1}


def test_simulated_time_that_has_not_begun_or_is_paused(monkeypatch):
    c = clock([None, 5, None, None, 7], True, monkeypatch)
    seen = []
    for _ in range(5):
        assert c.look() == 0
        seen.append(c.now)
    assert seen == [0, 5, 5, 5, 7] and c.lasting() == 2


def test_a_clock_that_goes_back_starts_anew(rig, parameters, capfd):
    r = rig({**parameters, 'recovery.dwell': 0.1, 'time_constant': 0.05})
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(y1=0.75, y2=0.0), periods=10)
    before = r.told()['y2']
    r.now -= SECOND
    r.step()
    assert 'the clock jumped back by 1.0 s' in capfd.readouterr().err
    assert 'nothing comes' in r.replacer.streams[0].why_silent('y1', r.now)
    count, start = len(heard), r.now
    r.step(*r.healthy(y1=0.75, y2=0.0), periods=10)
    assert r.spin_until(lambda: len(heard) > count)
    fresh = r.stamps(heard)[count:]
    assert start < fresh[0] <= fresh[-1] < start + SECOND and np.all(np.diff(fresh) > 0)
    assert r.values(heard)[-1] == 1.5
    after = r.told()['y2']
    assert r.replacer.health().jumps == {'backwards': 1}
    # a second was taken out of the clock, not of what lasts; one step more fell into the jump
    assert after.virtual_s - before.virtual_s == pytest.approx(0.1, abs=1e-9)
    assert after.since_s < 0.3
    r.isolate()
    r.step(*r.healthy(), periods=9)
    assert r.told()['y2'].source == 'virtual'  # the dwell of 0.1 s is not over
    r.step(*r.healthy(), periods=2)
    assert r.told()['y2'].source == 'real'


def test_a_clock_that_jumps_ahead_starts_anew(rig, parameters, capfd):
    r = rig({**parameters, 'max_jump': 5.0, 'recovery.dwell': 10.0})
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(y1=0.75, y2=0.0), periods=5)
    r.isolate()
    r.step(*r.healthy(y1=0.75, y2=0.0), periods=2)
    r.now += 60 * SECOND
    r.step(*r.healthy(y1=0.25, y2=0.0), periods=5)
    assert 'the clock jumped ahead by 60.0 s' in capfd.readouterr().err
    assert r.replacer.health().jumps == {'forwards': 1}
    told = r.told()['y2']
    assert told.source == 'virtual' and told.recovering_s < 1.0  # a jump is no dwell
    assert r.values(heard)[-1] == 0.5 and np.all(np.diff(r.stamps(heard)) > 0)


def test_a_clock_that_pauses_changes_nothing(rig, parameters, monkeypatch):
    def told():
        """Return what does not depend on how fast this machine is, as text: NaN is not NaN."""
        return repr([replace(state, rate_hz=0.0) for state in r.told().values()])
    r = rig(parameters)
    monkeypatch.setattr(r.replacer, 'clock_age', lambda: 0.0)  # what it is told for: below
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(y1=0.75), periods=5)
    before, state = len(heard), told()
    r.spin(0.7)  # longer than max_age, by other clocks
    assert len(heard) == before and told() == state
    r.step(*r.healthy(y1=0.75), periods=2)
    assert len(heard) == before + 2 and r.values(heard)[-1] == 1.5
    assert r.replacer.health().jumps == {}


def test_a_wall_clock_set_back(rig, parameters, capfd, monkeypatch):
    away = 0
    monkeypatch.setattr('vsensor_ros.engine.clock.time.time_ns',
                        lambda: time.clock_gettime_ns(time.CLOCK_REALTIME) + away)
    r = rig(parameters, sim_time=False)
    r.spin()
    before = r.replacer.clock.now
    away = -800_000_000
    r.spin()
    assert r.replacer.clock.now >= before and r.replacer.health().jumps == {'stood still': 1}
    assert 'clock' not in capfd.readouterr().err
    away = -5 * SECOND
    r.spin()
    assert before - 5 * SECOND < r.replacer.clock.now <= time.time_ns()  # which is patched
    assert r.replacer.health().jumps == {'stood still': 1, 'backwards': 1}
    assert 'the clock jumped back by' in capfd.readouterr().err
    ticks = r.replacer.pace.ticks
    assert r.spin_until(lambda: r.replacer.pace.ticks > ticks)  # it goes on


def test_a_clock_that_stands_still_is_said(rig, parameters, monkeypatch):
    r = rig(parameters)
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    assert r.told()['y2'].source == 'virtual'
    moved = r.replacer.clock_age
    monkeypatch.setattr(r.replacer, 'clock_age', lambda: 3.0 + moved())
    told = r.told()['y2']
    assert told.source == 'none'
    assert told.reason == 'the clock stands still: no /clock since 3.0 s; nothing goes out'
    monkeypatch.undo()
    before = r.replacer.clock_age()
    r.spin(0.3)
    assert r.replacer.clock_age() >= before + 0.3
    for _ in range(20):  # a busy machine may hold up even this
        r.step(*r.healthy())
        if r.replacer.clock_age() < before + 0.3 and r.told()['y2'].source == 'virtual':
            return
    pytest.fail('the clock moves, and nobody says so')
