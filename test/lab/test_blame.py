"""Whom the own isolator must blame by the design, and the judge of whom it did; no ROS."""

from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import load_plant
from vsensor_ros.lab.injection.blame import expected, found_of, Injected, judge_blame
from vsensor_ros.lab.injection.truth import compute_truth
from vsensor_ros.lab.injection.verdict import Evidence, Out, Said, StatusHeard
from vsensor_ros.observers import Isolability, Residual

SERVO = Path(__file__).parents[2] / 'config' / 'servo'
SENSORS = ('a', 'b', 'c')


def of(*supports):
    """Return what is told by residuals with these supports, 'ab cd'."""
    return Isolability(tuple(Residual(
        s, (), s[0], tuple(s), (1.0,) * len(s), 1.0, 5.0) for s in supports))


@pytest.mark.parametrize('supports, faults, state, blamed', [
    (['b', 'c', 'bc'], {'b': 'bias'}, 'isolated', 'b'),
    (['ab', 'bc', 'ac'], {'b': 'drift'}, 'isolated', 'b'),
    (['bc'], {'b': 'bias'}, 'suspected', ''),
    (['b', 'c', 'bc'], {'a': 'bias'}, 'healthy', ''),       # nobody feels it
    (['b', 'c', 'bc'], {'a': 'freeze'}, 'isolated', 'a'),   # but its readings show that
    (['bc'], {'b': 'noise', 'c': 'drop_out'}, 'isolated', 'bc'),
    (['b', 'c', 'bc'], {'b': 'bias', 'c': 'bias'}, 'model', ''),
    (['a', 'b', 'c'], {'b': 'bias', 'c': 'bias'}, 'isolated', 'bc'),
    (['b', 'c', 'bc'], {'b': 'spikes'}, 'healthy', '')])
def test_what_must_be_said_follows_from_the_residuals(supports, faults, state, blamed):
    assert expected(of(*supports), SENSORS, faults) == (state, frozenset(blamed))


def test_of_two_that_no_residual_tells_alone_nothing_is_expected():
    assert expected(of('ab', 'bc', 'ac', 'c'), SENSORS, {'a': 'bias', 'b': 'bias'}) is None


def test_who_is_blamed_without_a_fault_or_called_wrong_is_told():
    fault = Injected('b', 'freeze', 'stuck', 10.0, 12.0, 13.0, True)
    right = [Said(9.0, 'healthy', {}), Said(10.1, 'isolated', {'b': 'stuck'}),
             Said(13.1, 'healthy', {})]
    assert judge_blame(right, [fault], 9.0) == []
    assert judge_blame([*right, Said(14.0, 'isolated', {'b': 'stuck'})], [fault], 9.0) == [
        'b was blamed (stuck), 5.00 s from the begin, and must not be']
    assert judge_blame([Said(10.1, 'isolated', {'b': 'stuck', 'c': 'bias'})], [fault], 9.0) == [
        'c was blamed (bias), 1.10 s from the begin, and must not be']
    assert judge_blame([Said(10.1, 'isolated', {'b': 'bias'})], [fault], 9.0) == [
        'b: freeze was called bias, not stuck']
    spikes = Injected('b', 'spikes', '', 10.0)
    assert len(judge_blame(right, [spikes], 9.0)) == 1


def test_times_and_errors_are_of_the_virtual_sensor_alone():
    truth = compute_truth(load_plant(SERVO / 'plant.yaml'), None, 4.0)
    heard = Evidence(0.0, said=[Said(1.1, 'isolated', {'y2': 'stuck'})],
                     told=[StatusHeard(1.2, {'y2': {'source': 'virtual'}})])
    off = 0.01 * truth.span['y2']
    for k, time in enumerate(truth.time):
        wrong = 0.0 if time < 1.0 else 50.0 if time < 1.195 else off if time <= 3.0 else 70.0
        heard.outs.append(Out('/out', time, time, round(time * 1e9), time,
                              {'y2': truth.value['y2'][k] + wrong}, '', ()))
    found = found_of(Injected('y2', 'freeze', 'stuck', 1.0, 3.0, 3.5, True), heard, truth)
    assert found.kind == 'stuck'
    assert (found.blamed_s, found.replaced_s) == pytest.approx((0.1, 0.2))
    assert (found.error, found.rms) == pytest.approx((0.01, 0.01))
    heard.blind['y2'] = [(1.5, 2.0)]    # a second fault
    heard.outs[160] = heard.outs[160]._replace(values={'y2': 1e3})
    assert found_of(Injected('y2', 'freeze', 'stuck', 1.0, 3.0), heard, truth).error == \
        pytest.approx(0.01)


def test_a_sensor_whose_noise_nothing_gives_has_some_if_asked_for():
    plant = load_plant(SERVO.parent / 'three_tank' / 'plant.yaml')
    for noisy in (False, True):
        truth = compute_truth(plant, None, 4.0, noisy)
        for name, value in truth.value.items():
            off = np.std(truth.said[name].value - value) / truth.span[name]
            assert off == pytest.approx(0.002 if noisy else 0.0, rel=0.2)
