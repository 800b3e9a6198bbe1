from dataclasses import replace

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter

from vsensor_ros.bank import End
from vsensor_ros.engine import Policy
from vsensor_ros.node.known import Refused
from vsensor_ros.node.parameter_file import Block, check_addressed
from vsensor_ros.node.parameters import read
from vsensor_ros.node.replacer import Replacer
from vsensor_ros.observers import Design


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
def start(context):
    """Return a function that makes the node with these parameters."""
    nodes = []

    def make(parameters):
        nodes.append(Node(
            'replacer', context=context, automatically_declare_parameters_from_overrides=True,
            parameter_overrides=[
                Parameter(name, value=value) for name, value in parameters.items()]))
        return nodes[-1]
    yield make
    for node in nodes:
        node.destroy_node()


def problems(node):
    with pytest.raises(Refused) as raised:
        read(node)
    lines = str(raised.value).split('\n')
    assert len(lines) == len(raised.value.problems)
    return lines


def test_what_was_given_and_the_defaults(start, parameters):
    settings = read(start({**parameters, 'rate': 50, 'sensors.y2.input': '/driver/y2'}))
    assert settings.rate == 50.0 and settings.autostart
    assert settings.max_age == dict.fromkeys(('y1', 'y2', 'y3'), 0.5)
    assert settings.jump_ahead == 1.0
    assert [(s.name, s.input, s.output) for s in settings.sensors] == [
        ('y1', '/y1_raw', '/y1'), ('y2', '/driver/y2', '/y2'), ('y3', '/y3_raw', '/y3')]
    assert [(c.name, c.topic) for c in settings.commands] == [('u1', '/u1')]
    assert settings.isolation_topic == '/isolation'
    live = settings.live
    assert (live.without_estimate, live.time_constant) == ('stop', 0.5)
    assert live.policies == dict.fromkeys(('y1', 'y2', 'y3'), Policy('automatic', 2.0, False))
    assert live.max_deviation == dict.fromkeys(('y1', 'y2', 'y3'))  # follow from the design


def test_one_sensor_may_have_its_own(start, parameters):
    settings = read(start({
        **parameters, 'recovery.policy': 'hold', 'recovery.dwell': 5, 'silent_sensor': 'replace',
        'max_deviation': 0.1, 'max_age': 1, 'autostart': False, 'sensors.y1.recovery': 'latched',
        'sensors.y1.dwell': 0, 'sensors.y2.silent': 'wait', 'sensors.y2.max_deviation': 0.0,
        'sensors.y3.max_deviation': 'auto', 'sensors.y3.max_age': 4.0, 'sensors.y3.dwell': '',
        'sensors.y3.recovery': ''}))
    assert settings.live.policies == {
        'y1': Policy('latched', 0.0, True), 'y2': Policy('hold', 5.0, False),
        'y3': Policy('hold', 5.0, True)}
    assert settings.live.max_deviation == {'y1': 0.1, 'y2': 0.0, 'y3': None}
    assert settings.max_age == {'y1': 1.0, 'y2': 1.0, 'y3': 4.0}
    assert not settings.autostart


def test_names_of_isolation_and_publishers(start, parameters):
    settings = read(start(parameters))
    assert settings.isolation_names.find('y2') == 'y2'
    assert {s.publisher for s in (*settings.sensors, *settings.commands)} == {''}
    settings = read(start({**parameters, 'isolation.names': ['', 'level 2=y2'],
                           'sensors.y1.publisher': 'driver', 'commands.u1.publisher': '/a/nav'}))
    assert settings.isolation_names.find('level 2') == 'y2'
    assert [s.publisher for s in settings.sensors] == ['/driver', '', '']
    assert [c.publisher for c in settings.commands] == ['/a/nav']
    for empty in ([], ['']):
        assert read(start({**parameters, 'isolation.names': empty})).isolation_names.find('q') is \
            None


def test_a_slow_node_allows_the_clock_longer_steps(start, parameters):
    assert read(start({**parameters, 'rate': 2.0})).jump_ahead == 5.0
    assert read(start({**parameters, 'rate': 2.0, 'max_jump': 7.0})).jump_ahead == 7.0


@pytest.mark.parametrize('changes, told', [
    ({'rate': 0.0}, 'rate: 0 is out of range'),
    ({'rate': float('nan')}, 'rate: nan is out of range'),
    ({'rate': 'fast'}, "rate: 'fast' is not a number"),
    ({'rate': True}, 'rate: True is not a number'),
    ({'without_estimate': 'freeze'}, 'choose from stop, hold, nan, pass'),
    ({'without_estimat': 'stop'}, 'without_estimat: there is no such parameter; did you mean '
     'without_estimate?'),
    ({'sensors.y4.topic': '/y4'}, 'sensors.y4.topic: there is no such parameter; did you mean '
     'sensors.y'),
    ({'sensors.y1.topic': None}, 'sensors.y1.topic: is missing'),
    ({'commands.u1.field': None}, 'commands.u1.field: is missing'),
    ({'sensors.y1.topic': 'two words'}, "sensors.y1.topic: 'two words' is not a topic name"),
    ({'sensors.y1.topic': ''}, 'sensors.y1.topic: is empty'),
    ({'sensors.y1.input': '/y1'}, 'sensors.y1.input: /y1 is also the output'),
    ({'sensors.y1.input': 'y1'}, 'sensors.y1.input: /y1 is also the output'),
    ({'sensors.y1.input': '/y2'}, 'the output of one of'),
    ({'sensors.y1.input': '/y2_raw'}, 'shares one topic'),
    ({'sensors.y2.topic': '/y1', 'sensors.y2.input': '/z'}, 'shares one topic'),
    ({'sensors.y2.topic': '/y1'}, 'sensors.y2.field: is that of y1 too'),
    ({'sensors.y2.topic': '/y1', 'sensors.y2.type': 'sensor_msgs/msg/Temperature',
      'sensors.y2.field': 'temperature'}, 'a topic has one type'),
    ({'isolation.topic': '/y1'}, 'DiagnosticArray, but /y1 carries sensor'),
    ({'commands.u1.topic': '/y1_raw'}, 'commands.u1.type: is std_msgs/msg/Float64, but /y1_raw'),
    ({'commands.u1.topic': '/y1', 'commands.u1.type': 'sensor_msgs/msg/Range',
      'commands.u1.field': 'range'}, 'commands.u1.topic: /y1 is where y1 goes out'),
    ({'isolation.type': 'std_msgs/msg/Bool'}, 'is not a choice'),
    ({'sensors.y1.type': 'sensor_msgs/msg/Rnge'}, 'did you mean Range?'),
    ({'sensors.y1.type': 'os/msg/Path'}, 'no package of interfaces'),
    ({'sensors.y1.field': 'distance'}, 'its fields are header'),
    ({'design_file': None}, 'design_file: is missing'),
    ({'isolation.topic': '/diagnostics', 'isolation.type': 'std_msgs/msg/String'},
     'isolation.type: is std_msgs/msg/String, but /diagnostics carries'),
    ({'sensors.y1.topic': '/diagnostics'}, 'according to ROS'),
    ({'sensors.y1.topic': '/rosout'}, 'according to ROS'),
    ({'commands.u1.topic': '/parameter_events'}, 'according to ROS'),
    ({'commands.u1.topic': '/clock', 'use_sim_time': True}, 'but /clock carries rosgraph_msgs'),
    ({'use_sim_time': 'yep'}, "use_sim_time: 'yep' is neither true nor false"),
    ({'design_file': '/dev/null'}, '/dev/null: design file: is not a regular file'),
    ({'design_file': '/no/such/file'}, '/no/such/file: design file: cannot be read'),
    ({'autostart': 'yes'}, "autostart: 'yes' is not true or false; give"),
    ({'autostart': 1}, 'autostart: 1 is not true or false'),
    ({'max_jump': 0.0}, 'max_jump: 0 is out of range; choose from 0.001 to 86400'),
    ({'max_age': float('inf')}, 'max_age: inf is out of range'),
    ({'time_constant': -1.0}, 'time_constant: -1 is out of range; choose from 0 to 3600'),
    ({'max_deviation': -1.0}, 'max_deviation: -1 is out of range'),
    ({'max_deviation': 'none'}, "max_deviation: 'none' is not a number"),
    ({'recovery.policy': 'auto'}, "recovery.policy: 'auto' is not a choice; choose from automat"),
    ({'recovery.dwell': ''}, "recovery.dwell: '' is not a number; give"),
    ({'recovery': 'hold'}, 'recovery: there is no such parameter; did you mean recovery.'),
    ({'sensors.y1.dwell': -1}, 'sensors.y1.dwell: -1 is out of range; choose from 0 to 86400'),
    ({'sensors.y1.dwell': float('nan')}, 'sensors.y1.dwell: nan is out of range'),
    ({'sensors.y1.dwell': True}, 'sensors.y1.dwell: True is not a number; give'),
    ({'sensors.y1.silent': 'ignore'}, 'choose from wait, replace'),
    ({'sensors.y1.max_age': 0}, 'sensors.y1.max_age: 0 is out of range'),
    ({'commands.u1.dwell': 1.0}, 'commands.u1.dwell: there is no such parameter'),
    ({'isolation.topic': '~/status'}, '/replacer/status is what this node says'),
    ({'sensors.y1.topic': '/replacer/estimates'}, 'but /replacer/estimates carries'),
    ({'sensors.y1.input': '/' + 'y' * 247}, 'like /tank/level2, with at most 247 characters'),
    ({'isolation.names': ['level=y22']}, "isolation.names: 'level=y22' is for 'y22', which is not "
     'a sensor; did you mean y2?'),
    ({'isolation.names': 'level=y2'}, "isolation.names: 'level=y2' is not a list of texts; give"),
    ({'isolation.names': [1, 2]}, 'is not a list of texts; give the names by which'),
    ({'sensors.y1.publisher': '/robot/the driver'}, "sensors.y1.publisher: '/robot/the driver' is "
     'not the name of a node; write it like /robot/driver'),
    ({'commands.u1.publisher': 'a//b'}, "commands.u1.publisher: 'a//b' is not the name of a node"),
    ({'sensors.y1.publisher': 7}, 'sensors.y1.publisher: 7 is not a text'),
    ({'sensors.y1.field': 'range' * 1000}, 'sensors.y1.field: has 5000 characters; at most 4096'),
])
def test_refusals(start, parameters, changes, told):
    given = {name: value for name, value in {**parameters, **changes}.items() if value is not None}
    lines = problems(start(given))
    assert any(told in line for line in lines), lines
    assert len(lines) <= 2


def test_all_problems_are_listed(start, parameters):
    given = {**parameters, 'rate': -1.0, 'rat': 1.0, 'sensors.y1.field': 'x',
             'sensors.y2.type': 'x', 'isolation.topic': 'a b'}
    del given['commands.u1.topic']
    assert len(problems(start(given))) == 6


def test_the_longest_topic_can_be_opened(start, parameters):
    topic = '/' + 'y' * 246
    node = start({**parameters, 'sensors.y1.input': topic, 'isolation.topic': topic[:-1]})
    settings = read(node)
    assert settings.sensors[0].input == topic
    node.create_subscription(settings.sensors[0].kind, topic, lambda message: None, 1)


def test_of_a_thousand_wrong_names_some_are_listed(start, parameters):
    lines = problems(start({**parameters, **{f'a{i}': i for i in range(1000)}}))
    assert len(lines) == 11
    assert lines[-1] == '/replacer: and 990 more parameters that there are not; leave them out'


@pytest.mark.parametrize('sensors, inputs, told', [
    (tuple(f'y{i}' for i in range(600)), tuple(f'u{i}' for i in range(401)),
     'plant: has 1001 sensors and commands; at most 1000 are served'),
    (('y1', 'y' * 101), (), 'is a name of 101 characters; choose one of at most 100'),
])
def test_designs_beyond_reason(start, tmp_path, sensors, inputs, told):
    Design('big', '0' * 64, ('x',), inputs, sensors, {}, None, {}).save(tmp_path / 'big.json')
    line, = problems(start({'design_file': str(tmp_path / 'big.json')}))
    assert told in line


def test_a_rate_that_does_not_suit_a_discrete_design(start, parameters, plan, tmp_path):
    entries = {key: replace(entry, sample_time=0.02, N=0.5 * entry.N**2,
                            eigenvalues=0.5 * entry.eigenvalues**2)
               if hasattr(entry, 'N') else entry for key, entry in plan.entries.items()}
    replace(plan, sample_time=0.02, entries=entries).save(tmp_path / 'discrete.json')
    given = {**parameters, 'design_file': str(tmp_path / 'discrete.json')}
    node = start(given)
    with pytest.raises(Refused) as raised:
        Replacer(node, read(node))
    assert 'rate: 100 Hz does not suit' in str(raised.value)


def test_a_parameter_file_for_another_node(start, parameters):
    with pytest.raises(Refused) as raised:
        check_addressed(start({}), [Block('a.yaml', name, frozenset(['rate']))
                                    for name in ('/replacr', '/robot/replacer')])
    assert str(raised.value) == (
        'a.yaml: is for /replacr, /robot/replacer, but this node is /replacer; write /**: or '
        '/replacer: above it')
    check_addressed(start(parameters), [Block('a.yaml', '/driver', frozenset(['rate']))])
    check_addressed(start({}), [])


def test_what_the_graph_refuses_is_one_line(start, parameters, monkeypatch):
    def fail(*arguments):
        raise RuntimeError('no room for a topic, at /publisher.c:1, at /topic.cpp:2')
    monkeypatch.setattr('vsensor_ros.node.replacer.open_topics', fail)
    with pytest.raises(Refused) as raised:
        node = start(parameters)
        Replacer(node, read(node))
    assert str(raised.value) == '/replacer: topics: no room for a topic; give the topics other ' \
        'names'


@pytest.mark.parametrize(('given', 'end'), [
    ({}, End(0.5, only_periodic=True)), ({'max_age': 2}, End(2.0, only_periodic=True)),
    ({'commands.u1.max_age': '', 'commands.u1.at_end': ''}, End(0.5, only_periodic=True)),
    ({'commands.u1.max_age': 0.2}, End(0.2)), ({'commands.u1.at_end': 'invalid'}, End(0.5)),
    ({'commands.u1.at_end': 0}, End(0.5, 0.0)), ({'commands.u1.at_end': -1.5}, End(0.5, -1.5)),
    ({'commands.u1.at_end': '0.25', 'commands.u1.max_age': 1}, End(1.0, 0.25)),
    ({'commands.u1.at_end': 'hold'}, None)])
def test_what_becomes_of_a_command_at_its_end(start, parameters, given, end):
    ends = read(start({**parameters, **given})).command_ends
    assert ends == ({} if end is None else {'u1': end})


@pytest.mark.parametrize(('key', 'value', 'problem'), [
    ('at_end', 'zero', "commands.u1.at_end: 'zero' is not a number; give the value that counts"),
    ('at_end', True, 'commands.u1.at_end: True is not a number'),
    ('at_end', 'nan', 'commands.u1.at_end: nan is out of range'),
    ('at_end', 1e13, 'commands.u1.at_end: 1e+13 is out of range'),
    ('max_age', 0.0, 'commands.u1.max_age: 0 is out of range'),
    ('max_age', 'long', "or '' for that of all commands")])
def test_an_end_that_is_none_is_refused_in_a_line(start, parameters, key, value, problem):
    line, = problems(start({**parameters, f'commands.u1.{key}': value}))
    assert problem in line
