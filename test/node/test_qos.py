"""Quality of service by parameters, as the graph sees it."""

import copy
import time

import pytest
from rclpy.context import Context
from rclpy.duration import Duration, Infinite
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Range

from vsensor_ros.node.known import Refused
from vsensor_ros.node.parameters import read, watch
from vsensor_ros.node.polling import LISTEN
from vsensor_ros.node.qos import mends, misfit, qos_options

Y1 = 'qos_overrides./y1_raw.subscription'


@pytest.fixture(scope='module')
def context():
    context = Context()
    context.init()
    yield context
    context.shutdown()


@pytest.fixture
def start(context, parameters):
    """Return a function that makes the node with these overrides."""
    nodes = []

    def make(overrides, kind=LifecycleNode):
        nodes.append(kind('replacer', context=context, parameter_overrides=[
            Parameter(name, value=value) for name, value in {**parameters, **overrides}.items()],
            automatically_declare_parameters_from_overrides=True))
        return nodes[-1]
    yield make
    for node in nodes:
        node.destroy_node()


def listen(node, topic):
    return node.create_subscription(
        Range, topic, lambda message: None, copy.copy(LISTEN), raw=True,
        qos_overriding_options=qos_options())


def test_a_late_listener_hears_what_a_transient_local_driver_said(context, start):
    driver = Node('driver', context=context)
    profile = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publishers = [driver.create_publisher(Range, f'/{name}_raw', profile) for name in ('y1', 'y2')]
    for publisher in publishers:
        for i in range(5):
            publisher.publish(Range(range=float(i)))
    node = start({f'{Y1}.reliability': 'reliable', f'{Y1}.durability': 'transient_local',
                  f'{Y1}.depth': 3})
    settings = read(node)
    y1, y2 = (listen(node, f'/{name}_raw') for name in ('y1', 'y2'))
    unwatch = watch(node, settings, lambda live: None)
    heard = []
    end = time.monotonic() + 60.0
    while len(heard) < 3 and time.monotonic() < end:
        taken = y1.handle.take_message(Range, False)
        if taken is None:
            time.sleep(0.002)
        else:
            heard.append(taken[0].range)
    driver.destroy_node()
    assert heard == [2.0, 3.0, 4.0]  # the depth
    assert y2.handle.take_message(Range, False) is None
    seen = {topic: node.get_subscriptions_info_by_topic(topic)[0].qos_profile
            for topic in ('/y1_raw', '/y2_raw')}
    assert seen['/y1_raw'].reliability == ReliabilityPolicy.RELIABLE
    assert seen['/y2_raw'].reliability == ReliabilityPolicy.BEST_EFFORT
    assert seen['/y2_raw'].durability == DurabilityPolicy.VOLATILE
    assert node.get_parameter('qos_overrides./y2_raw.subscription.depth').value == LISTEN.depth
    for topic in ('/y1_raw', '/y2_raw'):
        assert node.describe_parameter(f'qos_overrides.{topic}.subscription.depth').read_only
    # closed and opened again, as after a cleanup
    unwatch()
    node.destroy_subscription(y1)
    node.destroy_subscription(y2)
    settings = read(node)
    listen(node, '/y1_raw')
    assert node.get_subscriptions_info_by_topic('/y1_raw')[0].qos_profile.reliability == \
        ReliabilityPolicy.RELIABLE
    watch(node, settings, lambda live: None)()


def test_another_topic_after_a_failed_configuration(start):
    """Of a topic that was opened in vain the qualities stay declared, for good."""
    node = start({})
    read(node)
    listen(node, '/y1_raw')
    assert node.has_parameter(f'{Y1}.depth')
    assert node.set_parameters([Parameter('sensors.y1.topic', value='/level')])[0].successful
    assert read(node).sensors[0].input == '/level_raw'


def test_every_topic_of_the_node_has_them(start):
    ends = [(f'/{y}_raw', 'subscription') for y in ('y1', 'y2', 'y3')]
    ends += [(f'/{y}', 'publisher') for y in ('y1', 'y2', 'y3')]
    ends += [(topic, 'subscription') for topic in ('/u1', '/isolation')]
    ends += [(topic, 'publisher')
             for topic in ('/diagnostics', '/replacer/status', '/replacer/estimates')]
    read(start({f'qos_overrides.{topic}.{end}.{policy}': value for topic, end in ends
                for policy, value in (('history', 'keep_last'), ('depth', 1000),
                                      ('reliability', 'reliable'), ('durability', 'volatile'),
                                      ('deadline', 0), ('liveliness', 'automatic'),
                                      ('liveliness_lease_duration', 10**9), ('lifespan', 10**9))
                if (end, policy) != ('subscription', 'lifespan')}))


@pytest.mark.parametrize('name, value, told', [
    (f'{Y1}.depth', 0, 'depth: 0 is out of range; choose from 1 to 1000'),
    (f'{Y1}.depth', 1001, 'depth: 1001 is out of range'),
    (f'{Y1}.depth', -1, 'depth: -1 is out of range'),
    (f'{Y1}.depth', 5.0, 'depth: 5.0 is not a whole number'),
    (f'{Y1}.depth', True, 'depth: True is not a whole number'),
    (f'{Y1}.depth', '5', "depth: '5' is not a whole number"),
    (f'{Y1}.history', 'keep_all', "'keep_all' is not a choice; choose from keep_last"),
    (f'{Y1}.reliability', 'best-effort', 'choose from reliable, best_effort'),
    (f'{Y1}.reliability', 1, 'reliability: 1 is not a text'),
    (f'{Y1}.reliability', '', "'' is not a choice"),
    (f'{Y1}.durability', 'unknown', 'choose from volatile, transient_local'),
    (f'{Y1}.reliabilty', 'reliable', f'no such parameter; did you mean {Y1}.reliability?'),
    (f'{Y1}.deadline', 999_999, 'deadline: 999999 is out of range; choose from 1000000 to '
     '86400000000000; 0 for none'),
    (f'{Y1}.deadline', -1, 'deadline: -1 is out of range'),
    (f'{Y1}.deadline', 86_400_000_000_001, 'deadline: 86400000000001 is out of range'),
    (f'{Y1}.deadline', 0.1, 'deadline: 0.1 is not a whole number'),
    (f'{Y1}.liveliness', 'manual', 'choose from system_default, automatic, manual_by_topic'),
    (f'{Y1}.liveliness_lease_duration', 1, 'liveliness_lease_duration: 1 is out of range'),
    (f'{Y1}.lifespan', 10**9, 'no such parameter; did you mean'),  # rclpy: of publishers only
    ('qos_overrides./y1.publisher.lifespan', 5, 'lifespan: 5 is out of range'),
    ('qos_overrides./y1_raw.publisher.depth', 5, 'no such parameter; did you mean'),
    ('qos_overrides.y1_raw.subscription.depth', 5, f'no such parameter; did you mean {Y1}.depth?'),
    ('qos_override./y1_raw.subscription.depth', 5, f'no such parameter; did you mean {Y1}.depth?'),
    ('qos_overrides./elsewhere.subscription.depth', 5, 'no such parameter'),
])
def test_refusals(start, name, value, told):
    with pytest.raises(Refused) as raised:
        read(start({name: value}, Node))
    assert told in str(raised.value) and len(raised.value.problems) == 1


def test_a_topic_that_is_not_understood_is_the_only_problem(start):
    with pytest.raises(Refused) as raised:
        read(start({'sensors.y1.type': 'sensor_msgs/msg/Rnge', f'{Y1}.depth': 5}))
    assert len(raised.value.problems) == 1


def test_a_profile_that_was_never_opened_is_compared_as_if_it_were():
    plain, seen = QoSProfile(depth=10), QoSProfile(
        depth=10, deadline=Infinite, lifespan=Infinite, liveliness_lease_duration=Infinite)
    assert misfit(plain, seen) == misfit(seen, plain) == misfit(seen, seen) == ''
    wanted = QoSProfile(depth=1, deadline=Duration(nanoseconds=10**8))
    for offered in (plain, seen):
        assert misfit(offered, wanted) == 'deadline is none, wanted 100000000'
        assert mends(offered, wanted, '/y', 'publisher') == [
            'qos_overrides./y.publisher.deadline: 100000000']
    assert misfit(QoSProfile(depth=1, deadline=Duration(nanoseconds=10**8)), wanted) == ''
    assert misfit(QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT), plain) == \
        'reliability is best_effort, wanted reliable'
