"""One line on a subject, then no other on it for a while."""

from __future__ import annotations

import time
from typing import Any

QUIET = 5.0  # s between two lines on the same subject
MOST = 10_000  # subjects, some of which come from outside, before they are forgotten


class Log:
    """The node's log, which what comes in cannot flood."""

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._spoken: dict[object, float] = {}  # by subject: when it may be spoken of again

    def say(self, text: object, level: str = 'error', subject: object = None) -> None:
        """Log at a level: 'error', 'warning' or 'info'; the subject is the text if not given."""
        at, subject = time.monotonic(), text if subject is None else subject
        if at < self._spoken.get(subject, 0.0):
            return
        if len(self._spoken) > MOST:
            self._spoken.clear()
        self._spoken[subject] = at + QUIET
        if level == 'error':  # rclpy allows one severity a line of code
            self._logger.error(str(text))
        elif level == 'warning':
            self._logger.warning(str(text))
        else:
            self._logger.info(str(text))
