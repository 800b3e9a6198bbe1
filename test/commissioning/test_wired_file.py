"""The node accepts the file, whatever is on the graph; nobody runs here."""

from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
import pytest
from sensor_msgs.msg import Imu
import yaml

from vsensor_ros import design, load_plant
from vsensor_ros.commissioning.candidates import Surroundings, Topic
from vsensor_ros.commissioning.neighbours import Neighbour
from vsensor_ros.commissioning.routes import routes
from vsensor_ros.commissioning.silent_node import open_context, open_silent
from vsensor_ros.commissioning.wire import choose, task_of
from vsensor_ros.commissioning.wired_file import Wired, wired_text
from vsensor_ros.node.parameters import check_files, read

BASE = """
name: base
time: continuous
states: {v: {unit: m/s}, w: {unit: rad/s}}
inputs: {v_cmd: {unit: m/s}, w_cmd: {unit: rad/s}}
dynamics: {v: -3*v + 3*v_cmd, w: -4*w + 4*w_cmd}
sensors:
  wheel_speed: {measures: v, noise: 0.01}
  yaw_rate: {measures: w, noise: 0.01}
  gyro: {measures: w, noise: 0.01}
"""


@pytest.fixture(scope='module')
def base(tmp_path_factory):
    """Return the plant file of a base; its design is beside it."""
    path = tmp_path_factory.mktemp('base') / 'base.yaml'
    path.write_text(BASE)
    design(load_plant(path)).save(path.parent / 'base.design.json')
    return path


def graph(*topics, replacers=(), isolations=(), namespace=''):
    """Return a graph of topics, each with its type and who publishes; nothing was heard."""
    found = {name: Topic(name, f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}', kind,
                         tuple(Neighbour(node, '') for node in nodes), (Neighbour('/ear', ''),))
             for name, kind, *nodes in topics}
    return Surroundings(found, isolations, False, frozenset(replacers), (), frozenset(
        name for name, topic in found.items() if topic.publishers), namespace)


def wire(plant, around, *ros_args):
    """Wire the plant and read the file as the node would; return what it says of its sensors."""
    output = plant.parent / 'replacer.yaml'
    task = task_of(plant, None, output)
    wired = Wired(task.plant, str(plant), task.design, output,
                  choose(task.wanted, around.candidates(), None), around)
    output.write_text(wired_text(wired))
    arguments = ['--params-file', str(output), *ros_args]
    with open_context(arguments) as context, open_silent(context, 'replacer') as node:
        settings = read(node, check_files(arguments))
    return settings, yaml.safe_load(output.read_text())['/**']['ros__parameters'], wired


def base_graph(*imus, **more):
    return graph(('/odom', Odometry, '/base'), ('/cmd_vel', Twist, '/nav'), *imus, **more)


def test_the_input_is_a_topic_of_nobody(base):
    _, given, wired = wire(base, base_graph(('/imu/data_raw', Imu, '/imu_driver'),
                                            ('/imu/data', Imu, '/imu_filter')))
    sensors = given['sensors']
    assert {(s['topic'], s['input']) for s in sensors.values()} == {
        ('/odom', '/odom_raw'), ('/imu/data', '/imu/data_driver'),
        ('/imu/data_raw', '/imu/data_raw_raw')}
    assert '/imu_filter: --ros-args -r /imu/data:=/imu/data_driver' \
        '    # /imu/data_raw is taken' in wired.remappings
    assert all(line in wired_text(wired) for line in wired.remappings)


def test_of_a_raw_and_a_filtered_topic_the_raw_one_is_not_preferred(base):
    both = base_graph(('/imu/data_raw', Imu, '/imu_driver'), ('/imu/data', Imu, '/imu_filter'))
    assert not any(c.moved for c in both.candidates())
    for who in ((), ('/replacer',)):
        moved = base_graph(('/imu/data_raw', Imu, '/imu_driver'), ('/imu/data', Imu, *who),
                           replacers=who)
        assert {c.topic for c in moved.candidates() if c.moved} == {'/imu/data_raw'}
        settings, given, _ = wire(base, moved)
        assert ('/imu/data', '/imu/data_raw') in {
            (s['topic'], s['input']) for s in given['sensors'].values()}


def test_routes_never_cross():
    assert {t: (r.output, r.input) for t, r in routes(
        ['/a', '/a_driver', '/b_raw', '/c'], ['/b_raw'], ['/a_raw', '/c_raw', '/c_driver'],
    ).items()} == {'/a': ('/a', '/a_driver2'), '/a_driver': ('/a_driver', '/a_driver_raw'),
                   '/b_raw': ('/b', '/b_raw'), '/c': ('/c', '/c_driver2')}


def test_below_its_namespace_topics_are_preferred_and_relative(base):
    two = [(f'/robot{i}{topic}', kind, f'/robot{i}/driver') for i in (1, 2) for topic, kind in (
        ('/odom', Odometry), ('/cmd_vel', Twist), ('/imu', Imu))]
    settings, given, wired = wire(
        base, graph(*two, namespace='/robot2', isolations=tuple(
            (f'/robot{i}/isolation', 'std_msgs/msg/String') for i in (1, 2))),
        '-r', '__ns:=/robot2')
    assert {s['topic'] for s in given['sensors'].values()} == {'odom', 'imu'}
    assert {s['input'] for s in given['sensors'].values()} == {'odom_raw', 'imu_raw'}
    assert {c['topic'] for c in given['commands'].values()} == {'cmd_vel'}
    assert given['isolation']['topic'] == 'isolation'
    assert {s.output for s in settings.sensors} == {'/robot2/odom', '/robot2/imu'}
    assert settings.isolation_topic == '/robot2/isolation'
    assert next(c.sure for c in wired.choices if c.wanted.name == 'wheel_speed')
    assert wired_text(wired).count('__ns:=/robot2') == 1
    assert '/robot2/driver: --ros-args -r /robot2/odom:=/robot2/odom_raw' in wired.remappings


def test_what_is_not_below_the_namespace_is_never_sure(base):
    _, given, wired = wire(base, base_graph(('/imu', Imu, '/imu_driver'), namespace='/robot2'))
    assert given['sensors']['wheel_speed']['topic'] == '/odom'
    assert not any(c.sure for c in wired.choices)
    assert '# NOT SURE; it is not below /robot2; it may be' in wired_text(wired)
