"""The clock of the node in a replacer: paused, ahead, back, set back."""

import time

import numpy as np
import pytest
from sensor_msgs.msg import Range

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns, of the bank and of the sensors
SECOND = 10**9
START = 1_000_000_000_000  # ns


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
    assert 'nothing comes' in r.why('y1')
    count, start = len(heard), r.now
    r.step(*r.healthy(y1=0.75, y2=0.0), periods=10)
    assert r.spin_until(lambda: len(heard) > count)
    fresh = r.stamps(heard)[count:]
    assert start < fresh[0] <= fresh[-1] < start + SECOND and np.all(np.diff(fresh) > 0)
    assert r.values(heard)[-1] == 1.5
    after = r.told()['y2']
    assert r.replacer.snapshot().jumps == {'backwards': 1}
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
    assert r.replacer.snapshot().jumps == {'forwards': 1}
    told = r.told()['y2']
    assert told.source == 'virtual' and told.recovering_s < 1.0  # a jump is no dwell
    assert r.values(heard)[-1] == 0.5 and np.all(np.diff(r.stamps(heard)) > 0)


def test_a_clock_that_pauses_changes_nothing(rig, parameters, monkeypatch):
    def told():
        """Return everything as text, in which NaN is NaN."""
        return repr(r.told())
    r = rig(parameters)
    monkeypatch.setattr('vsensor_ros.engine.state.STILL', np.inf)  # what it is for: see below
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(y1=0.75), periods=5)
    before, state = len(heard), told()
    r.spin(0.7)  # longer than max_age, by other clocks
    assert len(heard) == before and told() == state
    r.step(*r.healthy(y1=0.75), periods=2)
    assert len(heard) == before + 2 and r.values(heard)[-1] == 1.5
    assert r.replacer.snapshot().jumps == {}


def test_a_wall_clock_set_back(rig, parameters, capfd, monkeypatch):
    away = 0
    monkeypatch.setattr('vsensor_ros.node.replacer.time.time_ns',
                        lambda: time.clock_gettime_ns(time.CLOCK_REALTIME) + away)
    r = rig(parameters, sim_time=False)
    r.spin()
    before = r.replacer.engine.now
    away = -800_000_000
    r.spin()
    assert r.replacer.engine.now >= before and r.replacer.snapshot().jumps == {'stood still': 1}
    assert 'clock' not in capfd.readouterr().err
    away = -5 * SECOND
    r.spin()
    assert before - 5 * SECOND < r.replacer.engine.now <= time.time_ns()  # which is patched
    assert r.replacer.snapshot().jumps == {'stood still': 1, 'backwards': 1}
    assert 'the clock jumped back by' in capfd.readouterr().err
    ticks = r.replacer.snapshot().ticks
    assert r.spin_until(lambda: r.replacer.snapshot().ticks > ticks)  # it goes on


def test_a_clock_that_stands_still_is_said(rig, parameters):
    r = rig(parameters)
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    r.step(*r.healthy(), periods=5)
    assert r.told()['y2'].source == 'virtual'
    told = r.replacer.engine.snapshot(time.monotonic() + 3.0).channels[1]
    assert told.source == 'none'
    assert str(told.reason).startswith('the clock stands still: no /clock since 3.')
    assert str(told.reason).endswith('; nothing goes out')
    before = r.replacer.snapshot().still
    r.spin(0.3)
    assert r.replacer.snapshot().still >= before + 0.3
    for _ in range(20):  # a busy machine may hold up even this
        r.step(*r.healthy())
        if r.replacer.snapshot().still < before + 0.3 and r.told()['y2'].source == 'virtual':
            return
    pytest.fail('the clock moves, and nobody says so')


@pytest.mark.parametrize('began', [False, True])
def test_a_clock_that_does_not_move_withholds_nothing(rig, parameters, began):
    """With use_sim_time, drivers by the wall clock, and nobody who moves /clock."""
    r = rig(parameters, clock=began)
    heard = r.listen(RANGE, '/y2')
    start = r.now if began else time.time_ns() // PERIOD * PERIOD
    for i in range(300):
        r.send(start + i * PERIOD, i)
    assert r.spin_until(lambda: len(heard) == 300)
    assert r.values(heard) == list(range(300))
    told = r.told()['y2']
    assert told.source == 'real' and 'not sent on' not in str(told.counts)
    assert bool(told.counts) == began  # what lies ahead of a clock that stands still is not learnt
    r.now = START if not began else r.now + 300 * PERIOD
    r.step()
    r.step(*r.healthy(y1=0.75), periods=20)
    r.isolate('y2')
    before = len(heard)
    r.step(*r.healthy(y1=0.75), periods=5)
    assert r.spin_until(lambda: len(heard) >= before + 5) and r.values(heard)[-1] == 1.5
    assert r.stamps(heard)[-1] == r.now


def test_a_busy_computer_withholds_and_refuses_nothing(rig, parameters):
    """Half a second of messages is taken in one round, whose clock was looked at before."""
    r = rig(parameters, sim_time=False)
    heard = r.listen(RANGE, '/y2')
    publisher = r.publisher(Range, '/y2_raw')
    r.spin()
    look, r.replacer.engine.look = r.replacer.engine.look, lambda now, steady: None
    for i in range(100):
        message = r.reading(float(i))
        message.header.stamp = r.node.get_clock().now().to_msg()
        publisher.publish(message)
        time.sleep(0.005)
    assert r.spin_until(lambda: len(heard) == 100)
    r.replacer.engine.look = look
    r.spin()
    assert r.values(heard) == list(range(100)) and not r.told()['y2'].counts


def test_who_spoke_before_simulated_time_began_has_not_been_silent_since(rig, parameters):
    """A replacer that joins a running simulation: readings are there sooner than the time."""
    r = rig({**parameters, 'silent_sensor': 'replace', 'recovery.dwell': 2.0}, clock=False)
    heard = r.listen(RANGE, '/y2')
    for _ in range(3):  # at 1000 s of simulated time, which nobody has told us yet
        r.now += PERIOD
        for name in ('y1', 'y2', 'y3'):
            r.send(r.now, 0.5, f'/{name}_raw')
    r.step()  # now somebody does; the next readings come a period later
    assert r.replacer.snapshot().faulty == ()
    r.step(*r.healthy(), periods=20)
    assert r.replacer.snapshot().faulty == ()
    assert {c.source for c in r.told().values()} == {'real'}
    assert r.spin_until(lambda: len(heard) == 23)  # nothing was held back
    rest = r.healthy()
    r.step(rest[0], rest[2], periods=55)  # one that falls silent afterwards is
    assert r.replacer.snapshot().faulty == ('y2',)


def test_nobody_is_silent_because_the_clock_jumped_ahead(rig, parameters):
    r = rig({**parameters, 'silent_sensor': 'replace', 'max_jump': 1.0})
    r.step(*r.healthy(), periods=5)
    r.now += 60 * SECOND
    r.step(periods=10)
    assert r.replacer.snapshot().jumps == {'forwards': 1}
    assert r.replacer.snapshot().faulty == ()
    r.step(periods=45)  # but who says nothing for max_age after it is
    assert r.replacer.snapshot().faulty == ('y1', 'y2', 'y3')
