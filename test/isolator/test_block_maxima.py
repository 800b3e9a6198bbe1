"""The record of extremes, and its tails against closed forms."""

import numpy as np
import pytest
from scipy.stats import norm

from vsensor_ros.isolator.block_maxima import BlockMaxima, FEWEST, ROOM, tail, thresholds


def record(maxima):
    store = BlockMaxima(1, 1)
    for value in maxima:
        store.add(slice(1), np.array([[value]]), np.array([True]))
    return store


def test_the_tail_is_what_is_above_the_upper_quartile():
    maxima = np.full((ROOM, 1), -np.inf)
    maxima[:40, 0] = np.random.default_rng(0).permutation(40.0 + np.arange(40))
    start, excess, share = tail(maxima, np.array([40]))
    assert (start[0], share[0]) == (69.0, 0.25)  # the largest that is not among the upper ten
    assert excess[0] == pytest.approx(np.mean(np.arange(70, 80) - 69.0))


@pytest.mark.parametrize('wanted', [1e3, 1e6])
def test_gaussian_noise_passes_its_threshold_about_as_seldom_as_wanted(wanted):
    block = 128
    random = np.random.default_rng(1)
    found = []
    for _ in range(60):
        store = record(random.standard_normal((120, block)).max(axis=1))
        found.append(thresholds(store.maxima[:, 0], store.count[0], np.array([wanted]))[0])
    exact = norm.isf(1.0 / (wanted * block))
    # on the safe side, as the error of a tail of 30 blocks asks for, but not by far
    assert exact < np.mean(found) < 1.15 * exact
    assert np.quantile(found, 0.1) > 0.9 * exact


@pytest.mark.parametrize('blocks', [FEWEST, 28, 60])
def test_a_short_record_is_passed_as_seldom_as_wanted_on_average(blocks):
    wanted, n = 1e3, 20_000
    maxima = np.full((ROOM, n), -np.inf)
    maxima[:blocks] = np.sqrt(np.random.default_rng(6).exponential(size=(blocks, n)))
    level = thresholds(maxima, np.full(n, blocks), np.array([wanted]))**2
    assert np.exp(-level).mean() == pytest.approx(1.0 / wanted, rel=0.25)


def test_too_few_blocks_give_no_threshold():
    store = record(np.ones(FEWEST - 1))
    assert np.isinf(thresholds(store.maxima[:, 0], store.count[0], np.array([100.0]))[0])


def test_a_full_store_merges_neighbours_and_forgets_no_extreme():
    values = np.random.default_rng(2).standard_normal(10 * ROOM)
    store = record(values)
    kept = store.maxima[:store.count[0, 0], 0, 0]
    merged = int(store.merged[0, 0])
    assert merged > 1 and len(kept) < ROOM
    blocks = values[:len(kept) * merged].reshape(-1, merged).max(axis=1)
    assert kept == pytest.approx(blocks)


def test_cells_go_at_their_own_pace():
    store = BlockMaxima(1, 2)
    for _ in range(ROOM + 3):
        store.add(slice(1), np.array([[1.0, 2.0]]), np.array([True, False]))
    assert store.count[0].tolist()[1] == 0 and store.merged[0].tolist() == [2, 1]
    assert store.usual(0)[1] == -np.inf
