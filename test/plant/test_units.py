"""Units of plant files, checked with pint."""

import numpy as np
import pytest

from vsensor_ros.plant import load_plant, units

pytest.importorskip('pint', reason='units are checked where pint is installed')

CART = """
name: cart
time: continuous
parameters: {mass: {value: 2, unit: kg}, drag: {value: 0.5, unit: 1/s}, plain: 3}
states: {pos: {unit: m}, vel: {unit: m/s}, temp: {unit: degC}}
inputs: {force: {unit: N}}
dynamics:
  pos: vel
  vel: force/mass - drag*vel + plain*sin(pos/plain) - 9.81
  temp: 0.1*(20 - temp)
sensors:
  encoder: {measures: pos, unit: mm, noise: 1}
  thermo: {measures: temp, unit: degF}
  ticks: {measures: 4096*pos, unit: counts}
"""


def loaded(tmp_path, old='', new=''):
    assert old in CART
    path = tmp_path / 'plant.yaml'
    path.write_text(CART.replace(old, new, 1))
    return load_plant(path)


def test_a_sensor_in_another_unit_of_the_same_dimension_is_converted_and_said(tmp_path):
    plant = loaded(tmp_path)
    assert np.allclose(plant.C, [[1000, 0, 0], [0, 0, 1.8], [4096, 0, 0]])
    assert plant.curves['thermo'].shown(1.8 * 25.0) == pytest.approx(77.0)
    assert list(plant.curves) == ['thermo'] and plant.noise[0] == 1
    assert plant.remarks == (
        'sensors.encoder: is in mm, and pos in m: it is taken to show 1000*pos',
        'sensors.thermo: is in degF, and temp in degC: it is taken to show 1.8*temp + 32')


@pytest.mark.parametrize(('old', 'new', 'needle'), [
    ('pos: vel', 'pos: force', 'dynamics.pos: force is in N, but pos in m, which changes in m/s'),
    ('- drag*vel', '- vel', 'dynamics.vel: vel is in m/s, but vel in m/s, which changes in m/s^2'),
    ('- drag*vel', '- drag*(vel + pos)', 'dynamics.vel: pos is in m, vel in m/s: they cannot be'),
    ('sin(pos/plain)', 'sin(pos)', 'dynamics.vel: sin of pos, which is in m'),
    ('unit: mm', 'unit: V', 'sensors.encoder: pos is in m, which cannot be shown in V'),
    ('unit: m/s}', 'unit: km/s}', 'dynamics.pos: vel is in km/s, 1000 times m/s'),
])
def test_what_does_not_go_together_is_one_line(tmp_path, old, new, needle):
    said = [line for line in loaded(tmp_path, old, new).remarks if needle in line]
    assert len(said) == 1, loaded(tmp_path, old, new).remarks


def test_hours_in_a_model_that_runs_in_seconds_are_one_line(tmp_path):
    def with_hours(text):
        return [line for line in loaded(tmp_path, 'time: continuous', text).remarks
                if 'time_unit' in line]

    (line,) = [line for line in loaded(tmp_path, 'unit: m/s}', 'unit: m/h}').remarks
               if 'time_unit' in line]
    assert line == 'vel in m/h, the rate of pos: but the equations run in seconds; if their ' \
        'rates are per h, write time_unit: h'
    assert with_hours('time: continuous') == with_hours('time: continuous\ntime_unit: s') == []


def test_definitions_have_the_units_of_what_they_are(tmp_path):
    text = 'definitions: {push: force/mass, slip: {value: 3*vel, unit: V}}\ndynamics:'
    plant = loaded(tmp_path, 'dynamics:', text)
    assert not any('dynamics' in line for line in plant.remarks)
    path = tmp_path / 'plant.yaml'
    path.write_text(CART.replace('dynamics:', text).replace('pos: vel', 'pos: push + slip'))
    assert [line for line in load_plant(path).remarks if 'dynamics.pos' in line] == [
        'dynamics.pos: push is in N/kg, but pos in m, which changes in m/s',
        'dynamics.pos: slip is in V, but pos in m, which changes in m/s']


def test_without_pint_that_is_said_once(tmp_path, monkeypatch):
    monkeypatch.setattr('vsensor_ros.plant.entries.registry', lambda: None)
    assert loaded(tmp_path).remarks == (units.NOT_INSTALLED,)
    assert loaded(tmp_path).C[0].tolist() == [1, 0, 0]  # as it is written


@pytest.mark.parametrize('text', [
    'counts', 'ticks', '9**9**9', 'm^99', '0.1 m', "__import__('os')", '(((', 'm' * 100, '/', ''])
def test_what_is_no_unit_is_left_alone(text):
    assert units.unit_of(text) is None
