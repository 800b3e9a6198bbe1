"""Least hitting sets against brute force."""

from itertools import combinations

from hypothesis import given, settings, strategies as st

from vsensor_ros.isolator.conflicts import least_hitting_sets, minimal

SENSORS = 7
CONFLICTS = st.lists(st.integers(1, 2**SENSORS - 1), max_size=6)


@settings(max_examples=300, deadline=None)
@given(CONFLICTS)
def test_they_are_all_of_the_smallest_that_meet_every_conflict(conflicts):
    for size in range(SENSORS + 1):
        brute = sorted(mask for mask in map(sum, combinations(
            [1 << i for i in range(SENSORS)], size)) if all(mask & c for c in conflicts))
        if brute:
            break
    assert least_hitting_sets(conflicts, SENSORS) == brute


@settings(max_examples=100, deadline=None)
@given(CONFLICTS)
def test_minimal_conflicts_are_met_by_the_same_sets(conflicts):
    kept = minimal(conflicts)
    assert all((a & b) not in (a, b) for a, b in combinations(kept, 2))
    for mask in range(2**SENSORS):
        assert all(mask & c for c in kept) == all(mask & c for c in conflicts)


def test_nobody_explains_an_empty_conflict_and_more_than_the_most_are_not_looked_for():
    assert least_hitting_sets([0b1, 0]) == []
    assert least_hitting_sets([1 << i for i in range(6)], most=4) == []
