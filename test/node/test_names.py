"""A replacer by any name, in any namespace, given its parameters in any way."""

import os
from pathlib import Path
import signal
import subprocess
import sys

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from rclpy.context import Context
from sensor_msgs.msg import Range
from std_msgs.msg import Float64, String
import yaml

from vsensor_ros.lab.process import die_with_parent
from vsensor_ros.node import status
from vsensor_ros.node.known import Refused
from vsensor_ros.node.lifecycle import ManagedNode, SUCCESS
from vsensor_ros.node.parameters import check_addressed, check_files

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, machines

LAUNCHED = {'/**': {'ros__parameters': {'use_sim_time': False, 'autostart': True}}}
ROBOT_WIDE = {'/**': {'ros__parameters': {'robot_name': 'x', 'update_rate': 50}}}
IN_ROBOT = ('-r', '__ns:=/robot1')


@pytest.fixture(scope='module')
def own(parameters):
    """Parameters for a node in any namespace."""
    return {name: value.lstrip('/') if name.endswith('.topic') else value
            for name, value in parameters.items()}


@pytest.fixture
def machine(own):
    yield from machines(own)


@pytest.fixture
def given(tmp_path, own):
    """Return the arguments for parameter files, each with these keys; None: our parameters."""
    def make(*files, more=()):
        arguments = ['--ros-args', *more]
        for i, file in enumerate(files):
            path = tmp_path / f'{i}.yaml'
            path.write_text(yaml.safe_dump(file if isinstance(file, dict) else {
                file: {'ros__parameters': own}}, sort_keys=False))
            arguments += ['--params-file', str(path)]
        return arguments
    return make


def configure(arguments):
    """Return the full name of the node and the log of its topics; raise Refused."""
    blocks = check_files(arguments)
    context = Context()
    context.init(args=arguments)
    node = ManagedNode(context, blocks=blocks)
    try:
        check_addressed(node, blocks)
        if node.trigger_configure() != SUCCESS:
            raise node.refused
        settings = node.replacer.settings
        return (node.get_fully_qualified_name(), settings.isolation_topic,
                settings.sensors[0].output, settings.for_others)
    finally:
        node.trigger_shutdown()
        node.destroy_node()
        context.shutdown()


@pytest.mark.parametrize('key, more, name', [
    ('/**', (), '/replacer'),
    ('/**', IN_ROBOT, '/robot1/replacer'),
    ('/**', (*IN_ROBOT, '-r', '__node:=guard'), '/robot1/guard'),
    ('/robot1/replacer', IN_ROBOT, '/robot1/replacer'),
    ('robot1/replacer', IN_ROBOT, '/robot1/replacer'),
    ('/*/replacer', IN_ROBOT, '/robot1/replacer'),
    ('/**/replacer', (), '/replacer'),
    ('replacer', (), '/replacer'),
    ('guard', ('-r', '__node:=guard'), '/guard'),
])
@pytest.mark.parametrize('beside', [(), (ROBOT_WIDE, LAUNCHED)], ids=['alone', 'robot-wide'])
def test_it_is_configured(given, key, more, name, beside):
    inside = name.rpartition('/')[0]
    others = ('robot_name', 'update_rate') if ROBOT_WIDE in beside else ()
    assert configure(given(key, *beside, more=more)) == (
        name, f'{inside}/isolation', f'{inside}/y1', others)
    if beside:  # in the other order, too
        assert configure(given(*beside, key, more=more))[0] == name


@pytest.mark.parametrize('key, more, told', [
    ('replacer', IN_ROBOT, 'is for /replacer, but this node is /robot1/replacer; write /**: or '
     '/robot1/replacer: above it'),
    ('/robot1/replacer', (), 'is for /robot1/replacer, but this node is /replacer; write /**: or '
     '/replacer: above it'),
    ('replacer', ('-r', '__node:=guard'), 'is for /replacer, but this node is /guard; write /**: '
     'or /guard: above it'),
    ('/*/replacer', (), 'is for /*/replacer, but this node is /replacer; write'),
])
@pytest.mark.parametrize('beside', [
    (), (LAUNCHED,), (ROBOT_WIDE, LAUNCHED), ({'/**': {'ros__parameters': {'rate': 50.0}}},)],
    ids=['alone', 'launched', 'robot-wide', 'with one of ours'])
def test_a_file_for_another_name_says_so(given, tmp_path, key, more, told, beside):
    with pytest.raises(Refused) as raised:
        configure(given(key, *beside, more=more))
    assert str(raised.value).startswith(f'{tmp_path}/0.yaml: {told}')
    assert len(raised.value.problems) == 1


def test_a_file_for_two_robots(given, own):
    both = {f'/{robot}/replacer': {'ros__parameters': dict(own)} for robot in ('robot1', 'robot2')}
    assert configure(given(both, more=IN_ROBOT))[0] == '/robot1/replacer'
    with pytest.raises(Refused, match=r'is for /robot1/replacer, /robot2/replacer, but this'):
        configure(given(both))


@pytest.mark.parametrize('key', ['/**', 'replacer'])
def test_what_names_this_node_is_read_strictly(given, own, key):
    with pytest.raises(Refused, match=r'^/replacer: ratee: .* did you mean rate\?$'):
        configure(given({key: {'ros__parameters': {**own, 'ratee': 5.0}}}, ROBOT_WIDE))
    with pytest.raises(Refused, match=r'^/replacer: robot_nam: there is no such parameter'):
        configure(given({key: {'ros__parameters': own}}, ROBOT_WIDE, more=['-p', 'robot_nam:=x']))


def test_all_nodes_and_this_one_in_one_block(given, own):
    with pytest.raises(Refused) as raised:
        configure(given({'/**': {'ros__parameters': {**own, 'robot_name': 'x'}}}))
    assert str(raised.value) == (
        '/replacer: robot_name: there is no such parameter; leave it out; if it is for others, '
        'write /replacer: above what is for this node')


def test_the_design_file_as_an_argument(given, own, design_file, tmp_path):
    rest = {name: value for name, value in own.items() if name != 'design_file'}
    more = ['-p', f'design_file:={design_file}']
    assert configure(given({'replacer': {'ros__parameters': rest}}, more=more))[0] == '/replacer'
    with pytest.raises(Refused, match=r'0\.yaml: is for /replacer, but this node is /guard'):
        configure(given({'replacer': {'ros__parameters': rest}},
                        more=[*more, '-r', '__node:=guard']))


def test_two_files_are_put_together(given, own):
    first = {name: value for name, value in own.items() if not name.startswith('sensors.')}
    second = {name: value for name, value in own.items() if name.startswith('sensors.')}
    second['isolation.topic'] = 'faults'
    assert configure(given({'/**': {'ros__parameters': first}},
                           {'replacer': {'ros__parameters': second}}))[1] == '/faults'


def test_one_file_given_twice(given):
    arguments = given('/**')
    assert configure([*arguments, *arguments[1:]])[0] == '/replacer'


# ---- where the design file is looked for


def refusal(given, design_file, key='/**', **options):
    with pytest.raises(Refused) as raised:
        configure(given({key: {'ros__parameters': {'design_file': design_file}}}, **options))
    return raised.value.problems[0]


def test_a_design_file_at_home(given, own, design_file, monkeypatch):
    monkeypatch.setenv('HOME', str(design_file.parent))
    at_home = {**own, 'design_file': f'~/{design_file.name}'}
    assert configure(given({'/**': {'ros__parameters': at_home}}))[0] == '/replacer'
    assert str(refusal(given, '~/none.json')).startswith(
        f'{design_file.parent}/none.json: design file: cannot be read (No such file or ')


def test_a_relative_design_file(given, own, design_file, tmp_path, monkeypatch):
    relative = {**own, 'design_file': design_file.name}
    monkeypatch.chdir(design_file.parent)
    assert configure(given({'/**': {'ros__parameters': relative}}))[0] == '/replacer'
    elsewhere = tmp_path / 'elsewhere'
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    rule = f'; relative paths begin in the working directory, {elsewhere}; '
    missing = refusal(given, 'd.json')
    assert str(missing).startswith('d.json: design file: cannot be read (No such file or '
                                   f'directory){rule}')
    # a user may mean the folder of the parameter file, and is told what to write
    (tmp_path / 'd.json').write_bytes(design_file.read_bytes())
    assert str(refusal(given, 'd.json')) == (
        f'd.json: design file: lies beside {tmp_path}/0.yaml{rule}write design_file: '
        f'{tmp_path}/d.json')
    assert 'cannot be read' in str(refusal(given, 'x', more=['-p', 'design_file:=e.json']))


# ---- as processes and at the topic


def start(arguments):
    return subprocess.Popen([sys.executable, '-m', 'vsensor_ros.command.replacer', *arguments],
                            stderr=subprocess.PIPE, text=True, env=os.environ,
                            preexec_fn=die_with_parent)


def test_a_process_says_the_key_that_would_work(given, tmp_path):
    process = start(given('replacer', LAUNCHED, more=('-r', '__node:=replacer', *IN_ROBOT)))
    _, said = process.communicate(timeout=120)
    assert process.returncode == 2
    assert said == (f'{tmp_path}/0.yaml: is for /replacer, but this node is /robot1/replacer; '
                    'write /**: or /robot1/replacer: above it\n')


def test_a_process_beside_parameters_of_the_whole_robot(given):
    process = start(given('/robot1/replacer', ROBOT_WIDE, LAUNCHED, more=IN_ROBOT))
    seen = ''
    while 'virtual sensors of' not in seen:
        line = process.stderr.readline()
        assert line, seen
        seen += line
    process.send_signal(signal.SIGTERM)
    _, rest = process.communicate(timeout=120)
    assert process.returncode == 0, rest
    assert seen.count('not for this node, it seems: robot_name, update_rate') == 1
    assert 'isolation: /robot1/isolation' in seen


class Robot:
    """What one replacer in a namespace is sent, and what it says."""

    def __init__(self, machine, name):
        self.name, node = name, machine.engineer
        self.status, self.heard = {}, []
        node.create_subscription(DiagnosticArray, f'/{name}/replacer/status', self._take, KEPT)
        node.create_subscription(Range, f'/{name}/y2', self.heard.append, 10)
        self.drivers = [(node.create_publisher(Range, f'/{name}/y{i}_raw', 10), value)
                        for i, value in ((1, 1.5), (2, 3.0), (3, 0.0))]
        self.commands = node.create_publisher(Float64, f'/{name}/u1', 10)
        self.isolation = node.create_publisher(String, f'/{name}/isolation', KEPT)
        node.create_timer(0.02, lambda: self._send(node.get_clock().now().to_msg()))

    def _take(self, array):
        self.status = {s.name: {v.key: v.value for v in s.values} for s in array.status}

    def _send(self, now):
        for publisher, value in self.drivers:
            message = Range(range=value)
            message.header.stamp = now
            publisher.publish(message)
        self.commands.publish(Float64(data=1.5))

    def source(self):
        return self.status.get('y2', {}).get('source')


def test_two_robots_do_not_hear_each_other(machine):
    """Each has its isolation, its topics and its names on the shared /diagnostics."""
    first, second = (machine(ros_args=['-r', f'__ns:=/robot{i}']) for i in (1, 2))
    told = set()
    first.engineer.create_subscription(
        DiagnosticArray, '/diagnostics', lambda array: told.update(s.name for s in array.status),
        10)
    robots = [Robot(first, 'robot1'), Robot(first, 'robot2')]
    assert first.spin_until(lambda: all(r.source() == 'real' for r in robots))
    robots[0].isolation.publish(String(data='y2'))
    assert first.spin_until(lambda: robots[0].source() == 'virtual')
    # the other goes on, and has told so since
    count, since = len(robots[1].heard), robots[1].status['replacer']['ticks']
    assert first.spin_until(lambda: len(robots[1].heard) > count + 20 and int(
        robots[1].status['replacer']['ticks']) > int(since) + 100)
    assert robots[1].source() == 'real' and robots[1].status['replacer']['spoken_of'] == ''
    robots[1].isolation.publish(String(data='y2'))
    assert first.spin_until(lambda: robots[1].source() == 'virtual')
    assert first.spin_until(lambda: len(told) == 8)
    assert told == {f'robot{i}/replacer: {name}' for i in (1, 2)
                    for name in ('y1', 'y2', 'y3', 'the loop')}
    assert second.end() == 0


def test_two_of_one_name_are_told(machine, own, monkeypatch):
    monkeypatch.setattr(status, 'LOOK', 0.1)  # s
    first = machine()
    machine(**{name: f'other/{value}' for name, value in own.items() if name.endswith('.topic')})
    told = '/replacer/status: another /replacer publishes there too'
    assert first.spin_until(lambda: first.logged(told))


def test_in_no_namespace_the_names_are_short(machine):
    m = machine()
    told = set()
    m.engineer.create_subscription(
        DiagnosticArray, '/diagnostics', lambda array: told.update(s.name for s in array.status),
        10)
    assert m.spin_until(lambda: len(told) == 4)
    assert told == {f'replacer: {name}' for name in ('y1', 'y2', 'y3', 'the loop')}
