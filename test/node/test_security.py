"""The policy in config/security against the node that it is for."""

from pathlib import Path
import sys
from xml.etree import ElementTree

import pytest
import yaml

from vsensor_ros.observers import Design, Refusal

sys.path.append(str(Path(__file__).parent))
from managed_rig import Machine

CONFIG = Path(__file__).parents[2] / 'config'
PROFILE = './enclaves/enclave/profiles/profile'


@pytest.fixture(scope='module')
def policy():
    return ElementTree.parse(CONFIG / 'security' / 'replacer.policy.xml').getroot()


def allowed(policy, kind, what):
    return [name.text for group in policy.findall(f'{PROFILE}/{kind}s')
            if group.get(what) == 'ALLOW' for name in group]


def flatten(tree, prefix=''):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from flatten(value, f'{prefix}{key}.')
        else:
            yield f'{prefix}{key}', value


def test_it_is_a_policy_of_sros2_for_this_node(policy):
    assert (policy.tag, policy.get('version')) == ('policy', '0.2.0')
    assert [e.get('path') for e in policy.findall('./enclaves/enclave')] == [
        '/vsensor_ros/replacer']
    assert [p.attrib for p in policy.findall(PROFILE)] == [{'ns': '/', 'node': 'replacer'}]
    groups = [g for p in policy.findall(PROFILE) for g in p]
    assert {(g.tag, *g.attrib) for g in groups} == {
        ('topics', 'publish'), ('topics', 'subscribe'), ('services', 'reply')}
    for group in groups:
        assert set(group.attrib.values()) == {'ALLOW'}
        for name in group:
            assert name.tag == group.tag[:-1]
            assert name.text.startswith('/') and '*' not in name.text  # least privilege


def test_it_allows_what_the_node_does_and_nothing_more(policy, tmp_path):
    given = yaml.safe_load((CONFIG / 'servo' / 'replacer.yaml').read_text())
    parameters = dict(flatten(given['/**']['ros__parameters']))
    # what the virtual sensors are does not matter to names
    names = ('y1', 'y2', 'y3')
    Design('servo', '0' * 64, ('angle',), ('voltage',), names, {}, None,
           {((s,), s): Refusal(s, (s,), 'not designed here') for s in names}
           ).save(tmp_path / 'servo.json')
    machine = Machine({**parameters, 'design_file': str(tmp_path / 'servo.json')})
    try:
        assert machine.spin_until(machine.node.active.is_set)
        node = machine.node
        for kind, what, look in (
                ('topic', 'publish', node.get_publisher_names_and_types_by_node),
                ('topic', 'subscribe', node.get_subscriber_names_and_types_by_node),
                ('service', 'reply', node.get_service_names_and_types_by_node)):
            names = allowed(policy, kind, what)
            assert sorted(names) == sorted(name for name, _ in look('replacer', '/')), what
        assert not node.get_client_names_and_types_by_node('replacer', '/')
    finally:
        machine.close()
