"""A refusal says why no nonlinear function of the states helps either."""

import pytest

from vsensor_ros import design, load_plant

MOTOR = """
name: motor
time: continuous
states: {i: {range: [-5, 5], initial: 0.5}, w: {range: [-100, 100], initial: 20}}
inputs: {U: {range: [0, 50]}}
disturbances: {flux: {range: [0.05, 0.75]}}
dynamics: {i: (-i - flux*w + U)/0.05, w: (flux*i - 0.02*w)/0.01}
sensors: {ammeter: {measures: i, noise: 0.01}, tacho: {measures: w, noise: 0.1}}
"""


@pytest.fixture(scope='module')
def refused(tmp_path_factory):
    path = tmp_path_factory.mktemp('motor') / 'plant.yaml'
    path.write_text(MOTOR, encoding='utf-8')
    return design(load_plant(path))


def test_two_values_for_the_same_readings_are_said(refused):
    reason = refused['tacho', 'tacho'].reason
    assert 'flux_in_w acts on it' in reason and 'narrow a range' in reason


def test_a_growing_error_is_said_with_its_function(refused):
    reason = refused['ammeter', 'ammeter'].reason
    assert 'w**2 + 5*i**2' in reason and 'may grow' in reason
