"""One line on a subject, then no other on it for a while."""

from __future__ import annotations

from collections import Counter
import time
from typing import Any

QUIET = 5.0  # s between two lines on the same subject
MOST = 10_000  # subjects, some of which come from outside, before they are forgotten


class Log:
    """The node's log, which what comes in cannot flood."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self.counts: Counter[tuple[str, str]] = Counter()  # by channel and reason
        self._spoken: dict[object, float] = {}  # by subject: when it may be spoken of again

    def count(self, name: str, reason: str) -> None:
        """Count, and say now and then, what of a channel was not used or not sent, and why."""
        self.counts[name, reason] += 1
        self.say(f'{name}: {reason} ({self.counts[name, reason]} so far)', 'warning',
                 (name, reason))

    def say(self, text: str, level: str = 'error', subject: object = None) -> None:
        """Log at a level: 'error', 'warning' or 'info'; the subject is the text if not given."""
        at, subject = time.monotonic(), text if subject is None else subject
        if at < self._spoken.get(subject, 0.0):
            return
        if len(self._spoken) > MOST:
            self._spoken.clear()
        self._spoken[subject] = at + QUIET
        if level == 'error':  # rclpy allows one severity a line of code
            self._logger.error(text)
        elif level == 'warning':
            self._logger.warning(text)
        else:
            self._logger.info(text)
