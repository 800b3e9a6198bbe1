"""Steps and ramps are told apart, with onset and size."""

import numpy as np
import pytest

from vsensor_ros.isolator.shape import BIAS, DRIFT, shape_of


def residual(since, rate=0.0, jump=0.0, seed=0):
    residual = np.random.default_rng(seed).normal(0.0, 0.01, 3000)
    residual[-since:] += jump + rate * np.arange(1, since + 1)
    return residual


@pytest.mark.parametrize('jump', [0.05, -0.2])
@pytest.mark.parametrize('since', [20, 500])
def test_a_jump_is_a_bias(jump, since):
    shape = shape_of(residual(since, jump=jump))
    assert shape.kind == BIAS and abs(shape.samples - since) <= 2
    assert shape.size == pytest.approx(jump, abs=0.01)


@pytest.mark.parametrize('rate', [0.001, -0.0005])
def test_a_ramp_is_a_drift(rate):
    shape = shape_of(residual(600, rate=rate))
    assert shape.kind == DRIFT and shape.samples == pytest.approx(600, abs=20)
    assert shape.size == pytest.approx(600 * rate, rel=0.03)


def test_too_few_samples_have_no_shape():
    with pytest.raises(ValueError, match='no shape'):
        shape_of(np.zeros(2))
