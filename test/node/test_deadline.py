"""A listener or a driver with a deadline: it is said what to change, and that works."""

from pathlib import Path
import sys

import pytest
from rclpy.duration import Duration
from rclpy.qos import LivelinessPolicy, QoSProfile
from sensor_msgs.msg import Range

from vsensor_ros.node import status
from vsensor_ros.node.qos import ENDLESS, mends

sys.path.append(str(Path(__file__).parent))
from managed_rig import machines

MS = 10**6
DEADLINE = {'deadline': Duration(nanoseconds=100 * MS)}
LEASE = {'liveliness_lease_duration': Duration(nanoseconds=2000 * MS)}
MANUAL = {'liveliness': LivelinessPolicy.MANUAL_BY_TOPIC}
OUT = 'qos_overrides./y1.publisher'
IN = 'qos_overrides./y1_raw.subscription'


@pytest.fixture
def machine(parameters, monkeypatch):
    monkeypatch.setattr(status, 'LOOK', 0.1)  # s
    yield from machines(parameters)


def complaint(m, topic):
    """Return the line on the QoS of a topic."""
    assert m.spin_until(lambda: m.logged(f'{topic}: the QoS of /engineer does not match'))
    return m.logged(f'{topic}: the QoS of /engineer does not match')[0]


@pytest.mark.parametrize('wanted, told, mend', [
    (DEADLINE, f'{OUT}.deadline: 100000000', {f'{OUT}.deadline': 100 * MS}),
    (LEASE, f'{OUT}.liveliness_lease_duration: 2000000000',
     {f'{OUT}.liveliness_lease_duration': 2000 * MS}),
    ({**DEADLINE, **MANUAL}, f'{OUT}.deadline: 100000000 and {OUT}.liveliness: manual_by_topic',
     {f'{OUT}.deadline': 100 * MS, f'{OUT}.liveliness': 'manual_by_topic'})],
    ids=['deadline', 'lease', 'deadline and manual'])
def test_a_listener_that_demands(machine, wanted, told, mend):
    m = machine()
    plain, heard = m.listen(Range, '/y1'), m.listen(Range, '/y1', QoSProfile(depth=10, **wanted))
    m.drive()
    assert complaint(m, '/y1').endswith(
        f'nothing passes between them, change it there, or here with {told}')
    assert m.spin_until(lambda: len(plain) > 20)
    assert not heard
    m.close()
    m = machine(**mend)
    heard = m.listen(Range, '/y1', QoSProfile(depth=10, **wanted))
    m.drive()
    assert m.spin_until(lambda: len(heard) > 20)
    assert {message.range for message in heard} == {1.5}
    assert not m.logged('/y1: the QoS of')


def test_a_listener_with_a_deadline_hears_estimates(machine):
    m = machine(**{f'{OUT}.deadline': 100 * MS, f'{OUT}.lifespan': 10**12})
    heard = m.listen(Range, '/y1', QoSProfile(depth=10, **DEADLINE))
    m.drive()
    assert m.spin_until(lambda: heard)
    m.isolate('y1')
    assert m.spin_until(lambda: m.logged('y1: virtual'))
    count = len(heard)
    assert m.spin_until(lambda: len(heard) > count + 20)


def test_a_demand_on_a_driver(machine):
    """Our subscription may ask for a deadline; a driver that does not offer it is told of."""
    m = machine(**{f'{IN}.deadline': 100 * MS})
    heard = m.listen(Range, '/y1')
    m.drive()
    said = complaint(m, '/y1_raw')
    assert said.endswith(f'change it there, or here with {IN}.deadline: 0')
    assert not heard


def test_what_no_parameter_can_do():
    def say(publisher, subscription, end='publisher'):
        return mends(QoSProfile(depth=1, **publisher), QoSProfile(depth=1, **subscription), '/y',
                     end)
    soon = {'deadline': Duration(nanoseconds=MS - 1)}
    assert say({}, soon) == []  # beyond the range: it can only be changed there
    assert say(soon, {}) == say({}, {}) == say(soon, soon) == []
    endless = {'deadline': Duration(nanoseconds=ENDLESS)}
    assert say({}, endless) == say(endless, {}) == []
    assert say(endless, DEADLINE, 'subscription') == [
        'qos_overrides./y.subscription.deadline: 0']
    assert say(DEADLINE, soon, 'subscription') == [
        'qos_overrides./y.subscription.deadline: 100000000']
