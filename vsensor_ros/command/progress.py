"""How far a command is, on a terminal where somebody watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys

Progress = Callable[[int, int, str], None]


@contextmanager
def shown_progress() -> Iterator[Progress | None]:
    """
    Give f(done, total, what is next), which keeps one line on stderr up to date.

    With rich a bar and the time that is left. None where nobody watches. Nothing is left of it.
    """
    if sys.stderr is None or not sys.stderr.isatty():
        yield None
        return
    try:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress as Bars,
            TextColumn,
            TimeRemainingColumn,
        )
    except ImportError:
        yield _line
        sys.stderr.write('\r\x1b[K')
        sys.stderr.flush()
        return
    with Bars(MofNCompleteColumn(), BarColumn(20), TimeRemainingColumn(),
              TextColumn('{task.description}', markup=False), console=Console(stderr=True),
              transient=True, auto_refresh=False) as bars:
        bar = bars.add_task('', total=None)
        yield lambda done, total, text: bars.update(
            bar, completed=done, total=total, description=text, refresh=True)


def _line(done: int, total: int, text: str) -> None:
    sys.stderr.write(f'\r\x1b[K{done}/{total} {text:.60}')
    sys.stderr.flush()
