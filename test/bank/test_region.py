"""Whether a virtual sensor runs where it is proved to converge."""

import numpy as np
import pytest

from vsensor_ros.bank import Bank
from vsensor_ros.observers import Certificate, Limit

KEY = ('y1',), 'y1'
MS = 1_000_000


def run(bench, region, y2, u):
    v = bench.virtual_sensor(
        [[-1.0]], [[1.0]], P=[[-0.1]], Gz=[[[1.0]]], Gy=[[[0.0]]], texts=['u * sin(w1)'],
        inputs=('u',), certificate=Certificate('region', 0.5, 1.0, np.eye(1), region, None, ''))
    bank = Bank(bench.design(v, inputs=('u',)), 100)
    for now in range(0, 3000, 10):
        bank.take('y2', now * MS, y2)
        bank.take('u', now * MS, u)
        bank.advance(now * MS)
    return bank.outside_region(*KEY)


@pytest.mark.parametrize(('y2', 'u', 'outside'), [
    (0.5, 0.5, False), (9.5, 0.5, True), (0.5, 9.5, True), (9.5, 9.5, True)])
def test_arguments_and_commands_both_count(bench, y2, u, outside):
    region = (Limit(0, 0, -1.0, 1.0), Limit(None, 0, -1.0, 1.0))
    assert run(bench, region, y2, u) is outside


def test_commands_alone_count(bench):
    region = (Limit(None, 0, -1.0, 1.0),)
    assert run(bench, region, 9.5, 9.5) and not run(bench, region, 9.5, 0.5)
