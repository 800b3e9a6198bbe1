"""Every complaint in docs/complaints.md has an answer, and the tests that show it exist."""

import ast
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[1]
COMPLAINTS = re.split(r'^## (?=\d)', (ROOT / 'docs/complaints.md').read_text('utf-8'),
                      flags=re.MULTILINE)[1:]


def names_in(path):
    """Return the names of the tests of a file, without running it."""
    return {node.name for node in ast.parse((ROOT / path).read_text('utf-8')).body
            if isinstance(node, ast.FunctionDef) and node.name.startswith('test_')}


def test_there_are_34():
    assert [int(text.partition('.')[0]) for text in COMPLAINTS] == list(range(1, 35))


@pytest.mark.parametrize('text', COMPLAINTS, ids=lambda text: text.partition('\n')[0])
def test_each_is_answered_and_shown(text):
    parts = dict(re.findall(r'^- (Elsewhere|Here|Shown by):\s+(.+?)(?=^- |\Z)', text,
                            flags=re.MULTILINE | re.DOTALL))
    assert set(parts) == {'Elsewhere', 'Here', 'Shown by'}
    assert re.search(r'\w#\d+', parts['Elsewhere'])
    shown = re.findall(r'`([^`]+)`', parts['Shown by'])
    assert shown and all(name.count('::') == 1 for name in shown)
    for path, _, name in (name.partition('::') for name in shown):
        assert name in names_in(path), f'{path} has no {name}'
