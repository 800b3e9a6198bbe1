"""Replacers as processes: started, killed, and with a /dev/shm of their own that is full."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
import ctypes
import os
from pathlib import Path
import shutil
import signal
import subprocess
import sys

PATIENCE = 10.0     # s that a process may take to end in order
TINY = 16           # kB of a /dev/shm that is as good as full

_libc = ctypes.CDLL(None) if sys.platform == 'linux' else None


class Process:
    """A replacer of ours; dead at the end whatever happens."""

    def __init__(self, arguments: Sequence[str], domain: int, log: Path,
                 full_shm: bool = False) -> None:
        """Start it. full_shm: in a mount namespace where /dev/shm has room for nothing."""
        root = str(Path(__file__).parents[3])
        paths = [root, *filter(None, [os.environ.get('PYTHONPATH')])]
        environment = {**os.environ, 'ROS_DOMAIN_ID': str(domain),
                       'PYTHONPATH': os.pathsep.join(paths), 'ROS_LOG_DIR': str(log.parent)}
        command = [sys.executable, '-m', 'vsensor_ros.command.replacer', *arguments]
        if full_shm:
            command = [*_private(), f'mount -t tmpfs -o size={TINY}k tmpfs /dev/shm && '
                       f'exec "$@"', 'sh', *command]
        self.log = log
        with open(log, 'ab') as file:
            self.popen = subprocess.Popen(command, env=environment, stdin=subprocess.DEVNULL,
                                          stdout=file, stderr=file, preexec_fn=_die_with_parent)

    @property
    def alive(self) -> bool:
        """Tell whether it runs."""
        return self.popen.poll() is None

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


def no_private_shm() -> str:
    """Return why a /dev/shm of its own cannot be made for a process, '' if it can."""
    if sys.platform != 'linux' or not shutil.which('unshare'):
        return 'there is no unshare'
    tried = subprocess.run([*_private(), 'mount -t tmpfs -o size=16k tmpfs /dev/shm'],
                           stdin=subprocess.DEVNULL, capture_output=True, text=True)
    return '' if tried.returncode == 0 else 'no mount namespace can be made here: ' + (
        tried.stderr.strip().splitlines() or ['refused'])[-1]


def _private() -> list[str]:
    """Return the beginning of a command, up to a shell's script, in its own mount namespace."""
    user = [] if os.geteuid() == 0 else ['--user', '--map-root-user']
    return ['unshare', *user, '--mount', '--propagation', 'private', 'sh', '-c']


def _die_with_parent() -> None:
    """Have Linux kill this process when its parent is killed and cannot do it any more."""
    if _libc:
        _libc.prctl(1, signal.SIGKILL)
