"""What may change while the node runs, asked for through its services."""

import time

import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage, SetParametersResult
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter

from vsensor_ros.engine import Policy
from vsensor_ros.node.known import Refused
from vsensor_ros.node.parameters import read, watch

FIXED = 'is fixed while the node runs; change it in the file and restart'


class Watched:
    """A node that is watched, and a client of its parameter services; each of its own name."""

    def __init__(self, context, given, name='replacer', kind=LifecycleNode):
        self.node = kind(name, context=context, parameter_overrides=[
            Parameter(name, value=value) for name, value in given.items()],
            automatically_declare_parameters_from_overrides=True)
        self.client = Node('operator', context=context)
        self.executor = SingleThreadedExecutor(context=context)
        self.executor.add_node(self.node)
        self.executor.add_node(self.client)
        self.applied = []
        self.settings = read(self.node)
        self.unwatch = watch(self.node, self.settings, self.applied.append)

    def close(self):
        self.executor.shutdown()
        self.client.destroy_node()
        self.node.destroy_node()

    def call(self, kind, name, **request):
        client = self.client.create_client(kind, f'/{self.node.get_name()}/{name}')
        assert client.wait_for_service(timeout_sec=60.0)
        future = client.call_async(kind.Request(**request))
        end = time.monotonic() + 60.0
        while not future.done() and time.monotonic() < end:
            self.executor.spin_once(timeout_sec=0.1)
        self.client.destroy_client(client)
        return future.result()

    def set(self, **values):
        """Set them in one list; names with __ for the dots. Return '' or the reason."""
        parameters = [Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
                      for name, value in values.items()]
        result = self.call(SetParametersAtomically, 'set_parameters_atomically',
                           parameters=parameters).result
        assert result.successful == (result.reason == '')
        return result.reason

    def value(self, name):
        return self.node.get_parameter(name).value


@pytest.fixture(scope='module')
def parameters(parameters):
    """Give what must be given only."""
    return {name: value for name, value in parameters.items()
            if name not in ('time_constant', 'recovery.dwell')}


@pytest.fixture(scope='module')
def context():
    context = Context()
    context.init()
    yield context
    context.shutdown()


@pytest.fixture
def watched(context, parameters):
    watched = Watched(context, parameters)
    yield watched
    watched.close()


@pytest.fixture(scope='module')
def untouched(context, parameters):
    """Return a node of which nothing is changed: all is refused."""
    watched = Watched(context, parameters, 'untouched')
    yield watched
    watched.close()


def test_a_list_takes_effect_at_one_instant(watched):
    before = watched.settings.live
    assert watched.set(time_constant=1, recovery__dwell=5.0, recovery__policy='hold',
                       sensors__y2__dwell=0, sensors__y2__silent='replace',
                       without_estimate='nan', max_deviation=0.25) == ''
    live, = watched.applied
    assert (live.time_constant, live.without_estimate) == (1.0, 'nan')
    assert live.policies == {'y1': Policy('hold', 5.0), 'y2': Policy('hold', 0.0, True),
                             'y3': Policy('hold', 5.0)}
    assert live.max_deviation == dict.fromkeys(('y1', 'y2', 'y3'), 0.25)
    assert before.policies == dict.fromkeys(('y1', 'y2', 'y3'), Policy('automatic', 2.0))
    assert type(watched.value('time_constant')) is type(watched.value('sensors.y2.dwell')) is float


def test_a_sensor_goes_back_to_the_general_value(watched):
    assert watched.set(sensors__y1__dwell=9.0, sensors__y1__recovery='latched') == ''
    assert watched.applied[-1].policies['y1'] == Policy('latched', 9.0)
    assert watched.set(sensors__y1__dwell='', sensors__y1__recovery='', recovery__dwell=3.0) == ''
    assert watched.applied[-1].policies['y1'] == Policy('automatic', 3.0)


@pytest.mark.parametrize('values, told', [
    ({'time_constant': float('nan')}, 'time_constant: nan is out of range; choose from 0 to 3600'),
    ({'time_constant': -1.0}, 'time_constant: -1 is out of range; choose from 0 to 3600'),
    ({'time_constant': ''}, "time_constant: '' is not a number; give the time constant"),
    ({'time_constant': True}, 'time_constant: True is not a number; give the'),
    ({'time_constant': None}, 'time_constant: is missing; give the'),
    ({'sensors.y1.dwell': float('inf')}, 'sensors.y1.dwell: inf is out of range'),
    ({'sensors.y1.dwell': -1}, 'sensors.y1.dwell: -1 is out of range; choose from 0'),
    ({'sensors.y1.dwell': 'long'}, "sensors.y1.dwell: 'long' is not a number; give the "
     "recovery.dwell of y1 alone, or '' for that of all sensors"),
    ({'sensors.y1.dwell': None}, 'sensors.y1.dwell: is missing; give the'),
    ({'sensors.y1.max_deviation': [1.0]}, 'sensors.y1.max_deviation: array'),
    ({'recovery.policy': ''}, "recovery.policy: '' is not a choice; choose from automatic, hold"),
    ({'recovery.policy': 'never'}, "recovery.policy: 'never' is not a choice; choose from auto"),
    ({'sensors.y1.silent': 'x' * 100_000}, 'is not a choice; choose from wait, replace'),
    ({'rate': 50.0}, f'rate: {FIXED}'),
    ({'max_age': 1.0}, f'max_age: {FIXED}'),
    ({'sensors.y1.max_age': 1.0}, f'sensors.y1.max_age: {FIXED}'),
    ({'qos_overrides./y1.publisher.depth': 5}, f'qos_overrides./y1.publisher.depth: {FIXED}'),
    ({'use_sim_time': True}, f'use_sim_time: {FIXED}'),
    ({'rat': 50.0}, 'rat: there is no such parameter; did you mean rate?'),
    ({'sensors.y4.dwell': 1.0}, 'sensors.y4.dwell: there is no such parameter; did you mean sen'),
    ({'time_constant': 'x', 'recovery.dwell': 'y'}, "number; give the time constant with which "
     "the offset at a switch decays; 0 disables it, so that the output steps | recovery.dwell: "
     "'y' is not a number"),
])
def test_refused_with_a_reason_and_nothing_changed(untouched, values, told):
    reason = untouched.set(without_estimate='hold', **{
        name.replace('.', '__'): value for name, value in values.items()})
    assert told in reason and len(reason) < 1000 and '\n' not in reason
    assert untouched.applied == []
    assert untouched.value('without_estimate') == 'stop'
    assert untouched.value('rate') == 100.0 and untouched.value('time_constant') == 0.5


def test_what_another_refuses_is_not_applied(watched):
    watched.node.add_on_set_parameters_callback(
        lambda parameters: SetParametersResult(successful=False, reason='not today'))
    assert watched.set(time_constant=1.0) == 'not today'
    assert watched.applied == [] and watched.value('time_constant') == 0.5


def test_one_by_one_each_counts_for_itself(watched):
    results = watched.call(SetParameters, 'set_parameters', parameters=[
        Parameter(name, value=value).to_parameter_msg()
        for name, value in (('time_constant', 2.0), ('rate', 5.0), ('silent_sensor', 'replace'))
    ]).results
    assert [r.successful for r in results] == [True, False, True]
    assert FIXED in results[1].reason and len(watched.applied) == 2
    assert watched.applied[-1].time_constant == 2.0
    assert watched.applied[-1].policies['y3'] == Policy(silent_is_faulty=True)


def test_all_can_be_read_and_given_back(context, watched, parameters):
    """`ros2 param dump` asks for all at once; what it says must load."""
    assert watched.set(sensors__y2__dwell=1.5, time_constant=0.0) == ''
    names = watched.call(ListParameters, 'list_parameters').result.names
    values = watched.call(GetParameters, 'get_parameters', names=names).values
    dumped = {name: Parameter.from_parameter_msg(ParameterMessage(name=name, value=value)).value
              for name, value in zip(names, values, strict=True)}
    assert set(parameters) < set(dumped)
    again = Watched(context, dumped, 'again', Node)
    try:
        assert again.settings.live == watched.applied[-1]
        assert [(s.input, s.output) for s in again.settings.sensors] == [
            (s.input, s.output) for s in watched.settings.sensors]
    finally:
        again.close()


def test_described_to_the_tools(watched):
    described = {d.name: d for d in watched.call(
        DescribeParameters, 'describe_parameters',
        names=['rate', 'time_constant', 'sensors.y1.dwell', 'sensors.y1.recovery']).descriptors}
    assert [d.read_only for d in described.values()] == [True, False, False, False]
    assert described['rate'].floating_point_range[0].to_value == 1000.0
    assert described['time_constant'].description.endswith('[s]')
    assert described['sensors.y1.recovery'].additional_constraints == \
        "one of automatic, hold, latched; '' for recovery.policy"


def test_configured_again_after_cleanup(watched):
    assert watched.set(time_constant=2.0) == ''
    watched.unwatch()
    assert watched.set(recovery__dwell=7.0) == ''  # nobody watches
    assert len(watched.applied) == 1
    settings = read(watched.node)
    assert settings.live.time_constant == 2.0 and settings.live.policies['y1'].dwell == 7.0
    assert settings.rate == watched.settings.rate and settings.max_age == watched.settings.max_age
    watched.unwatch = watch(watched.node, settings, watched.applied.append)
    assert watched.set(sensors__y3__recovery='latched') == ''
    assert len(watched.applied) == 2
    assert watched.applied[-1].policies['y3'] == Policy('latched', 7.0)
    assert FIXED in watched.set(rate=5.0)


def test_what_was_wrong_can_be_mended_before_it_is_configured(context, parameters):
    node = LifecycleNode('replacer', context=context, parameter_overrides=[
        Parameter(name, value=value) for name, value in {**parameters, 'rate': 0.0}.items()],
        automatically_declare_parameters_from_overrides=True)
    try:
        with pytest.raises(Refused, match='rate: 0 is out of range'):
            read(node)
        assert node.set_parameters([Parameter('rate', value=50.0)])[0].successful
        assert read(node).rate == 50.0
    finally:
        node.destroy_node()


def test_of_a_long_list_of_wrong_names_some_are_told(untouched):
    reason = untouched.set(rate=1.0, **{f'a{i}': i for i in range(500)})
    assert reason.startswith(f'rate: {FIXED} | a0: there is no such parameter')
    assert reason.endswith('and 490 more parameters that there are not; leave them out')
