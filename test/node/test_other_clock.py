"""A driver whose stamps are of another clock is told from one that is silent."""

from pathlib import Path
import re
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from sensor_msgs.msg import Range

from vsensor_ros.node.accessor import put_stamp
from vsensor_ros.reason import Reason

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, machines

S = 10**9


@pytest.fixture
def machine(parameters):
    yield from machines(parameters)


def test_stamps_since_boot(machine):
    """What goes by the system's clock hears a driver that goes by its own."""
    m = machine()
    heard, told = m.listen(Range, '/y1'), m.listen(DiagnosticArray, '/replacer/status', KEPT)
    publishers = {name: m.engineer.create_publisher(Range, f'/{name}_raw', 10)
                  for name in ('y1', 'y2', 'y3')}
    begin = time.monotonic_ns()

    def send():
        for name, publisher in publishers.items():
            message = Range(range=1.5)
            put_stamp(message, time.monotonic_ns() - begin + 5 * S if name == 'y1'
                      else time.time_ns())
            publisher.publish(message)
    m.engineer.create_timer(0.02, send)
    assert m.spin_until(lambda: len(heard) > 10)  # as they came
    hardly = []  # what is said of y1 while all is well
    m.engineer.create_subscription(DiagnosticArray, '/diagnostics', lambda a: hardly.extend(
        s for s in a.status if s.name == 'replacer: y1' and s.level == b'\1'), 10)
    assert m.spin_until(lambda: any(
        'its stamps are of another clock' in s.message and 'time since boot' in s.message
        and 'no virtual sensor can use it' in s.message for s in hardly)), hardly

    def reserve(name):
        said = next(({v.key: v.value for v in s.values} for s in told[-1].status
                     if s.name == name), {})
        return said['source'], said['reserve'], said['reserve_reason']
    assert m.spin_until(lambda: reserve('y2')[:2] == ('real', 'not ready'))  # it reads y1 only
    assert 'its stamps are of another clock' in reserve('y2')[2]
    m.isolate('y2')  # its virtual sensor reads y1

    def reason():
        return next(({v.key: v.value for v in s.values}.get('reason', '')
                     for s in (told[-1].status if told else ()) if s.name == 'y2'), '')
    assert m.spin_until(lambda: 'its stamps' in reason()), reason()
    ago = int(reason().partition('another clock (')[2].partition(' s ')[0])
    assert abs(ago - time.time()) < 3600
    assert "behind this node's: time since boot, or of a simulation?)" in reason()
    assert 'silent' not in reason()


def state_of(r, name):
    return next(c for c in r.replacer.snapshot().channels if c.name == name)


def step(r, stamp):
    """Let all speak in time but y1, which has this stamp."""
    r.step(*[(topic, message) for topic, message in r.healthy() if topic != '/y1_raw'])
    r.send(stamp, 0.5, '/y1_raw')


@pytest.mark.parametrize('off, told', [
    (-900 * S, "of another clock (900 s behind this node's)"),
    (-2 * S, '2.0 s behind the clock of this node'),
    (30 * S, '30.0 s ahead of the clock of this node'),
    (1_795_000_000 * S,
     "of another clock (1795000000 s ahead of this node's, which is simulated)"),
])
def test_other_stamps(rig, parameters, off, told):
    r = rig(parameters)
    for _ in range(5):
        step(r, r.now + off)
    r.isolate('y2')
    assert f'y1 speaks, but its stamps are {told}' in r.why('y2')
    for _ in range(3):
        step(r, r.now + off)
    assert f'y1 speaks, but its stamps are {told}' in r.why('y2')


@pytest.mark.parametrize('off, apart', [
    (0, False), (-S // 4, False), (S // 20, False), (-2 * S, True), (30 * S, True)])
def test_stamps_that_nobody_can_use_are_told_while_all_is_well(rig, parameters, off, apart):
    r = rig(parameters)
    for _ in range(60):
        step(r, r.now + off)
    assert state_of(r, 'y1').reason is None  # it may pass
    for _ in range(200):
        step(r, r.now + off)
    state = state_of(r, 'y1')
    assert state.source == 'real' and (state.reason is not None) == apart
    if apart:
        assert state.reason.code == 'input of another clock'
        assert state.reason.fact('seconds') == pytest.approx(off / S, abs=0.05)
        assert state_of(r, 'y2').reserve.code == 'input of another clock'
    for _ in range(10):
        step(r, r.now)
    assert state_of(r, 'y1').reason is None


@pytest.mark.parametrize('off', [0, -900 * S, 30 * S])
def test_silence_is_counted_from_the_last_message(rig, parameters, off):
    r = rig(parameters)
    for _ in range(5):
        step(r, r.now + off)
    r.isolate('y2')
    r.step(*r.healthy()[1:], periods=120)  # it is said anew now and then
    assert 0.5 <= float(re.search(r'^y1 silent for ([\d.]+) s', r.why('y2'))[1]) <= 1.2


def test_the_sentence():
    def say(**facts):
        return str(Reason.of('input of another clock', name='y1', **facts))
    assert say(seconds=-1795948500.4, clock=1795948512.0) == (
        "y1 speaks, but its stamps are of another clock (1795948500 s behind this node's: time "
        'since boot, or of a simulation?)')
    assert say(seconds=-2592000.0, clock=1795948512.0) == (
        "y1 speaks, but its stamps are of another clock (2592000 s behind this node's)")
