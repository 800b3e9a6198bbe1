"""Structures of friction in the place that a plant file names: the right one is taken."""

import numpy as np
from plants import AXIS, recorded, torques, written
import pytest

from vsensor_ros import load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.fit import main
from vsensor_ros.fitting.friction import variants

RUBBING = AXIS.replace('  drag: {value: 0.3, fit: [0.0, 3.0]}\n', '').replace(
    '  dry: {value: 0.1, fit: [0.0, 2.0]}\n', '').replace(
    'drag*speed - dry*sign(speed)', 'rub').replace('dynamics:\n', (
        'definitions:\n  rub: {value: 0.1*speed, friction: {speed: speed, most: 2, fastest: 3}}'
        '   # in the gear\ndynamics:\n'))
ASYMMETRIC = '0.6*speed - 0.25*abs(speed) + 0.4*sign(speed) + 0.1'


def test_a_plant_file_gets_each_structure(tmp_path):
    contents = variants(written(tmp_path, RUBBING))
    assert list(contents) == ['none', 'viscous', 'Coulomb', 'asymmetric', 'Stribeck']
    assert contents['Coulomb']['definitions']['rub']['value'] == \
        'rub_viscous*speed + rub_coulomb*sign(speed)'
    assert set(contents['Coulomb']['parameters']) == {'inertia', 'rub_viscous', 'rub_coulomb'}


def test_a_plant_file_without_a_place_is_one_line(tmp_path):
    with pytest.raises(BadInput, match='none says that it is friction; write friction: '):
        variants(written(tmp_path))


@pytest.mark.slow
def test_asymmetric_friction_is_found_and_written_back(tmp_path, capsys):
    pytest.importorskip('ruamel.yaml')
    truth = written(tmp_path, RUBBING.replace('0.1*speed', ASYMMETRIC), inertia=0.8)
    run = recorded(truth, torques(500, 0.02, np.random.default_rng(3)))
    table, out = tmp_path / 'run.csv', tmp_path / 'fitted.yaml'
    np.savetxt(table, np.column_stack([run.tracks['encoder'].times, *(
        run.tracks[name].values for name in ('encoder', 'torque'))]), delimiter=',', comments='',
        header='time,encoder,torque')
    assert main([str(written(tmp_path, RUBBING)), str(table), '--horizon', '1', '--tries', '1',
                 '--try', 'friction', '-o', str(out)]) == 0
    taken, = [line for line in capsys.readouterr().out.splitlines() if '<- taken' in line]
    assert taken.startswith('asymmetric')
    found = load_plant(out).parameters
    assert [found[name] for name in ('inertia', 'rub_viscous', 'rub_direction', 'rub_coulomb',
                                     'rub_bias')] == pytest.approx(
        [0.8, 0.6, 0.25, 0.4, 0.1], abs=0.03)
    assert '# in the gear' in out.read_text()
