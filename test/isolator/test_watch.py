"""By how much motion widens thresholds: whose, and how far."""

import numpy as np
import pytest

from vsensor_ros.isolator.detector import ENOUGH
from vsensor_ros.isolator.motion import CONTRASTS
from vsensor_ros.isolator.watch import Watch

PERIOD = 0.1
LEVEL = slice(0, CONTRASTS.start)


def watch(own=(0, 1, 2, -1)):
    """Return one that has learnt of three channels: a check of each, and a dedicated filter."""
    found = Watch(PERIOD, np.array(own), np.array([[1, 1, 0], [0, 1, 1], [1, 0, 1], [1, 1, 0]],
                                                  bool), np.eye(4, 3),
                  np.full(4, 0.01), np.array([0, 1, 2]), 1e-7, 0.1)
    found.gains[3, :2] = found.gain[3] = 1.0
    found._single = None
    found.detector.learnt = np.full(4, round(ENOUGH / PERIOD))
    found.motion._used[:] = 1.0  # swings from -1 to 1
    return found


def shares(found):
    """Return by how much of its width the threshold of each check is widened."""
    widened = np.broadcast_to(found._widened(6), (6, 2, 2, 4))
    return (widened / found.detector.width(6))[0, 0, 0]


def test_motion_of_the_own_channel_widens_and_a_dedicated_filter_asks_for_all_that_it_reads():
    found = watch()
    found.motion.beyond[LEVEL, 0] = 1.0
    assert shares(found) == pytest.approx([1.0, 0.0, 0.0, 0.0])
    found.motion.beyond[LEVEL, 1] = 0.5
    assert shares(found) == pytest.approx([1.0, 0.5, 0.0, 0.5])


def test_motion_of_what_is_read_widens_by_contrasts_only():
    """A current that jumps, beside a speed that has not moved yet."""
    found = watch()
    found.motion.beyond[LEVEL, 1] = 1.0
    assert shares(found)[0] == 0.0
    found.motion.beyond[CONTRASTS, 1] = 1.0
    assert shares(found)[0] == pytest.approx(1.0)

