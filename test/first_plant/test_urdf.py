"""Chains of a URDF: their equations beside pinocchio's forward dynamics."""

import re
import sys

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.command.start import main
from vsensor_ros.first_plant import urdf_plant, write_plant
from vsensor_ros.plant import read_yaml

BASE = '<robot name="test"><link name="base"/>{}</robot>'


def joint(i, kind='revolute', axis='0 0 1', rng=None, dynamics='damping="0.5" friction="0.2"'):
    """Return a link with its joint, of random shape."""
    A = rng.normal(size=(3, 3)) * 0.05
    mass = rng.uniform(0.5, 4.0)
    inertia = mass * (A @ A.T + 0.01 * np.eye(3))
    numbers = [' '.join(repr(float(x)) for x in rng.uniform(low, high, 3)) for low, high in (
        (-0.1, 0.1), (-3, 3), (-0.3, 0.3), (-3, 3))]
    entries = ' '.join(f'i{"xyz"[a]}{"xyz"[b]}="{inertia[a, b]}"' for a in range(3)
                       for b in range(a, 3))
    parent = f'l{i - 1}' if i else 'base'
    return (f'<link name="l{i}"><inertial><origin xyz="{numbers[0]}" rpy="{numbers[1]}"/><mass '
            f'value="{mass}"/><inertia {entries}/></inertial><visual><geometry><mesh '
            f'filename="package://nowhere/a.stl"/></geometry></visual></link>'
            f'<joint name="j{i}" type="{kind}"><parent link="{parent}"/><child link="l{i}"/>'
            f'<origin xyz="{numbers[2]}" rpy="{numbers[3]}"/><axis xyz="{axis}"/><limit '
            f'lower="-2" upper="2" effort="50" velocity="3"/><dynamics {dynamics}/></joint>')


def robot(kinds, seed=0):
    rng = np.random.default_rng(seed)
    return BASE.format(''.join(joint(
        i, kind, ' '.join(map(str, rng.normal(size=3))), rng) for i, kind in enumerate(kinds)))


@pytest.mark.parametrize('kinds', [
    ['revolute'], ['prismatic', 'revolute'], ['revolute', 'prismatic', 'continuous'],
    pytest.param(['revolute'] * 7, marks=pytest.mark.slow)], ids=len)
def test_the_equations_are_those_of_the_chain(kinds, tmp_path):
    pinocchio = pytest.importorskip('pinocchio')
    text, n = robot(kinds), len(kinds)
    (tmp_path / 'robot.urdf').write_text(text)
    plant = write_plant(urdf_plant(tmp_path / 'robot.urdf'), tmp_path / 'plant.yaml')
    model = pinocchio.buildModelFromXML(text.replace('continuous', 'revolute'))
    data, rng = model.createData(), np.random.default_rng(1)
    creep = plant.parameters['creep']
    for _ in range(20):
        q, v, u = (rng.uniform(-size, size, n) for size in (2.0, 3.0, 20.0))
        expected = pinocchio.aba(model, data, q, v, u - 0.5 * v - 0.2 * np.tanh(v / creep))
        found = plant.rate_of_change(np.concatenate([q, v]), u)
        assert found[:n] == pytest.approx(v)
        assert np.abs(found[n:] - expected).max() < 1e-9 * np.abs(expected).max()


@pytest.mark.slow
def test_a_filter_on_a_chain_of_seven_joints_is_handed_out(tmp_path):
    pytest.importorskip('pinocchio')
    (tmp_path / 'robot.urdf').write_text(robot(['revolute'] * 7))
    path = tmp_path / 'plant.yaml'
    assert main([str(tmp_path / 'robot.urdf'), '--name', 'seven', '-o', str(path)]) == 0
    plant = load_plant(path)
    assert len(plant.unwritten) == 7
    found = design(plant, [('j3_encoder',)])[('j3_encoder',), 'j3_encoder']
    assert found.kind == 'extended' and len(found.model.definitions) > 400
    assert set(found.commands) == {f'j{i}_torque' for i in range(7)}


def test_what_is_beside_the_chain_is_held_and_put_together(tmp_path):
    pinocchio = pytest.importorskip('pinocchio')
    rng = np.random.default_rng(4)
    finger = joint(3, 'prismatic', '1 0 0', rng).replace('"l2"', '"l1"')
    text = BASE.format(joint(0, rng=rng) + joint(1, rng=rng) + finger)
    path = tmp_path / 'robot.urdf'
    path.write_text(text)
    plant = write_plant(urdf_plant(path, tip='l1'), tmp_path / 'plant.yaml')
    whole = pinocchio.buildModelFromXML(text)
    model = pinocchio.buildReducedModel(whole, [3], np.zeros(3))
    data, q, v = model.createData(), rng.normal(size=2), rng.normal(size=2)
    expected = pinocchio.aba(model, data, q, v, -0.5 * v - 0.2 * np.tanh(
        v / plant.parameters['creep']))
    assert plant.rate_of_change(np.concatenate([q, v]), np.zeros(2))[2:] == pytest.approx(
        expected, rel=1e-9)


def test_limits_friction_and_names_are_those_of_the_file(tmp_path):
    pytest.importorskip('pinocchio')
    text = robot(['revolute', 'revolute']).replace('j0', 'shoulder-pan').replace('j1', '2')
    (tmp_path / 'robot.urdf').write_text(text)
    plant = write_plant(urdf_plant(tmp_path / 'robot.urdf'), tmp_path / 'plant.yaml')
    assert plant.states == ('shoulder_pan', 'joint_2', 'shoulder_pan_speed', 'joint_2_speed')
    assert plant.parameters['shoulder_pan_viscous'] == 0.5
    assert plant.parameters['joint_2_coulomb'] == 0.2
    assert plant.ranges.tolist() == [[-2, 2], [-2, 2], [-3, 3], [-3, 3]]
    fits = read_yaml(tmp_path / 'plant.yaml')['parameters']['joint_2_coulomb']['fit']
    assert fits[0] <= 0.2 <= fits[1]


GOOD = robot(['revolute', 'revolute'])


@pytest.mark.parametrize(('text', 'arguments', 'said'), [
    ('<!DOCTYPE r [<!ENTITY a "b">]>' + GOOD, [], 'declares a document type or entities'),
    (GOOD.replace('<robot', '<robot xmlns:xacro="http://ros.org"'), [], 'expand it first: xacro'),
    (GOOD[:200], [], 'is not XML'),
    ('<model/>', [], 'holds <model>, not <robot>'),
    (GOOD.replace('type="revolute"', 'type="floating"'), [], "a joint of the type 'floating'"),
    (GOOD.replace('0.5" friction', 'much" friction'), [], "j0.dynamics.damping: 'much' is not a"),
    (GOOD.replace('damping="0.5"', 'damping="-1"'), [], 'j0.dynamics: is negative'),
    (GOOD, ['--tip', 'l9'], "--tip: 'l9' is not a link; known: base, l0, l1"),
    (GOOD, ['--base', 'l1', '--tip', 'l0'], "--base: 'l1' does not carry l0"),
    (GOOD.replace('<parent link="l0"/>', '<parent link="base"/>'), [], 'has 2 ends'),
    (GOOD.replace('<parent link="l0"/>', '<parent link="nowhere"/>'), [], "the link 'nowhere'"),
    (GOOD.replace('<child link="l1"/>', '<child link="l0"/>'), [], 'hangs on two joints'),
    (GOOD.replace('lower="-2"', 'lower="3"'), [], 'j0.limit: begins at 3, above its end 2'),
    (BASE.format(''), [], 'the chain has 0 joints that move'),
], ids=range(14))
def test_what_is_no_chain_is_one_line(text, arguments, said, tmp_path, capsys):
    (tmp_path / 'robot.urdf').write_text(text)
    path = tmp_path / 'plant.yaml'
    assert main([str(tmp_path / 'robot.urdf'), *arguments, '-o', str(path)]) == 2
    line = capsys.readouterr().err
    assert said in line and line.count('\n') == 1 and not path.exists()


def test_links_without_inertia_are_said(tmp_path, capsys):
    pytest.importorskip('pinocchio')
    (tmp_path / 'robot.urdf').write_text(re.sub('<inertial>.*?</inertial>', '', GOOD))
    assert main([str(tmp_path / 'robot.urdf'), '-o', str(tmp_path / 'plant.yaml')]) == 2
    assert 'have no inertia about' in capsys.readouterr().err


@pytest.mark.parametrize(('pattern', 'text', 'said'), [
    (r'<mass value="[^"]*"', '<mass value="0"', 'l0: has an inertia, but no mass'),
    (r'ixx="[^"]*"', 'ixx="-1"', 'l0: has the principal inertia -1')], ids=['mass', 'inertia'])
def test_bodies_that_cannot_be_are_said(pattern, text, said, tmp_path, capsys):
    pytest.importorskip('pinocchio')
    (tmp_path / 'robot.urdf').write_text(re.sub(pattern, text, GOOD))
    assert main([str(tmp_path / 'robot.urdf'), '-o', str(tmp_path / 'plant.yaml')]) == 2
    assert said in capsys.readouterr().err


def test_without_pinocchio_it_is_said_how_to_get_it(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'pinocchio', None)
    (tmp_path / 'robot.urdf').write_text(GOOD)
    assert main([str(tmp_path / 'robot.urdf'), '-o', str(tmp_path / 'plant.yaml')]) == 2
    assert 'pip install pin' in capsys.readouterr().err
