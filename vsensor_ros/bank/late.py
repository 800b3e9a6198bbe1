"""How far late data takes the state back, and what that may cost."""

from __future__ import annotations

_REDONE = 4  # steps redone for each new one, in the mean


class Late:
    """
    What late data has changed, by tick.

    span: steps that can be taken back, at most. usual: by how many steps readings are late by
    themselves.
    """

    def __init__(self, span: int, usual: int = 0) -> None:
        """Begin with nothing."""
        self._span, self._redone = span, _REDONE + max(0, usual)
        self.reset()

    def reset(self) -> None:
        """Forget all."""
        self._redo: int | None = None  # the last tick that late data leaves as it was
        self._credit = self._span  # steps that may be redone now

    @property
    def waits(self) -> bool:
        """Whether some late data has not been heeded yet."""
        return self._redo is not None

    def note(self, tick: int) -> None:
        """Note that something has changed after a tick."""
        if self._redo is None or tick < self._redo:
            self._redo = tick

    def forget(self) -> None:
        """Forget it, for there are no states yet."""
        self._redo = None

    def due(self, oldest: int, newest: int, last: int) -> int:
        """
        Return how many of the states from oldest to newest tick are to be dropped now.

        last: the tick that the newest state will have. It waits when that is often and far.
        """
        self._credit = min(self._credit + self._redone * max(0, last - newest), self._span)
        if self._redo is None:
            return 0
        steps = newest - max(self._redo, oldest, newest - self._span)
        if steps > self._credit:
            return 0
        self._redo = None
        self._credit -= max(0, steps)
        return max(0, steps)
