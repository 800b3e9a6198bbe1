"""Where one more sensor would help: by hand, and against designs with the sensor really added."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros import design, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.location import locations
from vsensor_ros.observers import VirtualSensor

# rho -> x1 -> x2 -> x3, and x4 by itself; y1 = x2, y2 = x3
CHAIN = np.array([[-1, 0, 0, 0], [1, -1, 0, 0], [0, 1, -1, 0], [0, 0, 0, -2.0]])


def chain(**more):
    return Plant.from_matrices(CHAIN, None, np.eye(4)[[1, 2]], D=[1, 0, 0, 0], **more)


def test_a_chain_by_hand():
    # x2 is driven by rho through x1, and x3 sees it one step too late; x3 follows from x2
    first, second = locations(chain())
    assert (first.name, first.gained) == ('x1', ((('y1',), 'y1'),))
    assert np.array_equal(first.row, [1, 0, 0, 0])
    # x4 raises every rank, (30), and is good for nothing: rho does not ask for ranks
    assert (second.name, second.gained) == ('x4', ())
    assert first.raised == second.raised == (('y1',), ('y2',))
    assert first.rank == second.rank == 3 and not first.complete and not second.complete


def test_pairs_of_a_chain_by_hand():
    first, second = locations(chain(), up_to=2)
    both = ('y1', 'y2')
    assert first.gained == ((('y1',), 'y1'), (both, 'y1'), (both, 'y2'))
    assert second.gained == ()
    assert first.raised == (('y1',), ('y2',), both)


def test_the_sensor_that_completes_the_state_comes_first_of_equals():
    three = Plant.from_matrices(-np.eye(3), None, np.eye(3)[:2], D=np.eye(3)[:, :2])
    found = locations(three, {'same': [1, 1, 0], 'new': [0, 0, 5.0], 'twice': [2, 0, 0]})
    # a second sensor of what y1 says lets y1 be lost; of x1 + x2 either one
    assert [f.name for f in found] == ['same', 'twice', 'new']
    assert found[0].gained == ((('y1',), 'y1'), (('y2',), 'y2'))
    assert found[1].gained == ((('y1',), 'y1'),)
    assert found[1].raised == (('y1',),) and found[0].raised == (('y1',), ('y2',))
    assert [f.complete for f in found] == [False, False, True]
    assert [f.rank for f in found] == [2, 2, 3]


def test_only_states_that_are_not_measured_alone_are_candidates():
    C, Cd = np.eye(3), [[0.0], [1.0], [0.0]]
    C[2] = [1, 1, 1]
    plant = Plant.from_matrices(-np.eye(3), None, C, D=[1, 0, 0], Cd=Cd)
    assert {place.name for place in locations(plant)} == {'x2', 'x3'}
    assert locations(Plant.from_matrices(-np.eye(2), None, np.eye(2))) == ()


@st.composite
def plants(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(2, 6))
    outputs, d = draw(st.integers(1, min(3, n))), draw(st.integers(1, 2))

    def sparse(rows, columns, share):
        return rng.integers(-2, 3, (rows, columns)) * (rng.random((rows, columns)) < share)
    A = sparse(n, n, 0.5) - draw(st.sampled_from([0, 4])) * np.eye(n)
    C = np.eye(n)[rng.permutation(n)[:outputs]] if draw(st.booleans()) else sparse(outputs, n, 0.5)
    Cd = sparse(outputs, d, 0.4) if draw(st.booleans()) else None
    return Plant.from_matrices(A, None, C, D=sparse(n, d, 0.5), Cd=Cd)


def wider(plant, row):
    """Add the sensor for good."""
    return Plant.from_matrices(
        plant.A, None, np.vstack([plant.C, row]), D=plant.D, sensors=(*plant.sensors, 'new'),
        Cd=np.vstack([plant.Cd, np.zeros(plant.Cd.shape[1])]))


def exists(entry):
    """Whether one exists, be it that none passed the check of its equations."""
    return (isinstance(entry, VirtualSensor)
            or entry.reason.startswith('the linear equations allow'))


@pytest.mark.slow
@pytest.mark.usefixtures('without_alternatives')
@settings(max_examples=6)
@given(plants())
def test_as_designs_with_the_sensor_really_added(plant):
    before = design(plant, up_to=2, temporary=False)
    missing = {key for key, entry in before.entries.items() if not exists(entry)}
    sets = sorted({fault_set for fault_set, _ in missing}, key=lambda s: (len(s), s))
    for place in locations(plant, up_to=2):
        after = design(wider(plant, place.row), sets, temporary=False).entries if sets else {}
        expected = {key for key in missing if exists(after[key])}
        assert set(place.gained) == expected
        assert expected <= {(s, c) for s in place.raised for c in s}  # (30) is necessary
        added = wider(plant, place.row)
        assert place.rank == (np.linalg.matrix_rank(np.hstack([added.C, added.Cd]))
                              - np.linalg.matrix_rank(added.Cd))
        assert place.complete == (place.rank == len(plant.states))


@pytest.mark.parametrize(('candidates', 'up_to', 'needle'), [
    ([1, 2], 1, 'is not a mapping'),
    ({'a b': [1, 0, 0, 0]}, 1, 'a b'),
    ({'a': [1, 0]}, 1, 'candidates.a: [1, 0] is not a row that measures something'),
    ({'a': [0, 0, 0, 0]}, 1, 'candidates.a'),
    ({'a': [1, 0, 0, np.nan]}, 1, 'candidates.a'),
    ({'a': 'row'}, 1, 'is not numbers'),
    (None, 0, 'up_to: 0 is not a number of sensors'),
    (None, True, 'up_to: True'),
    (None, 1.5, 'up_to: 1.5'),
])
def test_bad_input(candidates, up_to, needle):
    with pytest.raises(BadInput, match='.*') as caught:
        locations(chain(), candidates, up_to)
    assert needle in str(caught.value)
