import os

import pytest
from rclpy.context import Context
from rclpy.parameter import Parameter

from vsensor_ros.node.parameters import check_addressed, check_files, read, Refused
from vsensor_ros.node.replacer import make_node, Replacer


@pytest.fixture
def start():
    """Return a function that makes the node with these parameters."""
    context = Context()
    context.init()
    nodes = []

    def make(parameters):
        nodes.append(make_node(
            context, [Parameter(name, value=value) for name, value in parameters.items()]))
        return nodes[-1]
    yield make
    for node in nodes:
        node.destroy_node()
    context.shutdown()


def problems(node):
    with pytest.raises(Refused) as raised:
        read(node)
    lines = str(raised.value).split('\n')
    assert len(lines) == len(raised.value.problems)
    return lines


def test_what_was_given_and_the_defaults(start, parameters):
    settings = read(start({**parameters, 'rate': 50, 'sensors.y2.input': '/driver/y2'}))
    assert settings.rate == 50.0 and settings.without_estimate == 'stop'
    assert [(s.name, s.input, s.output) for s in settings.sensors] == [
        ('y1', '/y1_raw', '/y1'), ('y2', '/driver/y2', '/y2'), ('y3', '/y3_raw', '/y3')]
    assert [(c.name, c.topic) for c in settings.commands] == [('u1', '/u1')]
    assert settings.isolation_topic == '/isolation'


def test_parameters_are_described_and_fixed(start, parameters):
    node = start(parameters)
    read(node)
    for name in ('rate', 'sensors.y1.field', 'sensors.y1.input', 'isolation.type', 'max_age'):
        descriptor = node.describe_parameter(name)
        assert descriptor.description and descriptor.read_only
    assert node.describe_parameter('rate').floating_point_range[0].to_value == 1000.0
    assert not node.set_parameters([Parameter('rate', value=5.0)])[0].successful
    assert node.get_parameter('rate').value == 100.0


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


def test_a_rate_that_does_not_suit_a_discrete_design(start, parameters, plan, tmp_path):
    from dataclasses import replace
    entries = {key: replace(entry, sample_time=0.02, N=0.5 * entry.N**2,
                            eigenvalues=0.5 * entry.eigenvalues**2)
               if hasattr(entry, 'N') else entry for key, entry in plan.entries.items()}
    replace(plan, sample_time=0.02, entries=entries).save(tmp_path / 'discrete.json')
    given = {**parameters, 'design_file': str(tmp_path / 'discrete.json')}
    with pytest.raises(Refused) as raised:
        Replacer(start(given))
    assert 'rate: 100 Hz does not suit' in str(raised.value)


@pytest.mark.parametrize('text, told', [
    ('replacer: {ros__parameters: {rate: 1.0, rate: 2.0}}', 'ros__parameters.rate: stands there '
     'twice'),
    ('a:\n  ros__parameters:\n    sensors:\n      y1: {topic: /a}\n      y1: {topic: /b}\n',
     'sensors.y1: stands there twice (line 5)'),
    ('replacer: {ros__parameters: {rate: }}', 'rate: has no value'),
    ('replacer: {ros__parameters: {rate: []}}', 'rate: has no value'),
    ('replacer: [', 'is not YAML'),
    ('', 'has no value'),
    ('a: {ros__parameters: {isolation: {topic: /x}, isolation.topic: /y}}', 'isolation.topic: '
     'stands there twice'),
    ('a: {ros__parameters: {isolation.topic: /y, isolation: {type: b, topic: /x}}}',
     'isolation.topic: stands there twice'),
    ('a: {ros__parameters: {isolation.topic: /x, isolation: {type: b}}}', ''),
    ('a: {ros__parameters: {b: &x {c: 1}, d: *x}}', 'd: is an alias'),
    ('a: {ros__parameters: {b: &x 1, d: *x}}', 'd: is an alias'),
    ('a: &x {b: *x}\n', 'a.b: is an alias'),
    ('a: {ros__parameters: {b: [1.0, x]}}', 'b: is a list of other things'),
    ('a: {ros__parameters: {b: [[1], [2]]}}', 'b: is a list of other things'),
    ('a: {ros__parameters: {b: [1, 2]}}', ''),
    ('a: {ros__parameters: {? [b, c] : 1}}', 'has a key that is no name'),
    ('replacer: {rate: 1.0, max_age: 2.0}', 'replacer.rate: does not stand below ros__parameters'),
    ('- 1\n- 2\n', 'parameter file: does not stand below ros__parameters'),
    ('replacer', 'parameter file: does not stand below ros__parameters'),
    ('robot: {replacer: {ros__parameters: {rate: 1.0}}}', ''),
])
def test_parameter_files(tmp_path, text, told):
    path = tmp_path / 'replacer.yaml'
    path.write_text(text)
    if not told:
        assert len(check_files(['--params-file', str(path)])) == 1
        return
    with pytest.raises(Refused) as raised:
        check_files(['--ros-args', '--params-file', str(path)])
    assert told in str(raised.value) and str(raised.value).count('\n') == 0


def test_a_parameter_file_that_is_not_there(tmp_path):
    with pytest.raises(Refused, match='cannot be read'):
        check_files(['--params-file', str(tmp_path / 'no.yaml')])
    with pytest.raises(Refused, match='not a regular file'):
        check_files(['--params-file', '/dev/null'])
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(Refused, match='not a regular file'):
        check_files(['--params-file', str(tmp_path / 'pipe')])
    with pytest.raises(Refused, match='not a text file'):
        (tmp_path / 'bytes').write_bytes(b'\xff\xfe\x00')
        check_files(['--params-file', str(tmp_path / 'bytes')])


def test_a_parameter_file_for_another_node(start, parameters):
    with pytest.raises(Refused) as raised:
        check_addressed(start({}), ['replacr', '/robot/replacer'])
    assert str(raised.value) == (
        '/replacer: parameter file: is for replacr, /robot/replacer; it has nothing for '
        '/replacer; begin it with replacer:')
    check_addressed(start(parameters), ['replacer'])
    check_addressed(start({}), [])


def test_what_the_graph_refuses_is_one_line(start, parameters, monkeypatch):
    def fail(*arguments):
        raise RuntimeError('no room for a topic, at /publisher.c:1, at /topic.cpp:2')
    monkeypatch.setattr('vsensor_ros.node.replacer.open_streams', fail)
    with pytest.raises(Refused) as raised:
        Replacer(start(parameters))
    assert str(raised.value) == '/replacer: topics: no room for a topic; give the topics other ' \
        'names'
