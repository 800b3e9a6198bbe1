"""The cart-pole: its plant file and its story, the machine in MuJoCo, the verdict, a short run."""

from dataclasses import replace
import json
from pathlib import Path
import shutil
import subprocess
import sys

import numpy as np
import pytest
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.demo import main
from vsensor_ros.designer import design
from vsensor_ros.lab import balance_picture, demo_runner
from vsensor_ros.lab.balance_controller import Law
from vsensor_ros.lab.balance_demo import judge_balance, told_of
from vsensor_ros.lab.balance_picture import draw_balance
from vsensor_ros.lab.balance_run import balance, Watched
from vsensor_ros.plant import load_plant
from vsensor_ros.simulate.balance import load_balance
from vsensor_ros.simulate.mujoco_machine import MujocoMachine

FOLDER = Path(__file__).parents[2] / 'config' / 'cart_pole'


@pytest.fixture(scope='module')
def plant():
    return load_plant(FOLDER / 'plant.yaml')


@pytest.fixture(scope='module')
def story(plant):
    return load_balance(FOLDER / 'demo.yaml', plant)


def machine_of(story, plant, seed=5):
    pytest.importorskip('mujoco', reason='mujoco is not installed')
    return MujocoMachine(story.model, plant.sensors, plant.inputs, story.initial, story.gusts,
                         seed)


def test_the_plant_file_is_the_model_of_mujoco_near_upright(story, plant):
    mujoco = pytest.importorskip('mujoco', reason='mujoco is not installed')
    machine = machine_of(story, plant)
    model, data = machine.model, mujoco.MjData(machine.model)
    model.opt.timestep = h = 1e-5
    A, B = np.zeros((4, 4)), np.zeros((4, 1))
    mujoco.mjd_transitionFD(model, data, 1e-6, True, A, B, None, None)
    order = [0, 2, 1, 3]    # MuJoCo has positions before speeds
    np.testing.assert_allclose((A[np.ix_(order, order)] - np.eye(4)) / h, plant.A, atol=0.01)
    np.testing.assert_allclose(B[order] / h, plant.B, atol=0.001)
    np.testing.assert_array_equal(plant.C, np.eye(4))
    # what the noise and the steps of the sensors come to
    steps = model.sensor_user[:, 0]
    np.testing.assert_allclose(plant.noise, np.hypot(model.sensor_noise, steps / 12 ** 0.5),
                               rtol=0.1)
    # what gusts, held for a period, come to
    inverse = np.zeros((2, 2))
    mujoco.mj_forward(model, data)
    mujoco.mj_solveM(model, data, inverse, np.eye(2))
    driven = inverse @ np.diag([story.gusts['slider'], story.gusts['hinge']])
    np.testing.assert_allclose(plant.process_noise[[1, 3]],
                               np.linalg.norm(driven, axis=1) * story.period ** 0.5, rtol=0.1)


def test_the_controller_balances_it_and_falls_with_a_frozen_angle(story, plant):
    law = Law.of(plant, story)
    column = plant.sensors.index('angle')
    lean = {}
    for frozen in (False, True):
        machine, command, told = machine_of(story, plant), [0.0], np.zeros(4)
        for row in range(story.step(4.0)):
            heard, told = told, machine.readings()
            if frozen and row > 200:
                told[column] = heard[column]
            following = law.command(row * story.period, told, command)
            machine.move(command, story.period)
            command = following
        lean[frozen] = abs(machine.truth()[column])
    assert lean[False] < 0.2 < story.fallen['angle'] < lean[True]


def test_readings_are_in_steps_and_noisy_but_the_truth_is_not(story, plant):
    machine = machine_of(story, plant)
    readings = np.array([machine.readings() for _ in range(2000)])
    np.testing.assert_array_equal(machine.truth(), [0.0, 0.0, story.initial['hinge'], 0.0])
    turns = readings[:, 2] / 0.0015339808
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert readings[:, 1].std() == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize('change, told', [
    ({'rate': 0.0}, 'rate: is not positive; write a number above 0'),
    ({'rates': 100.0}, 'rates: is not known here'),
    ({'travel': {'period': 1.0}}, 'travel: does not name one state'),
    ({'even': {'angle': 1.0}}, 'even.force: is missing'),
    ({'fallen': {'position': 1.0}}, 'fallen: names nothing but position'),
    ({'bar': {}}, 'bar: is empty'),
    ({'bar': {'tilt': 1.0}}, 'bar.tilt: is not known here'),
    ({'gusts': {'slider': 'strong'}}, 'gusts.slider: is not a finite number'),
])
def test_a_bad_story_is_refused_in_one_line(tmp_path, plant, change, told):
    content = yaml.safe_load((FOLDER / 'demo.yaml').read_text()) | change
    path = tmp_path / 'demo.yaml'
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(BadInput) as refused:
        load_balance(path, plant)
    assert str(refused.value).startswith(f'{path}: {told}')


@pytest.mark.parametrize('model, told', [
    ('<mujoco', 'is no model: '),
    ('<mujoco><worldbody/></mujoco>', 'position: is no sensor of the model; add it'),
])
def test_a_bad_model_is_refused_in_one_line(tmp_path, plant, story, model, told):
    path = tmp_path / 'model.xml'
    path.write_text(model)
    with pytest.raises(BadInput) as refused:
        machine_of(replace(story, model=path), plant)
    assert str(refused.value).startswith(f'{path}: {told}')


def watched(story, plant, replaced, fell_at=None, error=0.0):
    """Return a run of a lean of 0.1 sin(t), told with an error, that may end with a fall."""
    time = story.period * np.arange(story.step(fell_at + 1.0 if fell_at else story.end) + 1)
    truth = np.outer(0.1 * np.sin(time), np.arange(4) == plant.sensors.index('angle'))
    said = truth.copy()
    said[story.step(story.failed_at):] = said[story.step(story.failed_at)]
    told = truth[:, 2] + error
    return Watched('angle', replaced, time, truth, said, told, np.full(len(time), 0.004), fell_at,
                   3.0 if replaced else None)


def test_the_verdict(story, plant):
    fell, stood = watched(story, plant, False, 6.0), watched(story, plant, True, error=0.006)
    good = judge_balance(story, plant, fell, stood, 'pole', 1)
    row = good.row
    assert good.passed and row.rmse == pytest.approx(0.006) and row.latency_ms == 3.0
    assert (row.fell_after, row.stood) == (1.0, 30.0)
    late = np.arange(story.isolated_at, story.end, story.period)
    held = np.sqrt(np.mean((0.1 * np.sin(story.failed_at) - 0.1 * np.sin(late)) ** 2))
    assert row.rmse_hold == pytest.approx(held, rel=0.01)
    assert told_of(story, plant, stood).endswith('100 % of the estimates are within two of it')
    assert '0 % of the' in told_of(story, plant, watched(story, plant, True, error=0.009))
    for alone, other in [
            (watched(story, plant, False), stood),                          # did not fall alone
            (fell, watched(story, plant, True, 20.0, error=0.006)),         # fell though replaced
            (fell, watched(story, plant, True, error=0.011)),               # told too badly
            (fell, replace(stood, told=np.full(len(stood.told), np.nan)))]:  # not replaced
        assert not judge_balance(story, plant, alone, other, 'pole', 1).passed


def test_where_nothing_renders_the_pole_is_drawn(story, plant, tmp_path, monkeypatch):
    monkeypatch.setattr(balance_picture, 'render', lambda *_: None)
    drawn = []
    monkeypatch.setattr(balance_picture, 'draw_pose', lambda axes, *pose: drawn.append(pose))
    draw_balance(story, plant, [(watched(story, plant, False, 6.0), watched(story, plant, True),
                                 'replaced')], tmp_path / 'pole.png')
    assert (tmp_path / 'pole.png').read_bytes().startswith(b'\x89PNG')
    leans = [lean for _, lean, *_ in drawn]
    assert len(leans) == 16 and leans[0] == pytest.approx(0.1 * np.sin(story.failed_at - 0.5))


def test_without_mujoco_the_demo_says_so_and_goes_on(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'mujoco', None)
    assert main(['cart_pole', '--output', str(tmp_path)]) == 1      # nothing at all was shown
    said = capsys.readouterr().out
    assert 'cart_pole is not shown: mujoco: cannot be loaded' in said
    assert 'pip install mujoco' in said
    assert json.loads((tmp_path / 'summary.json').read_text()) == []


@pytest.fixture
def short(tmp_path, monkeypatch):
    """Let the angle fail once its virtual sensor has converged, in a folder of its own."""
    pytest.importorskip('mujoco', reason='mujoco is not installed')
    folder = tmp_path / 'config' / 'cart_pole'
    shutil.copytree(FOLDER, folder)
    content = yaml.safe_load((folder / 'demo.yaml').read_text())
    content |= {'fault': {'start': 3.0, 'isolated_after': 0.05, 'stands': 2.5},
                'bar': {'angle': 0.01}}
    (folder / 'demo.yaml').write_text(yaml.safe_dump(content))
    monkeypatch.setattr(demo_runner, 'config_folder', lambda: tmp_path / 'config')
    return folder


@pytest.mark.slow
def test_a_pole_in_real_processes(short, tmp_path, capsys):
    output = tmp_path / 'build'
    code = main(['--output', str(output)])
    said = capsys.readouterr().out
    assert code == 0, said
    assert 'nobody replaces it: it falls' in said and 'it stands the 2.5 s to the end' in said
    [record] = json.loads((output / 'summary.json').read_text())
    assert record['rmse'] < 0.2 * record['rmse_hold'] and record['stood'] == 2.5
    assert record['fell_after'] < 2.5 and record['latency_ms'] > 0.0
    assert (output / 'cart_pole.png').read_bytes().startswith(b'\x89PNG')


@pytest.mark.slow
def test_load_changes_nothing_but_how_long_it_takes(short, tmp_path, plant):
    story = load_balance(short / 'demo.yaml', plant)
    design(plant).save(tmp_path / 'design.json')

    def play():
        return balance(story, plant, 'angle', True, short, tmp_path / 'design.json', tmp_path,
                       lambda moment: None)
    idle = play()
    burners = [subprocess.Popen([sys.executable, '-c', 'while True: pass']) for _ in range(4)]
    try:
        busy = play()
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    assert idle.fell_at is None
    for name in ('truth', 'said', 'told'):
        np.testing.assert_array_equal(getattr(idle, name), getattr(busy, name))
