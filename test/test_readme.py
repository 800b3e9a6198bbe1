"""What README and docs say of names, defaults and files is what there is."""

import ast
from pathlib import Path
import re

import pytest

ROOT = Path(__file__).parents[1]
README, TOPICS = ROOT / 'README.md', ROOT / 'docs' / 'topics.md'
PAGES = [README, ROOT / 'CONTRIBUTING.md', *sorted((ROOT / 'docs').glob('*.md'))]


def section(page, title):
    return page.read_text('utf-8').partition(f'\n## {title}\n')[2].partition('\n## ')[0]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = page.read_text('utf-8')
    for target in re.findall(r'\]\(([^)#:]+)(?:#[\w-]*)?\)', text):
        assert (page.parent / target).exists(), target
    for command in re.findall(r'(?:ros2 run vsensor_ros |-m vsensor_ros\.command\.)(\w+)', text):
        assert command == 'X' or (ROOT / 'scripts' / command).is_file(), command


def test_readme_is_short_and_leads_to_every_page():
    text = README.read_text('utf-8')
    assert len(text.splitlines()) <= 160
    contributing = (ROOT / 'CONTRIBUTING.md').read_text('utf-8')
    for page in sorted((ROOT / 'docs').glob('*.md')):
        assert f'docs/{page.name}' in text + contributing, page.name


def test_the_env_of_the_quick_start_is_that_of_make():
    """What a node from .venv needs in a terminal is what make gives its own."""
    told = dict(re.findall(r'^ +export (\w+)=(\S+)', README.read_text('utf-8'), re.MULTILINE))
    given = dict(re.findall(r'^export (\w+) := (\S+)', (ROOT / 'Makefile').read_text('utf-8'),
                            re.MULTILINE))
    here = {'$VIRTUAL_ENV': '$(CURDIR)/.venv', '$PWD': '$(CURDIR)'}
    assert len(told) >= 3
    for name, value in told.items():
        for shell, make in here.items():
            value = value.replace(shell, make)
        assert given[name] == value


@pytest.mark.parametrize('indented', [True, False], ids=['raw', 'rendered'])
def test_python_in_the_readme_runs_as_it_is_copied(indented):
    """A terminal is given what stands in the raw file, indented, or on the rendered page."""
    text = README.read_text('utf-8')
    scripts = re.findall(r'^ +python -c "([^"]*)"', text if indented else re.sub(
        '^    ', '', text, flags=re.MULTILINE).replace('python -c', ' python -c'), re.MULTILINE)
    assert scripts
    for script in scripts:
        compile(script, 'README.md', 'exec')


def test_the_quick_start_writes_below_build_alone():
    start = section(README, 'Quick start').partition('From `.venv`')[2]
    assert re.findall(r'(?:-o|>) (\S+)', start.partition('**On your own')[0]) == [
        'build/servo.design.json', 'build/servo.csv']


def test_the_keys_of_the_status_are_those_sent():
    tree = ast.parse((ROOT / 'vsensor_ros/node/status.py').read_text('utf-8'))
    sent = {key.value for function in tree.body if isinstance(function, ast.FunctionDef)
            and function.name in ('_status_facts', '_loop_facts')
            for node in ast.walk(function) if isinstance(node, ast.Dict)
            for key in node.keys if isinstance(key, ast.Constant)}
    told = section(TOPICS, 'Status')
    assert sent
    assert set(re.findall(r'`(\w+)`', told)) - {'replacer'} == sent
    assert '`clock_*`' in told
