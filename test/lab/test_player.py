"""What the player publishes is the table, on the topics of the replacer's file."""

from dataclasses import replace
import os
from pathlib import Path
import sys
import time

# before any message class is loaded
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

from builtin_interfaces.msg import Time
import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.player import main
from vsensor_ros.lab import play as player
from vsensor_ros.lab.domain import reserved_domain
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.lab.play import LATCHED, play, START_TOPIC
from vsensor_ros.lab.wiring import blank, wiring_of
from vsensor_ros.node.accessor import get_stamp
from vsensor_ros.node.private_rclpy import take_all
from vsensor_ros.simulate.fault import drop_out, freeze, Recorded

CONFIG = Path(__file__).parents[2] / 'config'
TIME = np.arange(0.0, 0.3, 0.01)


@pytest.fixture
def node():
    with reserved_domain() as domain:
        context = Context()
        rclpy.init(context=context, domain_id=domain)
        node = rclpy.create_node('listener', context=context)
        yield node
        node.destroy_node()
        rclpy.shutdown(context=context)


def listen(node, kind, topic, qos=None):
    return node.create_subscription(kind, topic, lambda _: None, qos or QoSProfile(depth=999))


def taken(subscription):
    return (message for message, _ in take_all(subscription))


def read_wiring(path):
    return wiring_of(read_parameters(path))


def test_channels_of_one_message_travel_together(node):
    ports = read_wiring(CONFIG / 'servo' / 'replacer.yaml').ports
    angle = Recorded.of(TIME, np.sin(TIME))
    velocity = drop_out(freeze(Recorded.of(TIME, np.cos(TIME)), 0.1), 0.2)
    current = drop_out(angle, 0.25)
    channels = {'y1': drop_out(angle, 0.25), 'y2': velocity, 'y3': current,
                'voltage': drop_out(angle, 0.05)}
    states = listen(node, ports['y1'].kind, ports['y1'].source)
    voltages = listen(node, ports['voltage'].kind, ports['voltage'].source)
    start = listen(node, Time, START_TOPIC, LATCHED)
    play(node, channels, ports, 1.0)

    [begun] = taken(start)
    messages = list(taken(states))
    stamps = np.array([get_stamp(m) - begun.sec * 10**9 - begun.nanosec for m in messages])
    np.testing.assert_array_equal(stamps, np.round(TIME[TIME < 0.25] * 1e9))
    assert messages[0].name == ['motor']
    said = np.array([[m.position[0], m.velocity[0], m.effort[0]] for m in messages])
    silent = np.where(velocity.sent, velocity.value, np.nan)
    np.testing.assert_array_equal(said, np.c_[angle.value, silent, angle.value][:len(said)])
    assert [m.data for m in taken(voltages)] == list(angle.value[TIME < 0.05])


def test_simulated_time_is_on_a_topic_at_any_speed(node, tmp_path, monkeypatch):
    path = tmp_path / 'replacer.yaml'
    path.write_text('replacer: {ros__parameters: {use_sim_time: true}}\n'
                    + (CONFIG / 'tclab' / 'replacer.yaml').read_text())
    (tmp_path / 'table.csv').write_text('time,T1\n0.0,20.0\n0.1,21.0\n')
    clock = listen(node, Clock, '/clock')
    readings = listen(node, Temperature, '/tclab/T1_raw')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(node.context.get_domain_id()))
    # on this node, which hears itself at once
    monkeypatch.setattr(player, 'play', lambda _, *given: play(node, *given))
    assert main([str(tmp_path / 'table.csv'), str(path)]) == 0
    ticks = [m.clock.sec * 10**9 + m.clock.nanosec for m in taken(clock)]
    assert len(ticks) > 2 and ticks[-1] - ticks[0] <= 10**8
    assert ticks[-1] == [get_stamp(m) for m in taken(readings)][-1]


def test_faster_than_real_time_the_clock_is_on_a_topic(node):
    ports = read_wiring(CONFIG / 'tclab' / 'replacer.yaml').ports
    times = 100.0 + np.arange(20.0)
    readings = listen(node, ports['T1'].kind, ports['T1'].source)
    clock = listen(node, Clock, '/clock')
    play(node, {'T1': Recorded.of(times, times)}, ports, 100.0)
    messages = list(taken(readings))
    assert [m.temperature for m in messages] == list(times)
    stamps = [get_stamp(m) for m in messages]
    assert set(np.diff(stamps)) == {10**9}
    ticks = [m.clock.sec * 10**9 + m.clock.nanosec for m in taken(clock)]
    assert np.all(np.diff(ticks) >= 0) and set(stamps) <= set(ticks)


@pytest.mark.parametrize('system', ['servo', 'tclab', 'three_tank'])
def test_shipped_wirings(system):
    wiring = read_wiring(CONFIG / system / 'replacer.yaml')
    for port in wiring.ports.values():
        message = blank([port])
        assert np.isnan(port.field.get(message))
        assert port.field.put(message, 1.5) is None and port.field.get(message) == 1.5
    assert wiring.isolation == '/isolation'


@pytest.mark.parametrize('text', ['', 'replacer: 3', 'a: [', 'replacer: {ros__parameters: 1}',
                                  'replacer: {ros__parameters: {sensors: {y: {topic: a}}}}'])
def test_what_is_no_wiring_is_refused(tmp_path, text):
    (tmp_path / 'replacer.yaml').write_text(text)
    with pytest.raises(BadInput, match=r'replacer\.yaml') as refusal:
        read_wiring(tmp_path / 'replacer.yaml')
    assert '\n' not in str(refusal.value)


def test_a_column_without_a_topic_is_refused(tmp_path, capsys):
    (tmp_path / 'table.csv').write_text('time,y9\n0,1\n')
    assert main([str(tmp_path / 'table.csv'), str(CONFIG / 'servo' / 'replacer.yaml')]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f'player: {tmp_path / "table.csv"}: y9: has no topic')


def test_wrong_arguments_for_ros_are_refused_in_one_line(tmp_path, capsys):
    (tmp_path / 'table.csv').write_text('time,y1\n0,1\n')
    assert main([str(tmp_path / 'table.csv'), str(CONFIG / 'servo' / 'replacer.yaml'),
                 '--ros-args', '-r', 'a b']) == 2
    said = capsys.readouterr().err
    assert said.startswith('player: arguments: ') and said.count('\n') == 1


def test_delays_are_told(node, monkeypatch):
    ports = read_wiring(CONFIG / 'tclab' / 'replacer.yaml').ports
    readings = listen(node, ports['T1'].kind, ports['T1'].source)
    slow = ports['T1'].field.put

    def put(message, value):
        time.sleep(0.05 if value == 3.0 else 0.0)
        return slow(message, value)
    field = replace(ports['T1'].field, put=put)
    late = play(node, {'T1': Recorded.of(TIME, np.arange(30.0))},
                {'T1': replace(ports['T1'], field=field)}, 1.0)
    assert late > 0.03 and len(list(taken(readings))) == 30


@pytest.mark.parametrize('name', ['/**', '/robot/replacer', 'robot'])
def test_whatever_way_a_parameter_file_names_the_node(tmp_path, name):
    shipped = CONFIG / 'servo' / 'replacer.yaml'
    root = yaml.safe_load(shipped.read_text())
    parameters = root['/**']['ros__parameters']
    for group in ('sensors', 'commands'):  # as ros2 param dump does not write it, but ROS reads it
        for channel, entry in parameters.pop(group).items():
            parameters.update({f'{group}.{channel}.{key}': x for key, x in entry.items()})
    path = tmp_path / 'replacer.yaml'
    below = {'replacer': root['/**']} if name == 'robot' else root['/**']
    path.write_text(yaml.safe_dump({name: below}))
    ports, expected = read_wiring(path).ports, read_wiring(shipped).ports
    inside = '' if name == '/**' else '/robot'
    assert {n: (p.source, p.output, p.field.path) for n, p in ports.items()} == {
        n: (inside + p.source, inside + p.output, p.field.path) for n, p in expected.items()}
    path.write_text('{other: {ros__parameters: {}}}')
    with pytest.raises(BadInput, match='give /replacer: ros__parameters'):
        read_wiring(path)
