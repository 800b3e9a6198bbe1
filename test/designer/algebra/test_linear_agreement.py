"""On linear plants the search agrees with the geometric test, in dimension and verdict."""

import numpy as np
import pytest

from vsensor_ros.designer.algebra.forced import forced
from vsensor_ros.designer.algebra.invariant import element_gradients, largest, products
from vsensor_ros.designer.algebra.model import read
from vsensor_ros.designer.algebra.null_space import ranks
from vsensor_ros.designer.algebra.reduction import Inside
from vsensor_ros.designer.algebra.search import image_rank
from vsensor_ros.designer.subspaces import conditioned_invariant, kernel

from .systems import system


def linear(row, names):
    return ' + '.join(f'({int(c)})*{name}' for c, name in zip(row, names) if c) or '0'


def plants(count, sizes, discrete, seed):
    """Yield (A, C, D, V, model) of random plants; discrete ones reach all states."""
    random = np.random.default_rng(seed)
    while count:
        n = int(random.integers(*sizes))
        m, s, outputs = random.integers(0, 2), random.integers(1, 3), random.integers(1, 3)
        A = random.integers(-2, 3, (n, n)) * (random.random((n, n)) < 0.5)
        B, D = random.integers(-2, 3, (n, m)), random.integers(-1, 2, (n, s))
        C, V = random.integers(-1, 2, (outputs, n)), random.integers(-1, 2, (1, n))
        if not (D.any() and C.any() and V.any()) or (
                discrete and np.linalg.matrix_rank(np.hstack([A, B, D])) < n):
            continue
        count -= 1
        x, u, r = ([f'{letter}{i}' for i in range(size)] for letter, size in (
            ('x', n), ('u', m), ('r', s)))
        yield A.astype(float), C.astype(float), D.astype(float), V, read(system(
            dict.fromkeys(x, (-1, 1)),
            [linear([*A[i], *B[i], *D[i]], [*x, *u, *r]) for i in range(n)],
            {f'y{i}': linear(row, x) for i, row in enumerate(C)}, {'v': linear(V[0], x)},
            dict.fromkeys(u, (-1, 1)), dict.fromkeys(r, (-1, 1)), (),
            1.0 if discrete else None))


def compare(count, sizes, degree, discrete, seed, proof=False):
    verdicts = set()
    for A, C, D, V, model in plants(count, sizes, discrete, seed):
        n = len(A)
        assert not discrete or image_rank(model) == n
        own = products(model, degree, False, False)
        gamma = largest(model, own)
        T = conditioned_invariant(A, C, D)
        found = ranks(element_gradients(own, gamma, model.points(5, 1)[:n]))
        assert found.max(initial=0) == n - T.shape[1], model.system
        unseen = T @ kernel(C @ T, size=1.0)
        exists = not unseen.shape[1] or bool(np.abs(V @ unseen).max() < 1e-9)
        assert Inside(model, own, gamma).told() == exists, model.system
        verdicts.add(exists)
        if proof:
            blind = forced(model, list(model.wanted.values()))
            assert (blind.dimension, blind.blocks) == (T.shape[1], not exists), model.system
    assert verdicts == {True, False}


@pytest.mark.parametrize('discrete', [False, True])
def test_degree_one(discrete):
    compare(60, (3, 7), 1, discrete, 1)


@pytest.mark.parametrize('discrete', [False, True])
def test_degree_two(discrete):
    compare(15, (3, 5), 2, discrete, 2)


def test_forced_directions_are_those_of_the_geometric_test():
    compare(15, (3, 5), 1, False, 3, proof=True)


@pytest.mark.slow
@pytest.mark.parametrize('discrete', [False, True])
@pytest.mark.parametrize('degree, count', [(1, 300), (2, 100)])
def test_hundreds(degree, count, discrete):
    compare(count, (3, 7) if degree == 1 else (3, 5), degree, discrete, 4)
