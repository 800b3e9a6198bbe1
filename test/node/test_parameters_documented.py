"""The documents name every parameter there is, as it is."""

import math
from pathlib import Path

import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
import yaml

from vsensor_ros.node.endpoints import LONGEST_TOPIC
from vsensor_ros.node.known import GENERAL, LONGEST_TEXT, named
from vsensor_ros.node.lifecycle import ManagedNode
from vsensor_ros.node.parameter_file import check_files, LARGEST_FILE
from vsensor_ros.node.parameters import LARGEST_NUMBER, LONGEST_NAME, read
from vsensor_ros.node.qos import qos_parameters
from vsensor_ros.observers import Design

ROOT = Path(__file__).parents[2]
COMPLETE = ROOT / 'config' / 'replacer.yaml'
DOCUMENT = ROOT / 'docs' / 'parameters.md'
HEAD = ('| name | type | default | unit | values | live | meaning |\n'
        '|---|---|---|---|---|---|---|\n')
TYPES = {str: 'text', float: 'number', int: 'whole number', bool: 'true or false',
         list: 'list of texts'}


def design(sensors, inputs):
    return Design('servo', '0' * 64, ('x',), inputs, sensors, {}, None, {})


SERVO = design(('y1', 'y2', 'y3'), ('voltage',))


def row(name, entry):
    if entry.choices:
        values = ', '.join(f'`{choice}`' for choice in entry.choices)
    elif math.isfinite(entry.low):
        values = entry.limits()
    else:
        values = ''
    values = ', '.join([*(f'`{word}`' for word in entry.words), values])
    default = 'must be given' if entry.default is None else f'`{entry.default!r}`'
    if name.startswith('qos_overrides.'):
        default = 'as opened'
    if entry.type is bool:
        default = f'`{str(entry.default).lower()}`'
    live = 'yes' if entry.live else ''
    meaning = entry.description.removesuffix(' of the <end> on <topic>').replace('<name>', 'it')
    return f'| `{name}` | {TYPES[entry.type]} | {default} | {entry.unit} | {values} | {live} | ' \
        f'{meaning} |\n'


def tables():
    known = named(design(('<name>',), ('<name>',)))
    sensors = {name: entry for name, entry in known.items() if name.startswith('sensors.')}
    commands = {name: entry for name, entry in known.items() if name.startswith('commands.')}
    return [HEAD + ''.join(row(name, entry) for name, entry in part.items())
            for part in (GENERAL, sensors, commands, qos_parameters([('<topic>', '<end>')]))]


def test_the_tables_are_those_of_the_parameters():
    text = DOCUMENT.read_text(encoding='utf-8')
    for table in tables():
        assert table in text
    assert text.count('\n| `') == sum(table.count('\n| `') for table in tables())


def test_the_bounds_are_those_in_force():
    text = ' '.join(DOCUMENT.read_text(encoding='utf-8').split())
    assert LARGEST_FILE == 2**20
    assert (f'at most 1 MiB, a value at most {LONGEST_TEXT} characters, a topic at most '
            f'{LONGEST_TOPIC}, the name of a sensor or an input at most {LONGEST_NAME}; a design '
            f'has at most {LARGEST_NUMBER} sensors') in text


def leaves(tree, place=''):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f'{place}{key}.')
        else:
            yield f'{place}{key}', value


@pytest.fixture(scope='module')
def design_path(tmp_path_factory):
    path = tmp_path_factory.mktemp('design') / 'servo.json'
    SERVO.save(path)
    return path


@pytest.fixture
def context():
    context = Context()
    yield context
    context.shutdown()


def test_the_complete_file_loads(context, design_path):
    block, = check_files(['--params-file', str(COMPLETE)])
    assert block.nodes == '/**'
    context.init(args=['--ros-args', '--params-file', str(COMPLETE)])
    node = Node('replacer', context=context, automatically_declare_parameters_from_overrides=True,
                parameter_overrides=[Parameter('design_file', value=str(design_path))])
    settings = read(node)
    node.destroy_node()
    assert settings.design.sensors == tuple(s.name for s in settings.sensors) == ('y1', 'y2', 'y3')
    assert settings.rate == 100.0 and settings.live.time_constant == 0.5


def given():
    tree = yaml.safe_load(COMPLETE.read_text(encoding='utf-8'))['/**']['ros__parameters']
    return dict(leaves(tree))


def qualities(values):
    return {name: value for name, value in values.items() if name.startswith('qos_overrides.')}


def test_its_qualities_are_those_with_which_the_topics_are_opened(context, design_path):
    context.init()
    node = ManagedNode(context, [
        Parameter(name, value=value)
        for name, value in {**given(), 'design_file': str(design_path)}.items()
        if name not in qualities(given())])
    node.trigger_configure()
    opened = qualities({name: parameter.value
                        for name, parameter in node.get_parameters_by_prefix('').items()})
    node.trigger_shutdown()
    node.destroy_node()
    assert opened == qualities(given())


def test_the_complete_file_is_complete_and_holds_the_defaults():
    values = given()
    topics = [tuple(name.split('.')[1:3]) for name in qualities(values)]
    known = {**GENERAL, **named(SERVO), **qos_parameters(topics)}
    assert set(values) == {*known, 'use_sim_time'}
    for name, entry in known.items():
        if entry.default is not None and not name.endswith('.input') and 'qos_' not in name:
            assert values[name] == entry.default, name
            assert type(values[name]) is type(entry.default), name


def test_the_complete_file_tells_what_may_change():
    text = COMPLETE.read_text(encoding='utf-8')
    (_, below), = yaml.compose(text).value
    (_, tree), = below.value
    known = {**GENERAL, **named(design(('y1',), ()))}
    told = {name: '# live' in text.split('\n')[number] for name, number in lines(tree)
            if name in known}
    assert told == {name: entry.live for name, entry in known.items()}


def lines(tree, place=''):
    for key, value in tree.value:
        if isinstance(value, yaml.MappingNode):
            yield from lines(value, f'{place}{key.value}.')
        else:
            yield f'{place}{key.value}', key.start_mark.line
