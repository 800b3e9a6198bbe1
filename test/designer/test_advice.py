"""What an engineer would say of a plant and its design."""

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.designer.advice import advice

PENDULUM = """
name: pendulum
time: continuous
states:
  angle: {unit: rad, process_noise: 0.001}
  speed: {unit: rad/s, process_noise: 0.1}
inputs: {torque: {unit: N m}}
dynamics:
  angle: speed
  speed: -9.81*sin(angle) - 0.05*speed - 2*sign(speed) + 5*torque
sensors:
  encoder: {measures: angle, noise: 0.002}
  tacho: {measures: speed, noise: 0.01}
"""

ROBOT = """
name: robot
time: continuous
states: {px: {}, py: {}, heading: {unit: rad, range: [-3.2, 3.2]}}
inputs: {v: {operating: 1.0}, omega: {}}
dynamics: {px: v*cos(heading), py: v*sin(heading), heading: omega}
sensors:
  gps_x: {measures: px, noise: 0.5}
  gps_y: {measures: py, noise: 0.5}
  compass: {measures: heading, unit: rad, noise: 0.02}
"""


def minded(tmp_path, text):
    path = tmp_path / 'plant.yaml'
    path.write_text(text)
    plant = load_plant(path)
    return plant, advice(plant, design(plant), lambda other, lost: design(other, [lost]))


def test_an_estimate_that_is_worse_than_the_middle_of_the_range_is_said(tmp_path):
    plant, lines = minded(tmp_path, ROBOT)
    assert len(lines) == 1  # where the robot drives is no matter of equilibrium
    assert 'compass: noise error ' in lines[0]
    assert 'guessing the middle of its range, 1.85 rad' in lines[0]
    assert minded(tmp_path, ROBOT.replace('noise: 0.5', 'noise: 0.0005'))[1] == ()


def test_what_works_outside_its_range_is_said(tmp_path):
    text = PENDULUM.replace('rad, ', 'rad, range: [1, 2], ').replace(
        'N m', 'N m, range: [null, -1]')
    lines = [line for line in minded(tmp_path, text)[1] if 'outside its range' in line]
    assert lines[0].startswith('angle works at 0 rad, outside its range, 1 to 2: ')
    assert lines[1].startswith('torque works at 0 N m, outside its range, -inf to -1: ')
    inside = text.replace('[null, -1]', '[-1, 0]') + 'operating_point: {angle: 1}\n'
    assert not any('outside its range' in line for line in minded(tmp_path, inside)[1])


@pytest.mark.slow
def test_what_is_no_equilibrium_is_said_with_the_input_that_would_make_it_one(tmp_path):
    moved = PENDULUM + 'operating_point: {angle: 0.5}\n'
    plant, lines = minded(tmp_path, moved.replace('- 2*sign(speed)', ''))
    torque = 9.81 * np.sin(0.5) / 5
    assert f'no equilibrium: speed {-5 * torque:+.3g} rad/s^2; it would be one at torque = ' \
        f'{torque:.4g}' in lines[0]
    balanced = moved.replace('N m}', f'N m, operating: {torque}}}')
    assert not any('equilibrium' in line for line in minded(tmp_path, balanced)[1])
    sampled = moved.replace('continuous', '{sample_time: 0.1}').replace(
        'angle: speed', 'angle: angle + 0.1*speed').replace('speed: -9.81', 'speed: speed - 9.81')
    assert any('rad/s a step; it would be' in line for line in minded(tmp_path, sampled)[1])


def test_what_no_term_depends_on_may_drift(tmp_path):
    """A tyre that loses air slowly, beside an angle: no slope is taken of it."""
    tyre = PENDULUM.replace('inputs:', '  tyre: {initial: 2.4}\ninputs:').replace(
        '- 2*sign(speed)', '').replace('sensors:', '  tyre: -1e-6*tyre\nsensors:\n  tpms: tyre')
    assert not any('equilibrium' in line for line in minded(tmp_path, tyre)[1])
    felt = tyre.replace('5*torque', '5*torque - 0.1*sin(tyre)')
    assert any('tyre -2.4e-06 per s' in line for line in minded(tmp_path, felt)[1])


def test_no_input_may_make_it_one(tmp_path):
    text = PENDULUM.replace('angle: speed\n', 'angle: speed - sin(angle)\n')
    lines = minded(tmp_path, text + 'operating_point: {angle: 0.5}\n')[1]
    assert any('angle -0.479' in line and 'no input makes it one' in line for line in lines)


MOTOR = """
name: motor
time: continuous
states: {current: {process_noise: 5}, speed: {process_noise: 0.01}}
inputs: {voltage: {}}
dynamics: {current: voltage - current - speed, speed: 10*current - 2*sign(speed)}
sensors: {ammeter: {measures: current, noise: 0.01}, tacho: {measures: speed, noise: 0.001}}
"""


def test_friction_on_a_measured_speed_is_said_by_name_where_it_is_dear(tmp_path):
    plant, lines = minded(tmp_path, MOTOR)
    frictionless = minded(tmp_path, MOTOR.replace('- 2*sign(speed)', ''))
    found, bare = (design(p)['ammeter', 'ammeter'].noise.error for p in (plant, frictionless[0]))
    assert found > 5 * bare
    assert len(lines) == 1 and frictionless[1] == ()
    assert f'ammeter: sign(speed) costs most of its quality: noise error {found:.3g}, ' \
        f'without it {bare:.3g}' in lines[0]
    assert 'write tanh(speed/eps) for sign(speed)' in lines[0]


@pytest.mark.parametrize(('friction', 'said'), [
    ('tanh(speed/0.01)', True), ('tanh(speed/5)', False)])
def test_a_steep_tanh_at_the_operating_point_is_said(tmp_path, friction, said):
    lines = minded(tmp_path, PENDULUM.replace('2*sign(speed)', f'2*{friction}'))[1]
    assert any('where it is steep: its slope adds 200 1/s to speed' in line
               and 'operating_point in motion, such as speed: 0.03' in line
               for line in lines) == said
    moving = PENDULUM.replace('2*sign(speed)', f'2*{friction}') + 'operating_point: {speed: 1}\n'
    assert not any('steep' in line for line in minded(tmp_path, moving)[1])
