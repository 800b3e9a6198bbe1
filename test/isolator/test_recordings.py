"""Recordings of real machines: nothing is alarmed that is none, and what fails is found."""

from copy import deepcopy
from functools import cache
import os
from pathlib import Path

import numpy as np
import pytest

from benchmark.isolator_recordings import biases, Board, falsely_stuck, frozen, logs

DATA = Path(os.environ.get('VSENSOR_DATA') or 'nowhere')
pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason='VSENSOR_DATA names no folder')
LABELS = ('drive', 'board', *(f'arm {i}' for i in range(5)))


@cache
def recorded():
    return {log.label: log for log in logs(DATA)}


@pytest.mark.parametrize('label', LABELS)
def test_no_channel_is_taken_for_stuck_idle_and_quantised_ones_neither(label):
    log = recorded()[label]
    stuck = falsely_stuck(log)
    assert len(stuck) >= 3
    assert not stuck.any(), np.array(log.names)[stuck]


@pytest.mark.parametrize('label', ['drive', 'arm 0', 'arm 3'])
def test_noisy_channels_that_freeze_are_found_within_a_fifth_of_a_second(label):
    log = recorded()[label]
    found = np.mean(frozen(log, 10, 0.4) <= 0.2, axis=0)
    noisy = [not name.startswith('pos') for name in log.names]  # encoders repeat where they rest
    assert (found[noisy] == 1.0).all(), dict(zip(log.names, found))
    assert np.mean(found) > 0.8


@pytest.mark.slow
def test_the_half_of_the_temperature_board_that_was_not_learnt():
    board = Board(DATA)
    board.go_on(range(board.half))
    assert set(board.states) == {'healthy'}
    healthy = deepcopy(board)
    healthy.go_on(range(board.half, len(board.values)))
    assert set(healthy.states) == {'healthy'}
    delays, blamed = biases(board, 50)
    assert np.mean(np.isfinite(delays)) >= 0.94
    assert blamed == 0  # either may be it
    assert np.median(delays) <= 5.0
