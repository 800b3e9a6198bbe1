"""What parabolas make of readings that are polynomials of time; the truth is in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest

from vsensor_ros.observers.kinds.nonlinear.motion import Motion

H = 0.1


def integrated(y, F, seconds=1.0, grid=H, lasts=0.0, at=0.0):
    """Return z' = F after so long from 0, and what it says it may be off; readings as lines."""
    entry = SimpleNamespace(
        z=('z',), F=(F,), out='z', validity=(), residuals=(), tracks=(), grade='exact', turn=0.0,
        noise_of={'y': 0.0}, lasts={'y': lasts}, driven=(), process_noise=np.zeros(1),
        sample_time=None)
    motion = Motion(entry, ('y',), (), grid)
    z, between = motion.state(np.zeros(1), np.zeros((1, 1)))[None], max(lasts, grid)

    def read(t):
        first = np.floor((t - at) / between + 1e-9) * between + at
        age = max(t - first, 0.0)
        return (np.array([y(first) + age / between * (y(first + between) - y(first))]),
                np.array([np.sqrt(age * (between - age))]))
    for k in range(round(seconds / grid)):
        (begin, before), (end, after) = read(k * grid), read((k + 1) * grid)
        z = motion.step(z, begin, end, np.array([before, after]))
    return float(z[0, 0]), motion.deviation(z, np.zeros(1), np.zeros(0))


def test_a_parabola_is_followed_exactly_but_for_the_first_step():
    found, off = integrated(lambda t: 3.0 * t * t, 'y')
    assert found - 1.0 == pytest.approx(3.0 * H**3 / 6.0, rel=1e-9)
    assert off == pytest.approx(0.0, abs=1e-12)


def test_of_a_cubic_it_says_by_how_much_it_is_off():
    found, off = integrated(lambda t: 4.0 * t**3, 'y', 3.0)
    two = 2.0 * 24.0 * H**4 / 24.0  # steps of which nothing is known before them
    assert off == pytest.approx(abs(found - 81.0), abs=1.5 * two)
    assert off == pytest.approx(24.0 * H**3 / 24.0 * 3.0, rel=0.1)


def test_the_square_of_what_turns_is_not_off_for_ever():
    """Straight lines lose (w h)^2 / 6 of the mean of sin^2."""
    w = 2.0
    found, _ = integrated(lambda t: np.sin(w * t), 'y**2', 20.0)
    truth = 10.0 - np.sin(2.0 * w * 20.0) / (4.0 * w)
    assert abs(found - truth) < 0.1 * (w * H)**2 / 6.0 * 10.0


@pytest.mark.parametrize('at', [0.0, -0.03])
def test_a_slow_sensor_is_put_right_by_how_its_slope_changed(at):
    found, off = integrated(lambda t: 3.0 * t * t, 'y', 3.0, 0.02, H, at)
    line = 6.0 * H * H / 12.0 * 3.0  # what straight lines are off
    assert abs(found - 27.0) < 0.3 * line
    assert 0.1 * line < off < 0.4 * line


def test_readings_between_grid_times_are_put_right():
    """As fast as the grid, but half a step apart from it."""
    found, _ = integrated(lambda t: 3.0 * t * t, 'y', 3.0, at=-H / 2.0)
    assert abs(found - 27.0) < 0.1 * (6.0 * H * H / 8.0 * 3.0)
