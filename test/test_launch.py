"""
The launch file, read with stand-ins for `launch` and `launch_ros`, which the wheels lack.

The stand-ins take what the real ones take, and keep it: what ROS makes of it is not tried here.
"""

import importlib.util
from pathlib import Path
import sys
from types import ModuleType, SimpleNamespace

import pytest

LAUNCH_FILE = Path(__file__).parents[1] / 'launch' / 'replacer.launch.py'


class Configuration:
    def __init__(self, name):
        self.name = name

    def perform(self, context):
        return context[self.name]


@pytest.fixture
def launched(monkeypatch):
    """Return a function that launches with arguments, and returns what the node is given."""
    modules = {
        'launch': {'LaunchDescription': list, 'LaunchContext': dict},
        'launch.actions': {
            'DeclareLaunchArgument': lambda name, *, default_value, description:
                SimpleNamespace(name=name, default=default_value),
            'OpaqueFunction': lambda *, function: function},
        'launch.substitutions': {'LaunchConfiguration': Configuration},
        'launch_ros': {}, 'launch_ros.actions': {'LifecycleNode': lambda **given: given}}
    for name, content in modules.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location('replacer_launch', LAUNCH_FILE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def launch(**given):
        *arguments, make = module.generate_launch_description()
        defaults = {a.name: a.default for a in arguments}
        assert set(given) <= set(defaults)
        context = {**defaults, **given}
        assert [name for name, value in context.items() if value is None] == []
        node, = make(context)
        parameters = [{k: v.perform(context) for k, v in p.items()} if isinstance(p, dict) else p
                      for p in node['parameters']]
        return (*(node[key].perform(context) for key in ('name', 'namespace')), *parameters)
    return launch


def test_what_the_node_is_given(launched, tmp_path, monkeypatch):
    path = tmp_path / 'replacer.yaml'
    path.write_text('')
    more = {'use_sim_time': 'false', 'autostart': 'true'}
    assert launched(params_file=str(path)) == ('replacer', '', str(path), more)
    monkeypatch.setenv('HOME', str(tmp_path))
    assert launched(params_file='~/replacer.yaml', name='guard', namespace='robot1') == (
        'guard', 'robot1', str(path), more)
    monkeypatch.chdir(tmp_path)
    assert launched(params_file='replacer.yaml')[2] == str(path)


def test_a_file_that_is_not_there(launched, tmp_path, monkeypatch):
    """Launch would only warn, and the node complain of a design file."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(FileNotFoundError, match=f'no.yaml: there is no file {tmp_path}/no.yaml'):
        launched(params_file='no.yaml')
