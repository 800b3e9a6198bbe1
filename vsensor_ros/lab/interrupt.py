"""Ctrl-C and SIGTERM, once."""

import signal
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM)


def interrupt_once() -> None:
    """Have the first SIGINT or SIGTERM raise KeyboardInterrupt, and no other disturb the end."""
    for number in SIGNALS:
        signal.signal(number, _interrupt)


def _interrupt(*_: Any) -> None:
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
