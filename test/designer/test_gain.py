"""Peak gains over frequency, against closed forms."""

import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.designer.gain import peak

ONE, NONE = np.ones((1, 1)), np.zeros((1, 1))


@pytest.mark.parametrize('damping', [0.5, 1e-2, 1e-5])
def test_a_resonance(damping):
    N, B, C = np.array([[0, 1], [-1, -2 * damping]]), np.array([[0], [1.0]]), np.array([[1.0, 0]])
    gain, at = peak(N, B, C, NONE, None)
    assert gain == pytest.approx(1 / (2 * damping * np.sqrt(1 - damping**2)), rel=3e-6)
    assert at == pytest.approx(np.sqrt(1 - 2 * damping**2), rel=1e-3)


def test_a_resonance_between_stiff_modes_in_any_units():
    N = np.zeros((4, 4))
    N[0, 0], N[3, 3], N[1:3, 1:3] = -1e6, -1e-3, [[0, 1], [-1, -2e-4]]
    B, C = np.array([[1e6], [0], [1], [0]]), np.array([[1e-6, 1, 0, 1]])
    units = np.array([1e-6, 1e3, 1, 1e9])
    gain, _ = peak(N * units[:, None] / units, B * units[:, None], C / units, NONE, None)
    assert gain == pytest.approx(5000, rel=3e-6)


def test_a_delay_and_a_high_pass():
    gain, _ = peak(NONE, ONE, ONE, NONE, 0.1)
    assert gain == pytest.approx(1.0, rel=3e-6)
    gain, at = peak(-ONE, ONE, -ONE, ONE, None)
    assert gain == pytest.approx(1.0, rel=3e-6) and at > 10


def test_two_inputs_give_the_largest_singular_value():
    gain, _ = peak(-np.eye(2), np.diag([3.0, 4.0]), np.ones((1, 2)), NONE.repeat(2, 1), None)
    assert gain == pytest.approx(5.0, rel=3e-6)


@pytest.mark.parametrize('c', [-1.3, -1.0, -0.9999, -0.999, -0.99, -0.9])
def test_a_peak_beside_the_fastest_frequency(c):
    """The square of |1 + a / z + b / z^2| is a parabola in cos(omega h), highest at c."""
    b = -0.24
    a = -4 * b * c / (1 + b)
    gain, _ = peak(np.eye(2, k=-1), np.eye(2, 1), np.array([[a, b]]), ONE, 0.1)
    c = max(c, -1.0)
    exact = np.sqrt((1 - b) ** 2 + a**2 + 2 * a * (1 + b) * c + 4 * b * c**2)
    assert exact * (1 - 1e-12) <= gain <= exact * (1 + 2e-6)


@pytest.mark.parametrize('sample_time', [None, 0.1])
def test_many_states(sample_time):
    """Of side by side systems of one state the gains add up, and are highest when constant."""
    rng = np.random.default_rng(0)
    poles, T = -rng.uniform(1.0, 9.0, 70), np.linalg.qr(rng.normal(size=(70, 70)))[0]
    still = 0.0 if sample_time is None else 1.0
    N = T @ np.diag(poles if sample_time is None else 1.0 + sample_time * poles) @ T.T
    gain, _ = peak(N, T @ np.ones((70, 1)), np.ones((1, 70)) @ T.T, NONE, sample_time)
    exact = np.sum(1.0 / (still - np.linalg.eigvalsh(N)))
    assert gain == pytest.approx(exact, rel=3e-6)


@pytest.mark.parametrize('sample_time', [None, 0.1])
def test_the_noise_gain_that_is_stated_is_exceeded_at_no_frequency(sample_time):
    rng = np.random.default_rng(4)
    A = rng.normal(size=(5, 5))
    A = A - 5 * np.eye(5) if sample_time is None else A / 4
    plant = Plant.from_matrices(A, None, rng.normal(size=(3, 5)), sample_time=sample_time)
    for entry in design(plant).virtual_sensors:
        s = (1j * np.geomspace(1e-3, 1e5, 20000) if sample_time is None
             else np.exp(1j * np.linspace(0, np.pi, 20000)))
        gains = np.linalg.norm(
            entry.Cv @ np.linalg.solve(s[:, None, None] * np.eye(entry.order) - entry.N,
                                       entry.J.astype(complex)) + entry.Q, 2, axis=(1, 2))
        assert entry.order and gains.max() <= entry.noise_gain <= gains.max() * (1 + 1e-5)
