"""When a replacer that was activated begins to send: once it knows what isolation said before."""

from __future__ import annotations

from collections.abc import Callable
import time

from vsensor_ros.node.reports import Reports

DISCOVERY = 0.5  # s between the first that is found of the others and the last
LONGEST = 1.5  # s that the history of the isolation topic may take


class Start:
    """
    The time between activation and the first message.

    A driver is heard as soon as it is found, what isolation said before only a little later. So
    after a restart in the middle of a fault the failed reading would go out as real meanwhile.
    """

    def __init__(self, reports: Reports, is_heard: Callable[[], bool],
                 say: Callable[[str], None]) -> None:
        """Prepare to wait; is_heard: whether any driver was, of late or before. say: a warning."""
        self._reports, self._is_heard, self._say = reports, is_heard, say
        self._first: float | None = None  # when anything was heard of the others
        self._since: float | None = None  # it has been waiting; None: it does not

    @property
    def waits(self) -> bool:
        """Whether nothing goes out, though there would be something."""
        return self._since is not None and self._hears()

    def _hears(self) -> bool:
        return self._reports.heard or self._is_heard()

    def begin(self) -> None:
        """Wait from now on."""
        self._since = time.monotonic()

    def end(self) -> None:
        """Wait no more."""
        self._since = None

    def is_over(self) -> bool:
        """Tell whether it has waited long enough, which is so once."""
        if self._since is None:
            return False
        now = time.monotonic()
        if self._first is None and self._hears():
            self._first = now
        if self._first is None or now < self._first + DISCOVERY:
            return False
        if not self._reports.known:
            if now < max(self._first, self._since) + LONGEST:
                return False
            self._say(f'{self._reports.topic}: a publisher there keeps what it said for late '
                      f'joiners, but nothing came within {LONGEST:g} s; until it does, sensors of '
                      'which nothing was said count as healthy')
        self.end()
        return True
