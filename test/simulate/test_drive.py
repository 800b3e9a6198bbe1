"""Plants as a scenario drives them: open loop as before, or closed by what the commands read."""

import numpy as np
import pytest
from scipy.linalg import expm

from vsensor_ros import Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.simulate.drive import read_drive
from vsensor_ros.simulate.section import Section

A, B = np.array([[0.0, 1.0], [9.0, 0.0]]), np.array([[0.0], [1.0]])    # it falls over
PENDULUM = Plant.from_matrices(A, B, np.eye(2), name='pendulum', inputs=['force'],
                               sensors=['y1', 'y2'], initial=[0.2, 0.0])


def drive(plant, content, rate=100.0, command_rate=20.0):
    return read_drive(Section('demo.yaml', 'simulation', content), plant, rate, command_rate)


def test_commands_that_read_the_states_hold_an_unstable_plant():
    t = np.arange(1001) / 100.0
    run = drive(PENDULUM, {'inputs': {'force': '-30*x1 - 8*x2 + sin(t)'}}).run(PENDULUM, t)
    # truth: each command is held for 0.05 s, during which the plant is linear
    step = expm(np.block([[A, B], [np.zeros((1, 3))]]) * 0.01)
    x, expected = np.array([0.2, 0.0]), []
    for k in range(len(t)):
        if k % 5 == 0:
            u = -30.0 * x[0] - 8.0 * x[1] + np.sin(k / 100.0)
        expected.append(x)
        x = (step @ [*x, u])[:2]
    np.testing.assert_allclose(np.transpose([run.readings['y1'], run.readings['y2']]), expected,
                               atol=1e-8)
    np.testing.assert_allclose(run.commands['force'].time, np.arange(201) / 20.0)
    at = np.array(expected)[::5]
    np.testing.assert_allclose(run.commands['force'].value,
                               -30.0 * at[:, 0] - 8.0 * at[:, 1] + np.sin(t[::5]), atol=1e-6)


def test_a_discrete_plant_in_a_closed_loop():
    plant = Plant.from_matrices([[2.0]], [[1.0]], [[1.0]], inputs=['u'], sensors=['y'],
                                initial=[1.0], sample_time=0.1)
    t = np.arange(31) * 0.1
    run = drive(plant, {'inputs': {'u': '-1.5*x1'}}, 10.0, 10.0).run(plant, t)
    np.testing.assert_allclose(run.readings['y'], 0.5 ** np.arange(31))


def test_a_time_is_the_time_even_if_a_state_has_its_name():
    plant = Plant.from_matrices([[-1.0]], [[1.0]], [[1.0]], states=['t'], inputs=['u'])
    run = drive(plant, {'inputs': {'u': 't'}}, 10.0, 10.0).run(plant, np.arange(11) / 10.0)
    np.testing.assert_allclose(run.commands['u'].value, np.arange(11) / 10.0)


@pytest.mark.parametrize('content, told', [
    ({'inputs': {'force': 'y1'}}, r'simulation\.inputs\.force'),    # what is read is not the truth
    ({'inputs': {'push': 't'}}, r'simulation\.inputs\.push'),
    ({'inputs': {'force': "__import__('os')"}}, r'simulation\.inputs\.force'),
    ({'noise': {'y1': 'loud'}}, r'simulation\.noise\.y1'),
    ({'inputs': 3}, r'simulation\.inputs')])
def test_what_is_outside_the_language_is_refused(content, told):
    with pytest.raises(BadInput, match=told):
        drive(PENDULUM, content)


def test_what_cannot_go_on_is_refused_in_one_line():
    wild = drive(PENDULUM, {'inputs': {'force': '1e300*x1'}})
    with pytest.raises(BadInput, match=r'demo\.yaml: simulation') as refusal:
        wild.run(PENDULUM, np.arange(2001) / 100.0)
    assert '\n' not in str(refusal.value)
