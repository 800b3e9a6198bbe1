"""The one line for bad input."""

import pytest

from vsensor_ros.bad_input import BadInput, reason, shown


def test_parts_and_line():
    error = BadInput('plant.yaml', 'states.x', 'is missing', 'write it')
    assert str(error) == 'plant.yaml: states.x: is missing; write it'
    assert (error.where, error.key, error.problem, error.mend) == (
        'plant.yaml', 'states.x', 'is missing', 'write it')
    assert str(BadInput('plant.yaml', '', 'is empty', '')) == 'plant.yaml: is empty'


def test_always_one_printable_line_of_bounded_length():
    line = str(BadInput('a\nb', 'k' * 9999, 'p\r\n\x1b[31m' + 'p' * 9999, 'm\x00' * 9999))
    assert line.isprintable() and len(line) < 1000


@pytest.mark.parametrize('error', [
    ValueError('embedded null byte'), ValueError('lstat: embedded null character in path')])
def test_every_python_gives_the_same_reason(error):
    assert reason(error) == 'embedded null byte'
    assert reason(FileNotFoundError(2, 'No such file')) == 'No such file'


def test_shown_is_quoted_and_cut():
    assert shown('a\n') == r"'a\n'"
    assert len(shown('x' * 10**6)) == len(shown([1] * 999)) == 60
    assert shown('abcdefghij', 8) == "'abcd..."
