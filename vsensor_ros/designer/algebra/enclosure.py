"""Bounds of an expression over a box, by intervals and bisection."""

from __future__ import annotations

from collections.abc import Callable, Mapping
import heapq
import itertools
import math

from vsensor_ros.functions.expression import function_of, Name, names, Node, Number
from vsensor_ros.functions.interval import Interval

BOXES = 400  # looked at before bisection gives up

Box = Mapping[str, Interval]


def enclosed(node: Node, box: Box) -> Interval:
    """Return an interval that holds all values of an expression over a box."""
    if isinstance(node, Number):
        return node.value, node.value
    if isinstance(node, Name):
        return box[node.id]
    bounds = function_of(node).bounds(*(enclosed(a, box) for a in node.arguments))[0]
    return bounds if not any(map(math.isnan, bounds)) else (-math.inf, math.inf)


def upper_bound(bound: Callable[[Box], float], box: Box, used: tuple[str, ...],
                below: float) -> float:
    """
    Return an upper bound over a box, bisected until it is below a limit or time is up.

    bound: an upper bound over one box; used: the names that are worth bisecting.
    """
    count = itertools.count()
    heap = [(-bound(box), next(count), dict(box))]
    width = {name: (box[name][1] - box[name][0]) or 1.0 for name in used}
    for _ in range(BOXES):
        worst, _, own = heap[0]
        if -worst < below or not used:
            break
        name = max(used, key=lambda v: (own[v][1] - own[v][0]) / width[v])
        low, high = own[name]
        middle = 0.5 * (low + high)
        heapq.heappop(heap)
        for part in ((low, middle), (middle, high)):
            half = {**own, name: part}
            heapq.heappush(heap, (-bound(half), next(count), half))
    return -heap[0][0]


def used_in(*nodes: Node) -> tuple[str, ...]:
    """Return the names in expressions."""
    return tuple(dict.fromkeys(name for node in nodes for name in names(node)))
