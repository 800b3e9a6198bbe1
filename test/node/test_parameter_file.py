import os

import pytest

from vsensor_ros.node.known import Refused
from vsensor_ros.node.parameter_file import check_files


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
