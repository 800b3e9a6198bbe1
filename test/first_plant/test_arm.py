"""Planar arms: their equations beside MuJoCo, which makes them of masses and lengths too."""

from dataclasses import replace
import json

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.start import main
from vsensor_ros.designer.filter_trial import tried
from vsensor_ros.first_plant import Arm, arm_plant, write_plant

MASSES, LENGTHS = [1.2, 0.8, 0.5, 0.3, 0.2, 0.1], [0.3, 0.25, 0.2, 0.15, 0.1, 0.1]


def in_mujoco(arm):
    mujoco = pytest.importorskip('mujoco')
    text, end = '', ''
    centres = arm.centres or [length / 2 for length in arm.lengths]
    for i, (mass, centre) in enumerate(zip(arm.masses, centres)):
        at = arm.lengths[i - 1] if i else 0
        text += (f"<body pos='{at} 0 0'><joint type='hinge' axis='0 0 1'/><inertial "
                 f"pos='{centre} 0 0' mass='{mass}' diaginertia='{arm.inertias[i]} "
                 f"{arm.inertias[i]} {arm.inertias[i]}'/>")
        end += '</body>'
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><option gravity='{arm.gravity} 0 0'/><worldbody>{text}{end}</worldbody>"
        '</mujoco>')
    data = mujoco.MjData(model)

    def accelerations(q, v, torque):
        data.qpos[:], data.qvel[:], data.qfrc_applied[:] = q, v, torque
        mujoco.mj_forward(model, data)
        return data.qacc.copy()
    return accelerations


@pytest.mark.parametrize('n', [1, 2, 3, 6])
def test_the_equations_are_those_of_the_arm(n, tmp_path):
    rng = np.random.default_rng(n)
    arm = Arm(MASSES[:n], LENGTHS[:n], rng.uniform(0.02, 0.1, n).round(4).tolist(),
              rng.uniform(0.001, 0.01, n).round(5).tolist(), 9.0)
    plant, truth = write_plant(arm_plant(arm), tmp_path / 'arm.yaml'), in_mujoco(arm)
    p = plant.parameters
    for _ in range(20):
        q, v, u = (rng.uniform(-size, size, n) for size in (3.0, 5.0, 3.0))
        friction = [p[f'viscous{i + 1}'] * v[i] + p[f'coulomb{i + 1}'] * np.tanh(
            v[i] / p['creep']) for i in range(n)]
        expected = truth(q, v, u - friction)
        found = plant.rate_of_change(np.concatenate([q, v]), u)
        assert found[:n] == pytest.approx(v)
        assert np.abs(found[n:] - expected).max() < 1e-9 * np.abs(expected).max()
    assert bool(plant.unwritten) == (n > 2)  # of more joints they are kept as definitions


def test_a_filter_follows_an_arm_whose_equations_are_kept_as_definitions(tmp_path):
    path, file = tmp_path / 'arm.yaml', tmp_path / 'arm.design.json'
    assert main(['arm', '--masses', '1.2,0.8,0.5', '--lengths', '0.3,0.25,0.2', '--name', 'bench',
                 '-o', str(path)]) == 0
    plant = load_plant(path)
    made = design(plant, [('encoder2',)])
    made.save(file)
    entry = Design.load(file)[('encoder2',), 'encoder2']
    assert entry.kind == 'extended' and entry.model.definitions
    assert entry.model.same(made[('encoder2',), 'encoder2'].model)
    assert set(entry.commands) == set(plant.inputs)
    everywhere = np.tile([-np.inf, np.inf], (len(plant.states), 1))
    found = tried(replace(plant, ranges=everywhere), entry, runs=20)
    assert found.served > 0.9 and found.rmse < 0.05 and found.within > 0.6, found


def test_what_a_design_file_says_of_definitions_is_checked(tmp_path):
    plant = write_plant(arm_plant(Arm(MASSES[:3], LENGTHS[:3])), tmp_path / 'arm.yaml')
    file = tmp_path / 'arm.design.json'
    design(plant, [('encoder2',)]).save(file)
    whole = file.read_text()
    for change, said in ((lambda d: d[0].update(text='sin(d3)'), 'unknown name'),
                         (lambda d: d[0].update(name='angle1'), 'stands for something else'),
                         (lambda d: d[0].update(text='__import__("os")'), 'not in the language'),
                         (lambda d: d[0].pop('text'), 'text')):
        content = json.loads(whole)
        [entry] = content['entries']
        change(entry['definitions'])
        file.write_text(json.dumps(content))
        with pytest.raises(BadInput, match=said):
            Design.load(file)


@pytest.mark.parametrize(('arguments', 'said'), [
    ([], '--masses: are 0; give 1 to 9'),
    (['--masses', '1,2', '--lengths', '1'], '--lengths: are 1, masses 2'),
    (['--masses', '1,0', '--lengths', '1,1'], '--masses: 0 is not positive'),
    (['--masses', '1', '--lengths', '1', '--gravity', '-9.81'], '--gravity: -9.81 is negative'),
    (['--masses', '1', '--lengths', '1', '--set', 'mass1=2'], '--set: does not go with arm'),
])
def test_what_is_no_arm_is_one_line(arguments, said, tmp_path, capsys):
    path = tmp_path / 'arm.yaml'
    assert main(['arm', *arguments, '-o', str(path)]) == 2 and not path.exists()
    line = capsys.readouterr().err
    assert said in line and line.count('\n') == 1


def test_a_plant_with_definitions_is_another_when_these_change(tmp_path):
    one = write_plant(arm_plant(Arm(MASSES[:3], LENGTHS[:3])), tmp_path / 'arm.yaml')
    assert replace(one, definitions=(*one.definitions[:-1], ('last', '1'))).hash() != one.hash()


def test_a_gravity_that_is_no_number_is_said(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(['arm', '--masses', '1', '--lengths', '1', '--gravity', 'nan', '-o',
              str(tmp_path / 'arm.yaml')])
    assert "--gravity: 'nan' is not numbers" in capsys.readouterr().err
