"""Children of ours as processes: modules that are started, watched, ended, and never left."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import ctypes
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

ROOT = Path(__file__).resolve().parents[2]  # of the modules
PATIENCE = 10.0  # s that a process may take to end in order

_libc = ctypes.CDLL(None) if sys.platform == 'linux' else None


class Failed(RuntimeError):
    """A run that could not be finished; str() is one line."""


class Process:
    """A child of ours in a ROS domain; it ends at the latest when we do."""

    def __init__(self, name: str, arguments: Sequence[str], domain: int, log: Path,
                 prefix: Sequence[str] = ()) -> None:
        """
        Start a module, given with its arguments, as `name`; what it says is added to `log`.

        prefix: a command that runs the one after it, such as unshare.
        """
        paths = [str(ROOT), *filter(None, [os.environ.get('PYTHONPATH')])]
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain),
                       'PYTHONPATH': os.pathsep.join(paths),
                       'ROS_LOG_DIR': str(log.parent / 'log')}
        self.name, self.log = name, log
        with open(log, 'ab') as file:
            self.popen = subprocess.Popen(
                [*prefix, sys.executable, '-m', *arguments], env=environment,
                stdin=subprocess.DEVNULL, stdout=file, stderr=file, preexec_fn=die_with_parent)

    @property
    def alive(self) -> bool:
        """Tell whether it runs."""
        return self.popen.poll() is None

    def cpu(self) -> float:
        """Return the CPU time that all its threads have used [s]."""
        return time.clock_gettime(~self.popen.pid << 3 | 2)  # as clock_getcpuclockid(3) does

    def waited(self) -> float:
        """Return how long its threads, all together, have waited for a processor [s]."""
        waited = 0.0
        for path in Path(f'/proc/{self.popen.pid}/task').glob('*/schedstat'):
            with suppress(OSError):     # a thread that has just ended
                waited += 1e-9 * float(path.read_text().split()[1])
        return waited

    def check(self, *allowed: int) -> None:
        """Raise Failed if it has ended, but with one of these statuses."""
        if not self.alive and self.popen.returncode not in allowed:
            raise Failed(f'{self.name} ended with {self.popen.returncode}: {self.last_words()} '
                         f'({self.log})')

    def end(self, number: int = signal.SIGTERM) -> str:
        """Send it a signal and wait; return what was wrong with how it ended, '' if nothing."""
        if not self.alive:
            return f'it had ended with {self.popen.returncode} ({self.last_words()})'
        self.popen.send_signal(number)
        with suppress(subprocess.TimeoutExpired):
            self.popen.wait(PATIENCE)
        return self.trouble(number)

    def trouble(self, number: int) -> str:
        """Return what was wrong with how it ended after a signal, '' if nothing; end it."""
        if self.alive:
            self.popen.kill()
            self.popen.wait()
            return f'it did not end within {PATIENCE:g} s of a signal'
        status = self.popen.returncode
        expected = -number if number == signal.SIGKILL else 0
        return '' if status == expected else f'it ended with {status} ({self.last_words()})'

    def last_words(self) -> str:
        """Return the last line of its log."""
        said = self.log.read_text(errors='replace').strip().splitlines()
        return said[-1] if said else 'it said nothing'

    def __enter__(self) -> Process:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()


def die_with_parent() -> None:
    """Have Linux kill this process when its parent is killed and cannot do it any more."""
    if _libc:
        _libc.prctl(1, signal.SIGKILL)
