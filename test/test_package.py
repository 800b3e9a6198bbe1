"""The package as a whole: its metadata, its import arrows, and that both installers place it."""

import ast
from configparser import ConfigParser
from functools import cache
from graphlib import CycleError, TopologicalSorter
from importlib.metadata import entry_points
from importlib.util import find_spec, module_from_spec, spec_from_file_location
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / 'vsensor_ros'
COMMANDS = ('align', 'check', 'demo', 'designer', 'fault_injection', 'fit', 'isolator', 'monitor',
            'player', 'recording', 'replacer', 'replay', 'start', 'wire')
SOURCES = sorted(PACKAGE.rglob('*.py'))

LEAVES = {'bad_input', 'reason', 'text_file', 'whole_file'}
ARROWS = {  # room: what it may import besides itself
    **dict.fromkeys(LEAVES, LEAVES),
    'functions': LEAVES,
    'plant': LEAVES | {'functions'},
    'observers': LEAVES | {'functions'},
    'designer': LEAVES | {'functions', 'plant', 'observers'},
    'control': LEAVES | {'functions', 'plant', 'observers', 'designer'},
    'bank': LEAVES | {'functions', 'observers'},
    'isolator': LEAVES | {'observers'},
    'engine': LEAVES | {'bank', 'isolator', 'observers'},
    'node': LEAVES | {'engine', 'bank', 'isolator', 'observers'},
    'simulate': LEAVES | {'functions', 'plant'},
    'first_plant': LEAVES | {'functions', 'plant', 'recordings'},
    'report': LEAVES | {'functions', 'plant', 'observers', 'designer', 'control', 'bank',
                        'simulate'},
    'lab': LEAVES | {'functions', 'plant', 'observers', 'designer', 'node', 'simulate'},
    'commissioning': LEAVES | {'plant', 'observers', 'engine', 'node', 'lab'},
    'recordings': LEAVES | {'plant', 'observers', 'engine', 'isolator', 'node', 'lab',
                            'commissioning'},
    'fitting': LEAVES | {'functions', 'plant', 'recordings'},
    'command': LEAVES | {'plant', 'observers', 'designer', 'control', 'node', 'simulate',
                         'report', 'lab', 'commissioning', 'recordings', 'engine', 'isolator',
                         'first_plant', 'fitting'},
}
WITH_ROS = {'node', 'lab', 'commissioning', 'command'}  # the only rooms that may import ROS
DESK = {'clarabel', 'control', 'cvxpy', 'filterpy', 'flint', 'jinja2', 'matplotlib', 'mujoco',
        'pandas', 'pinocchio', 'pint', 'pooch', 'pyarrow', 'rich', 'rosbags', 'ruamel', 'sympy',
        'threadpoolctl'}  # never on the machine


def run(*command, cwd=ROOT, **environment):
    """Return what a command wrote to stdout and stderr; fail with both if the command fails."""
    done = subprocess.run([str(part) for part in command], cwd=cwd, capture_output=True, text=True,
                          env={**os.environ, **environment}, timeout=300)
    assert done.returncode == 0, f'{command}\n{done.stdout}\n{done.stderr}'
    return done.stdout, done.stderr


@cache
def import_statements(path):
    """Return all of a source file, anywhere in it."""
    return [node for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
            if isinstance(node, (ast.Import, ast.ImportFrom))]


def imports_of(path):
    """Return the dotted names of all modules that a source file imports, anywhere in it."""
    names = set()
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f'{path}: imports are written in full, not relative'
            names |= ({f'vsensor_ros.{alias.name}' for alias in node.names}
                      if node.module == 'vsensor_ros' else {node.module})
    return names


def room_of(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix('.py')


def is_ros(name):
    return name in ('rclpy', 'ament_index_python') or name.endswith(
        ('_msgs', '_srvs', '_interfaces'))


def files_below(folder):
    return {path.relative_to(folder) for path in folder.rglob('*')
            if path.is_file() and path.suffix != '.pyc'}


def copy_of_sources(folder):
    """Copy what is installed from, so that building leaves nothing in the repository."""
    folder.mkdir(parents=True)
    for name in ('package.xml', 'setup.py', 'setup.cfg', 'pyproject.toml', 'LICENSE'):
        shutil.copy2(ROOT / name, folder)
    for name in ('vsensor_ros', 'resource', 'config', 'launch', 'scripts'):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns('__pycache__'))
    return folder


def assert_found_by_ros2(prefix):
    """Check that a prefix holds what `ros2 run` and `ros2 launch` look for."""
    assert (prefix / 'share/ament_index/resource_index/packages/vsensor_ros').is_file()
    assert (prefix / 'share/vsensor_ros/package.xml').is_file()
    executables = {path.name for path in (prefix / 'lib/vsensor_ros').iterdir()
                   if os.access(path, os.X_OK)}
    assert executables == set(COMMANDS)
    share = prefix / 'share/vsensor_ros'
    assert files_below(share / 'config') == files_below(ROOT / 'config')
    # as `ros2 launch` does, which follows no links to folders
    found = {Path(folder, name).relative_to(share / 'launch')
             for folder, _, names in os.walk(share)
             for name in names if name.endswith('.launch.py')}
    assert found == files_below(ROOT / 'launch') != set()


def assert_placed(prefix):
    """Check that a prefix holds what ROS looks for and every module; return their folder."""
    assert_found_by_ros2(prefix)
    library = next(prefix.glob('lib/python*/site-packages'))
    assert files_below(library / 'vsensor_ros') == files_below(PACKAGE)
    return library


def test_package_xml_is_valid():
    package_module = pytest.importorskip('catkin_pkg.package')
    warnings = []
    package = package_module.parse_package(str(ROOT / 'package.xml'), warnings=warnings)
    package.validate(warnings=warnings)
    assert warnings == []
    assert package.name == 'vsensor_ros'
    assert package.get_build_type() == 'ament_python'


def test_version_is_the_same_everywhere():
    declared = re.search(r'<version>(.+)</version>', (ROOT / 'package.xml').read_text())[1]
    version, _ = run(sys.executable, 'setup.py', '--version')
    assert version.split() == [declared]  # and nothing more: colcon parses what setup.py prints
    changes = (ROOT / 'CHANGELOG.rst').read_text()
    assert re.search(r'^(\d+\.\d+\.\d+) \(', changes, re.MULTILINE)[1] == declared


def test_every_import_is_declared():
    setup = ConfigParser()
    setup.read(ROOT / 'setup.cfg')
    declared = {
        {'pyyaml': 'yaml', 'pin': 'pinocchio', 'python-flint': 'flint'}.get(name, name)
        for text in (setup['options']['install_requires'],
                     setup['options.extras_require']['designer'],
                     setup['options.extras_require']['recordings'],
                     setup['options.extras_require']['fit'].replace('ruamel.yaml', 'ruamel'),
                     setup['options.extras_require']['tools'],
                     setup['options.extras_require']['mujoco'],
                     setup['options.extras_require']['urdf'])
        for line in text.split() for name in [re.split(r'[<>=~]', line)[0].lower()]
    }
    xml = (ROOT / 'package.xml').read_text()
    for path in (ROOT / 'launch').glob('*.py'):
        for name in {name.split('.')[0] for name in imports_of(path)}:
            assert name in sys.stdlib_module_names or \
                f'<exec_depend>{name}</exec_depend>' in xml, f'{path}: {name}'
    for path in SOURCES:
        for name in {name.split('.')[0] for name in imports_of(path)}:
            if name in sys.stdlib_module_names or name == 'vsensor_ros':
                continue
            if is_ros(name):
                assert f'<exec_depend>{name}</exec_depend>' in xml, f'{path}: {name}'
            else:
                assert name in declared, f'{path}: {name}'


@pytest.mark.parametrize('path', SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_import_arrows(path):
    room = room_of(path)
    if path == PACKAGE / '__init__.py':
        return  # the front door, which opens each room when it is asked for
    assert room in ARROWS, f'{room} is not a room of the house'
    imported = imports_of(path)
    rooms = {name.split('.')[1] for name in imported if name.startswith('vsensor_ros.')}
    assert rooms <= ARROWS[room] | {room}
    if room not in WITH_ROS:
        assert not any(is_ros(name.split('.')[0]) for name in imported)


def files_imported_by(path):
    """Return the files of the package that a file imports, wherever in it."""
    files = set()
    for node in import_statements(path):
        if isinstance(node, ast.Import):
            files |= {file_of(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):  # of a file of the room, or of the room itself
            files |= {file_of(f'{node.module}.{alias.name}') or file_of(node.module)
                      for alias in node.names}
    return files - {path, None}


def file_of(name):
    """Return the file of a module of the package, or None."""
    place = ROOT / name.replace('.', '/')
    return next((file for file in (place.with_suffix('.py'), place / '__init__.py')
                 if file in SOURCES), None)


def test_imports_run_in_no_circle():
    """Neither when a module is loaded, nor later in a function."""
    front_door = PACKAGE / '__init__.py'  # opens each room when it is asked for
    graph = {path: files_imported_by(path) for path in SOURCES if path != front_door}
    assert sum(map(len, graph.values())) > 100
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(' <- '.join(str(path.relative_to(PACKAGE)) for path in error.args[1]))


@pytest.mark.parametrize('path', [p for p in SOURCES if p.parent.name == 'injection'],
                         ids=lambda path: path.name)
def test_faults_are_injected_from_outside(path):
    """What judges a replacer shares nothing with it but the access to messages."""
    assert {name for name in imports_of(path) if name.startswith(
        ('vsensor_ros.node', 'vsensor_ros.bank', 'vsensor_ros.engine'))} <= {
            'vsensor_ros.node.accessor', 'vsensor_ros.node.private_rclpy'}


def test_core_runs_without_ros():
    core = ['vsensor_ros', *(f'vsensor_ros.{room}' for room in sorted(ARROWS.keys() - WITH_ROS)),
            'vsensor_ros.command.designer']
    run(sys.executable, '-c', f"""
import importlib, sys
class NoRos:
    def find_spec(self, name, path=None, target=None):
        if name.split('.')[0] in ('rclpy', 'ament_index_python') or name.endswith('_msgs'):
            raise ImportError(name + ' is blocked')
sys.meta_path.insert(0, NoRos())
for name in {core}:
    importlib.import_module(name)
from vsensor_ros import Design, Plant, design, load_plant
assert callable(design) and callable(load_plant)
""")


def test_machine_never_loads_the_desk():
    pytest.importorskip('rclpy')
    # one after the other: what the command loads when it starts is the node
    run(sys.executable, '-c', f"""
import importlib, sys
for module in ('functions', 'observers', 'bank', 'isolator', 'engine', 'command.replacer', 'node'):
    importlib.import_module('vsensor_ros.' + module)
    loaded = {{name.split('.')[0] for name in sys.modules}} & {DESK}
    rooms = {{'vsensor_ros.' + room for room in ('plant', 'designer', 'simulate')}} & set(
        sys.modules)
    assert not loaded and not rooms, (module, loaded, rooms)
""")


@pytest.mark.parametrize('name', COMMANDS)
def test_executable(name):
    script = ROOT / 'scripts' / name
    assert script.stat().st_mode & 0o777 == 0o755
    assert script.read_text().startswith('#!/usr/bin/env python3\n')
    assert f'from vsensor_ros.command.{name} import main' in script.read_text()
    tree = ast.parse((PACKAGE / 'command' / f'{name}.py').read_text())
    assert 'main' in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


def test_make_links_what_an_editable_install_leaves_out(tmp_path, monkeypatch):
    spec = spec_from_file_location('make_venv', ROOT / 'tools' / 'make_venv.py')
    make_venv = module_from_spec(spec)
    spec.loader.exec_module(make_venv)
    monkeypatch.setattr(make_venv, 'VENV', tmp_path)
    make_venv.link_ament_index()
    assert_found_by_ros2(tmp_path)


def test_names_on_the_path_are_ours_alone():
    scripts = [script for script in entry_points(group='console_scripts')
               if script.value.startswith('vsensor_ros.')]
    assert {script.name for script in scripts} == {'vsensor_designer', 'vsensor_replacer'}
    for script in scripts:
        assert callable(script.load())


@pytest.mark.slow
def test_pip_install(tmp_path):
    source = copy_of_sources(tmp_path / 'source')
    prefix = tmp_path / 'prefix'
    run(sys.executable, '-m', 'pip', 'install', '--quiet', '--no-index', '--no-deps',
        '--no-build-isolation', '--ignore-installed', '--prefix', prefix, source)
    library = assert_placed(prefix)
    assert {path.name for path in (prefix / 'bin').iterdir()} == {
        'vsensor_designer', 'vsensor_replacer'}
    plant = prefix / 'share/vsensor_ros/config/three_tank/plant.yaml'
    # from elsewhere, with the installed copy alone, as `ros2 run` would start it
    said, _ = run(sys.executable, prefix / 'lib/vsensor_ros/designer', plant,
                  '-o', tmp_path / 'three_tank.design.json', cwd=tmp_path,
                  PYTHONPATH=str(library))
    assert 'y1' in said
    assert (tmp_path / 'three_tank.design.json').is_file()


@pytest.mark.slow
def test_colcon_build(tmp_path):
    if find_spec('colcon_ros') is None:
        pytest.skip('colcon is not installed here')
    copy_of_sources(tmp_path / 'src' / 'vsensor_ros')
    said, warned = run(
        sys.executable, '-c', 'from colcon_core.command import main; raise SystemExit(main())',
        'build', cwd=tmp_path, COLCON_HOME=str(tmp_path / 'home'), AMENT_PREFIX_PATH='')
    assert 'Finished <<< vsensor_ros' in said
    assert 'WARNING' not in warned, warned  # an invalid package.xml is no more than that
    assert_placed(tmp_path / 'install' / 'vsensor_ros')
