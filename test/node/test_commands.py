"""Commands at the topic: those of another clock, those that end, and those that say nothing."""

import math
from pathlib import Path
import sys

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TwistStamped
import pytest
from std_msgs.msg import Float64

from vsensor_ros.node.accessor import put_stamp

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, machines

RANGE, SECOND, PERIOD = 'sensor_msgs/msg/Range', 10**9, 10_000_000
TWIST = {'commands.u1.type': 'geometry_msgs/msg/TwistStamped',
         'commands.u1.field': 'twist.linear.x'}


@pytest.fixture
def machine(parameters):
    yield from machines(parameters)


def command(r, value, lead):
    """Send a command whose stamp is so much [ns] ahead of the clock."""
    message = TwistStamped()
    message.twist.linear.x = value
    put_stamp(message, r.now + lead)
    before = r.taken['/u1']
    r.publisher(TwistStamped, '/u1').publish(message)
    assert r.spin_until(lambda: r.taken['/u1'] > before)


def after(seconds, u, x):
    """Return where x' = u - x goes from x."""
    return u + (x - u) * math.exp(-seconds)


def source(r, name):
    return r.told()[name].source


@pytest.mark.parametrize('lead', [0.3, 3600.0, -5.0, -900.0])
def test_one_from_another_clock_acts_when_it_arrives(rig, parameters, lead):
    r = rig({**parameters, **TWIST})
    heard = r.listen(RANGE, '/y1')
    r.step(*r.healthy(), periods=3)
    command(r, 1.0, 0)
    r.isolate('y1')
    for _ in range(20):
        r.step(*r.healthy())
        command(r, 1.0, 0)
    jump = r.now
    for _ in range(80):  # longer than max_age
        command(r, 2.0, round(lead * SECOND))
        r.step(*r.healthy())
    x = after(0.2, 1.0, 0.25)
    assert r.spin_until(lambda: r.stamps(heard[-1:]) == [r.now])
    assert r.values(heard)[-1] == pytest.approx(after((r.now - jump) / SECOND, 2.0, x), abs=2e-5)
    state, = r.replacer.snapshot().commands
    side = 'ahead of' if lead > 0.0 else 'behind'
    assert f'{abs(lead):.3g} s {side} the clock' in str(state.trouble)
    assert state.from_arrival == 80 and state.lead == pytest.approx(lead) and not state.counts


def test_another_clock_is_seen_until_it_is_mended(machine):
    m = machine(**{key.replace('.', '__'): value for key, value in TWIST.items()})
    lead = [300_000_000]
    publisher = m.engineer.create_publisher(TwistStamped, '/u1', 10)

    def send():
        message = TwistStamped()
        put_stamp(message, m.engineer.get_clock().now().nanoseconds + lead[0])
        publisher.publish(message)
    m.engineer.create_timer(0.02, send)
    told = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    people = m.listen(DiagnosticArray, '/diagnostics')

    def loop():
        """Return what both say of the loop, once they do."""
        assert m.spin_until(lambda: told and people)
        status = next(s for s in told[-1].status if s.name == 'replacer')
        report = next(s for s in people[-1].status if s.name == 'replacer: the loop')
        return status, report, {v.key: v.value for v in status.values}
    assert m.spin_until(lambda: 'ahead of the clock' in loop()[1].message)
    status, report, facts = loop()
    assert report.level == DiagnosticStatus.WARN
    assert facts['command_u1'].startswith('u1: its stamps are ')
    assert int(facts['command_u1_from_arrival']) > 0 and facts['command_u1_not_used'] == '0'
    assert m.spin_until(lambda: m.logged('so it counts from its arrival'))
    lead[0] = 0
    assert m.spin_until(lambda: 'ahead' not in loop()[1].message)
    facts = loop()[2]
    assert facts['command_u1'] == 'OK' and float(facts['command_u1_lead']) < 0.1
    assert int(facts['command_u1_from_arrival']) > 0


def driven(rig, parameters, **more):
    """Return a rig whose y1 is virtual, commanded 1.0 at each period up to now."""
    r = rig({**parameters, **{f'commands.u1.{key}': value for key, value in more.items()}})
    heard = r.listen(RANGE, '/y1')
    r.step(*r.healthy(), periods=3)
    r.command(1.0)
    r.isolate('y1')
    for _ in range(20):
        r.step(*r.healthy())
        r.command(1.0)
    assert source(r, 'y1') == 'virtual'
    return r, heard, after(0.2, 1.0, 0.25)


@pytest.mark.parametrize('more', [{}, {'at_end': 'invalid', 'max_age': 0.3}, {'max_age': 0.3}])
def test_without_its_command_there_is_no_estimate_until_it_is_back(rig, parameters, more):
    r, heard, x = driven(rig, parameters, **more)
    age = more.get('max_age', 0.5)
    last = r.now + round(age * SECOND)
    r.step(*r.healthy(), periods=round(age * 100))
    assert source(r, 'y1') == 'virtual'
    assert r.spin_until(lambda: r.stamps(heard[-1:]) == [r.now])
    assert r.values(heard)[-1] == pytest.approx(after(age, 1.0, x), abs=2e-5)
    r.step(*r.healthy(), periods=60)
    assert source(r, 'y1') == 'none' and max(r.stamps(heard)) == last
    assert 'u1 ended ' in r.why('y1') and 'commands.u1.at_end' in r.why('y1')
    r.command(1.0)  # all begins anew
    r.step(*r.healthy(), periods=5)
    assert source(r, 'y1') == 'virtual'
    assert r.spin_until(lambda: r.stamps(heard[-1:]) == [r.now])
    assert r.values(heard)[-1] == pytest.approx(after(0.05, 1.0, 0.25), abs=2e-5)


@pytest.mark.parametrize(('at_end', 'u'), [('hold', 1.0), (0.0, 0.0), ('-0.5', -0.5), (2, 2.0)])
def test_what_counts_at_its_end_can_be_said(rig, parameters, at_end, u):
    r, heard, x = driven(rig, parameters, at_end=at_end)
    r.step(*r.healthy(), periods=120)
    assert source(r, 'y1') == 'virtual'
    assert r.spin_until(lambda: r.stamps(heard[-1:]) == [r.now])
    assert r.values(heard)[-1] == pytest.approx(after(0.7, u, after(0.5, 1.0, x)), abs=2e-5)


def test_a_set_point_that_comes_once_holds(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y1')
    r.step(*r.healthy(), periods=3)
    r.command(1.0)
    r.isolate('y1')
    r.step(*r.healthy(), periods=150)
    assert r.spin_until(lambda: r.stamps(heard[-1:]) == [r.now])
    assert r.values(heard)[-1] == pytest.approx(after(1.5, 1.0, 0.25), abs=2e-5)


@pytest.mark.parametrize('useless', [Float64(data=math.nan), Float64(data=1e300), b'garbage'])
@pytest.mark.parametrize('periodic', [False, True])
def test_what_says_nothing_keeps_nothing_alive(rig, parameters, useless, periodic):
    if periodic:
        r, heard, _ = driven(rig, parameters)
    else:
        r = rig(parameters)
        heard = r.listen(RANGE, '/y1')
        r.command(1.0)
        r.step(*r.healthy(), periods=3)
        r.isolate('y1')
    for _ in range(60):
        before = r.taken['/u1']
        r.publisher(Float64, '/u1').publish(useless)
        assert r.spin_until(lambda due=before: r.taken['/u1'] > due)
        r.step(*r.healthy())
    assert source(r, 'y1') == 'none' and max(r.stamps(heard)) < r.now
    assert 'nothing of u1 could be used' in r.why('y1')
    state, = r.replacer.snapshot().commands
    assert sum(state.counts.values()) == 60 and 'is not used' in str(state.trouble)


@pytest.mark.parametrize('lead', [0.3, 30.0, -5.0])
def test_no_estimate_is_made_of_readings_of_another_clock(rig, parameters, lead):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')  # whose virtual sensor reads y1
    r.step(*r.healthy(), periods=5)
    r.isolate('y2')
    for _ in range(80):
        r.step(*r.healthy()[1:])
        r.send(r.now + round(lead * SECOND), 0.7, '/y1_raw')
    assert source(r, 'y2') == 'none' and max(r.stamps(heard)) < r.now
    told = f'{abs(lead)} s {"ahead of" if lead > 0 else "behind"} the clock of this node'
    assert f'y1 speaks, but its stamps are {told}' in r.why('y2')
    before = len(heard)
    for _ in range(53):  # it must have been ready for half a second
        r.step(*r.healthy(y1=0.6))
    assert source(r, 'y2') == 'virtual'
    assert r.spin_until(lambda: len(heard) > before) and r.values(heard)[-1] == pytest.approx(1.2)
