"""What README and docs say of names, defaults and files is what there is."""

import ast
from pathlib import Path
import re

import pytest

from vsensor_ros.node.known import GENERAL

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'docs').glob('*.md'))]
README = PAGES[0].read_text('utf-8')


def section(title):
    return README.partition(f'\n## {title}\n')[2].partition('\n## ')[0]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = page.read_text('utf-8')
    for target in re.findall(r'\]\(([^)#:]+)(?:#[\w-]*)?\)', text):
        assert (page.parent / target).exists(), target
    for command in re.findall(r'ros2 run vsensor_ros (\w+)', text):
        assert command == 'X' or (ROOT / 'scripts' / command).is_file(), command


def test_parameters_are_those_of_the_node():
    rows = [[cell.strip() for cell in line.split('|')[1:-1]]
            for line in section('Parameters').splitlines() if line.startswith('| `')]
    told = {name: row for row in rows for name in re.findall(r'`([a-z][\w.]*)`', row[0])}
    for name, (_, default, live, _) in told.items():
        if name.startswith(('sensors', 'commands', 'isolation')):
            continue
        known = GENERAL[name]
        shown = re.fullmatch(r'`?([\w.]+?)`?(?: \w+)?', default)
        assert default == 'must be given' if known.default is None else \
            shown and shown[1] == str(known.default).replace('True', 'true'), name
        assert live == ('yes' if known.live else ''), name
    assert set(GENERAL) <= set(told)


def test_the_keys_of_the_status_are_those_sent():
    tree = ast.parse((ROOT / 'vsensor_ros/node/status.py').read_text('utf-8'))
    sent = {key.value for function in tree.body if isinstance(function, ast.FunctionDef)
            and function.name in ('_status_facts', '_health_facts')
            for node in ast.walk(function) if isinstance(node, ast.Dict)
            for key in node.keys if isinstance(key, ast.Constant)}
    told = section('Topics').partition('**`~/status`**')[2]
    assert sent
    assert set(re.findall(r'`(\w+)`', told)) - {'replacer'} == sent
    assert '`clock_*`' in told
