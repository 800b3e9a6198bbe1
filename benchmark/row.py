"""One line of the result: our figure, the peer's, and how large they may be."""

from __future__ import annotations

from dataclasses import dataclass
import math


@dataclass(frozen=True)
class Row:
    """
    Two figures of one unit.

    Ours must be at most `bar` times the peer's, and at most `most` in itself, if there are such.
    """

    group: str  # what is compared, and with which peer
    what: str
    unit: str
    ours: float
    peer: float
    bar: float | None = None
    most: float | None = None

    @property
    def ratio(self) -> float:
        """Ours by the peer's; NaN when the peer's is 0."""
        return self.ours / self.peer if self.peer else math.nan

    @property
    def missed(self) -> bool:
        """Whether a bar is missed; what is not a number misses it."""
        return (self.bar is not None and not self.ratio <= self.bar
                or self.most is not None and not self.ours <= self.most)
