"""Which orders are looked at: each of a small plant; of a large one by strides that double."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from typing import Generic, TypeVar

Found = TypeVar('Found')
LARGE = 100  # states, beyond which not every order is looked at


def by_strides(good: Callable[[int], bool], first: int, last: int) -> int | None:
    """
    Return the least good order from ``first`` to ``last``, as far as strides can tell, or None.

    What is good is taken to stay so: with a polynomial p of one order there is (s + a) p of the
    next. Of r orders about 2 log2(r) are asked for.
    """
    bad, k, stride = first - 1, first, 1
    while not good(k):
        if k >= last:
            return None
        bad, k, stride = k, min(k + stride, last), 2 * stride
    while k - bad > 1:
        middle = (bad + k) // 2
        bad, k = (bad, middle) if good(middle) else (middle, k)
    return k


class Listed(Generic[Found]):
    """What an iterator yields, by its place, as far as it is asked for."""

    def __init__(self, more: Iterator[Found]) -> None:
        self._more = more
        self._found: list[Found] = []

    def at(self, k: int) -> Found | None:
        """Return the k-th, None beyond the end."""
        self._found += islice(self._more, max(0, k + 1 - len(self._found)))
        return self._found[k] if k < len(self._found) else None
