"""The one line for bad input."""

from vsensor_ros.bad_input import BadInput, shown


def test_parts_and_line():
    error = BadInput('plant.yaml', 'states.x', 'is missing', 'write it')
    assert str(error) == 'plant.yaml: states.x: is missing; write it'
    assert (error.where, error.key, error.problem, error.mend) == (
        'plant.yaml', 'states.x', 'is missing', 'write it')
    assert str(BadInput('plant.yaml', '', 'is empty', '')) == 'plant.yaml: is empty'


def test_always_one_printable_line_of_bounded_length():
    line = str(BadInput('a\nb', 'k' * 9999, 'p\r\n\x1b[31m' + 'p' * 9999, 'm\x00' * 9999))
    assert line.isprintable() and len(line) < 1000


def test_shown_is_quoted_and_cut():
    assert shown('a\n') == r"'a\n'"
    assert len(shown('x' * 10**6)) == len(shown([1] * 999)) == 60
    assert shown('abcdefghij', 8) == "'abcd..."
