"""One line of the result: our figure, the peer's, and how large the ratio may be."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """Two figures of one unit; ours must be at most `bar` times the peer's, if there is a bar."""

    group: str  # what is compared, and with which peer
    what: str
    unit: str
    ours: float
    peer: float
    bar: float | None = None

    @property
    def ratio(self) -> float:
        """Ours by the peer's."""
        return self.ours / self.peer

    @property
    def missed(self) -> bool:
        """Whether there is a bar and it is missed; a ratio that is not a number misses it."""
        return self.bar is not None and not self.ratio <= self.bar
