import os

import pytest

from vsensor_ros.node.known import Refused
from vsensor_ros.node.parameter_file import check_files, fits, for_others, source_of


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



def check(tmp_path, *texts, more=()):
    arguments = ['--ros-args', *more]
    for i, text in enumerate(texts):
        (tmp_path / f'{i}.yaml').write_text(text)
        arguments += ['--params-file', str(tmp_path / f'{i}.yaml')]
    return check_files(arguments)


def test_who_is_given_what(tmp_path):
    blocks = check(
        tmp_path, 'robot: {replacer: {ros__parameters: {a: {b: 1}, c.d: 2}}}\n'
        '/**: {ros__parameters: {x: 1}}', 'replacer: {ros__parameters: {y: 1}}',
        more=['-p', 'rate:=1', '--param', 'replacer:sensors.y1.topic:=a:b'])
    assert [(b.path.rpartition('/')[2], b.nodes, set(b.names)) for b in blocks] == [
        ('', '/**', {'rate'}), ('', '/replacer', {'sensors.y1.topic'}),
        ('0.yaml', '/robot/replacer', {'a.b', 'c.d'}), ('0.yaml', '/**', {'x'}),
        ('1.yaml', '/replacer', {'y'})]


@pytest.mark.parametrize('pattern, node, fit', [
    ('/**', '/a/b', True), ('/*', '/a/b', False), ('/*/b', '/a/b', True), ('/**/b', '/b', True),
    ('/a/*', '/a/b', True), ('/a', '/a/b', False), ('/a.b', '/acb', False)])
def test_whom_a_name_fits(pattern, node, fit):
    assert fits(pattern, node) == fit


def test_what_is_meant_for_other_nodes(tmp_path):
    ours = {'design_file', 'sensors.y1.topic'}

    def meant(*texts, more=()):
        blocks = check(tmp_path, *texts, more=more)
        names = {name for block in blocks for name in block.names}
        return set(for_others(sorted(names), blocks, '/robot/replacer', ours))
    wide = '/**: {ros__parameters: {robot_name: x, update_rate: 50}}\n'
    assert meant(wide) == {'robot_name', 'update_rate'}
    assert meant(wide.replace('/**', '/robot/*')) == {'robot_name', 'update_rate'}
    assert meant(wide, '/**: {ros__parameters: {design_file: x, robot_nam: y}}') == {
        'robot_name', 'update_rate'}
    # what names this node is for this node
    assert meant(wide, '/robot/replacer: {ros__parameters: {robot_name: y}}') == {'update_rate'}
    assert meant(wide, '/*/replacer: {ros__parameters: {a: y}}') == {'robot_name', 'update_rate'}
    assert meant(wide, more=['-p', 'update_rate:=7']) == {'robot_name'}
    assert meant('/**: {ros__parameters: {a: 1, sensors: {y1: {topic: /y}}}}') == set()


def test_the_file_that_counts(tmp_path):
    """As rcl puts them together: by the nodes' names in the order of their first appearance."""
    a, b = '/**: {ros__parameters: {x: 1}}\n', 'replacer: {ros__parameters: {x: 2}}\n'

    def counts(*texts, more=()):
        path = source_of('x', check(tmp_path, *texts, more=more), '/replacer')
        return path.removeprefix(f'{tmp_path}/')
    assert counts(a, b) == '1.yaml'
    assert counts(a, b, a) == '1.yaml'
    assert counts(b, a) == '1.yaml'
    assert counts(a, a) == '1.yaml'
    assert counts(a, 'other: {ros__parameters: {x: 2}}') == '0.yaml'
    assert counts('other: {ros__parameters: {x: 2}}') == ''
    assert counts('/**: {ros__parameters: {y: 2}}', more=['-p', 'x:=1']) == ''


def test_a_parameter_file_that_is_not_there(tmp_path):
    with pytest.raises(Refused, match='cannot be read'):
        check_files(['--params-file', str(tmp_path / 'no.yaml')])
    with pytest.raises(Refused, match='not a regular file'):
        check_files(['--params-file', '/dev/null'])
    os.mkfifo(tmp_path / 'pipe')
    with pytest.raises(Refused, match='not a regular file'):
        check_files(['--params-file', str(tmp_path / 'pipe')])
    with pytest.raises(Refused, match='bytes: parameter file: is not UTF-8: line 1, byte 0xff;'):
        (tmp_path / 'bytes').write_bytes(b'\xff\xfe\x00')
        check_files(['--params-file', str(tmp_path / 'bytes')])
