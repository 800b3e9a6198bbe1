"""The parameters that the laboratory reads are those that ROS reads, whatever form they have."""

import os
import sys

# before any ROS context is made
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)

import pytest
from rclpy.context import Context
from rclpy.node import Node

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.domain import reserved_domain
from vsensor_ros.lab.parameter_file import read_parameters

OWN = ('use_sim_time', 'start_type_description_service')
BODY = '{ros__parameters: {rate: 50.0, sensors: {y1: {topic: /a, dwell: 1.5}}, recovery.dwell: 4}}'


@pytest.fixture(scope='module')
def domain():
    with reserved_domain() as number:
        yield number


def as_ros_reads(arguments, domain):
    """Return the full name of a replacer that is started so, and its parameters."""
    context = Context()
    context.init(args=arguments, domain_id=domain)
    node = Node('replacer', context=context, automatically_declare_parameters_from_overrides=True)
    given = {name: p.value for name, p in node.get_parameters_by_prefix('').items()
             if name not in OWN}
    name = node.get_fully_qualified_name()
    node.destroy_node()
    context.shutdown()
    return name, given


@pytest.mark.parametrize('text', [
    f'replacer: {BODY}', f'/replacer: {BODY}', f'/**: {BODY}', f"'**': {BODY}", f'/*: {BODY}',
    f'/**/replacer: {BODY}', f'/robot/replacer: {BODY}', f'robot/replacer: {BODY}',
    f'robot: {{replacer: {BODY}}}', f'/robot: {{replacer: {BODY}}}', f'/robot/arm: {BODY}',
    f'/**: {{ros__parameters: {{rate: 5.0, max_age: 1.0}}}}\nreplacer: {BODY}',
    f'replacer: {BODY}\n/**: {{ros__parameters: {{rate: 5.0, max_age: 1.0}}}}',
    f'driver: {{ros__parameters: {{rate: 5.0}}}}\n/robot/replacer: {BODY}',
    f'/robot: {{driver: {{ros__parameters: {{x: 1}}}}, replacer: {BODY}}}'])
@pytest.mark.parametrize('more', [
    (), ('-p', 'rate:=7.0'), ('-p', 'replacer:rate:=7.0', '-p', 'sensors.y1.topic:=/b')])
def test_what_is_read_is_what_ros_reads(tmp_path, domain, text, more):
    (tmp_path / 'replacer.yaml').write_text(text)
    found = read_parameters(tmp_path / 'replacer.yaml', more)
    assert found.node in ('/replacer', '/robot/replacer', '/robot/arm')
    name, given = as_ros_reads(found.command_line(tmp_path / 'changed.yaml'), domain)
    assert (found.node, dict(found.given)) == (name, given)
    _, given = as_ros_reads(found.command_line(
        tmp_path / 'changed.yaml', rate=3.0, design_file='d'), domain)
    assert given == {**found.given, 'rate': 3.0, 'design_file': 'd'}  # whoever said what before


@pytest.mark.parametrize('more', [
    ('-r', '__ns:=/robot'), ('--remap', '__ns:=robot'), ('-r', '__node:=x', '-r', '__ns:=/robot'),
    ('-r', '__name:=x', '-r', '__node:=y')])
def test_the_arguments_may_name_the_node(tmp_path, domain, more):
    (tmp_path / 'replacer.yaml').write_text(f'/**: {BODY}')
    found = read_parameters(tmp_path / 'replacer.yaml', more)
    name, given = as_ros_reads(['--ros-args', '--params-file', str(tmp_path / 'replacer.yaml'),
                                *[m if m != '__ns:=robot' else '__ns:=/robot' for m in more]],
                               domain)
    assert (found.node, dict(found.given)) == (name, given)
    assert (found.ros_args == ('-r', '__ns:=/robot')) == name.startswith('/robot')


def test_what_is_not_given_is_as_the_replacer_takes_it(tmp_path):
    (tmp_path / 'replacer.yaml').write_text(f'replacer: {BODY}')
    found = read_parameters(tmp_path / 'replacer.yaml')
    assert (found.general('rate'), found.general('without_estimate')) == (50.0, 'stop')
    assert (found.of('y1', 'dwell'), found.of('y2', 'dwell'), found.of('y1', 'max_age')) == (
        1.5, 4.0, 0.5)
    assert not found.simulated
    assert read_parameters(tmp_path / 'replacer.yaml', ['-p', 'use_sim_time:=true']).simulated
    (tmp_path / 'replacer.yaml').write_text(f'replacer: {BODY}'.replace('50.0', 'quick'))
    with pytest.raises(BadInput, match=r"replacer\.yaml: rate: 'quick' is not a number"):
        read_parameters(tmp_path / 'replacer.yaml').general('rate')


@pytest.mark.parametrize('text, told', [
    ('replacer: {ros__parameters: {rate: 1.0}}', 'is told of no sensors'),
    ('replacer: {ros__parameters: {sensors.a: !!python/name:os.system 1}}', 'cannot be read'),
    ('replacer: {ros__parameters: {sensors.a: 2001-99-99}}', 'cannot be read'),
    ('replacer: {ros__parameters: {sensors: {a: 1, a: 2}}}', 'stands there twice')])
def test_what_is_no_parameter_file_is_refused(tmp_path, text, told):
    (tmp_path / 'replacer.yaml').write_text(text)
    with pytest.raises(BadInput, match=told) as refusal:
        read_parameters(tmp_path / 'replacer.yaml')
    assert 'replacer.yaml' in str(refusal.value) and '\n' not in str(refusal.value)


def test_a_file_for_a_node_of_another_name_is_told_as_the_replacer_tells_it(tmp_path):
    path = tmp_path / 'replacer.yaml'
    path.write_text(f'replacer: {BODY}')
    with pytest.raises(BadInput) as refusal:
        read_parameters(path, ['-r', '__ns:=/robot1'])
    assert str(refusal.value).endswith(
        'is for /replacer, but this node is /robot1/replacer; write /**: or /robot1/replacer: '
        'above it')
