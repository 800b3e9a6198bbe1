"""
Make .venv with all that the demo and the tests need; return at once when it is there.

Run by make with the interpreter to build on. Standard library only.
"""

import hashlib
import importlib.util
from pathlib import Path
import shutil
import subprocess
import sys
import time

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / '.venv'
STAMP = VENV / 'stamp'
PYTHON = VENV / 'bin' / 'python'
LOG = ROOT / 'build' / 'set-up.log'
OFFLINE = ('NewConnectionError', 'NameResolutionError', 'ConnectTimeoutError', 'dns error',
           'Failed to establish', 'name resolution', 'ProxyError', 'Network is unreachable')


def main() -> int:
    """Bring .venv up to date; return an exit status."""
    wanted = fingerprint()
    if PYTHON.exists() and STAMP.is_file() and STAMP.read_text() == wanted:
        return 0
    if not (3, 10) <= sys.version_info[:2] <= (3, 13):
        return stop(f'Python {version()} does not fit: set PYTHON to a Python 3.10, 3.11, 3.12 '
                    'or 3.13.')
    if not sys.platform.startswith('linux'):
        return stop('ROS 2 comes as wheels for Linux only.')
    uv = shutil.which('uv')
    if uv is None and importlib.util.find_spec('ensurepip') is None:
        return stop(f'Python {version()} has no venv: install it (Debian and Ubuntu: '
                    f'apt install python{version()}-venv) and run make again.')
    started = time.monotonic()
    say(f'making .venv on Python {version()} (once; about 1.6 GB)')
    LOG.parent.mkdir(exist_ok=True)
    LOG.write_text('')
    if not ((uv is not None and install([uv, 'venv', '--quiet', '--clear', '--python',
                                         sys.executable, str(VENV)],
                                        [uv, 'pip', 'install', '--python', str(PYTHON)]))
            or install([sys.executable, '-m', 'venv', '--clear', str(VENV)],
                       [str(PYTHON), '-m', 'pip', 'install', '--disable-pip-version-check',
                        '--progress-bar', 'off', '--retries', '2'])):
        output = LOG.read_text(errors='replace')
        if any(sign in output for sign in OFFLINE):
            return stop('the package index cannot be reached: connect to the network and run '
                        'make again.')
        for line in output.splitlines()[-4:]:
            print('  ' + line[:200], file=sys.stderr)
        return stop(f'it failed; all that was said is in {LOG.relative_to(ROOT)}.')
    link_ament_index()
    STAMP.write_text(wanted)
    say(f'ready after {time.monotonic() - started:.0f} s')
    return 0


def fingerprint() -> str:
    """Return what .venv depends on: its place, the interpreter, the pins, what is installed."""
    digest = hashlib.sha256(f'{VENV} {sys.base_prefix} {sys.version}'.encode())
    for file in ('requirements.txt', 'setup.py', 'setup.cfg', 'tools/make_venv.py'):
        digest.update((ROOT / file).read_bytes())
    return digest.hexdigest()


def install(make_venv: list, pip_install: list) -> bool:
    """Make .venv, put the pinned packages and this one into it; return whether that worked."""
    return (run('an empty environment', make_venv)
            and run('pinned packages',
                    [*pip_install, '--no-deps', '-r', str(ROOT / 'requirements.txt')])
            and run('vsensor_ros, from its sources',
                    [*pip_install, '--no-deps', '--no-build-isolation', '-e', str(ROOT)]))


def link_ament_index() -> None:
    """Link what an editable install leaves out, as `colcon build --symlink-install` would."""
    launch_files = [path.relative_to(ROOT).as_posix() for path in (ROOT / 'launch').glob('*.py')]
    for link, target in (
        ('share/ament_index/resource_index/packages/vsensor_ros', 'resource/vsensor_ros'),
        ('share/vsensor_ros/package.xml', 'package.xml'),
        ('share/vsensor_ros/config', 'config'),
        # one by one: `ros2 launch` does not look into folders that are links
        *((f'share/vsensor_ros/{file}', file) for file in launch_files),
        ('lib/vsensor_ros', 'scripts'),
    ):
        (VENV / link).parent.mkdir(parents=True, exist_ok=True)
        (VENV / link).symlink_to(ROOT / target)


def run(what: str, command: list) -> bool:
    """Run a command: progress to the terminal, its output to the log; return whether it worked."""
    say(what)
    live = sys.stdout.isatty()
    shown = time.monotonic()
    with LOG.open('a') as log, subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            errors='replace') as process:
        for line in process.stdout or ():
            log.write(line)
            step = line.strip().split(' (from')[0][:76]
            if live:
                print('\r\x1b[K  ' + step, end='', flush=True)
            elif time.monotonic() - shown > 5.0:
                shown = time.monotonic()
                print('  ' + step, flush=True)
    if live:
        print('\r\x1b[K', end='', flush=True)
    if process.returncode != 0:
        say(f'{what}: {Path(command[0]).name} failed')
    return process.returncode == 0


def version() -> str:
    """Return the interpreter's version, as in 3.12."""
    return f'{sys.version_info[0]}.{sys.version_info[1]}'


def say(text: str) -> None:
    """Print one line of progress."""
    print('set-up: ' + text, flush=True)


def stop(text: str) -> int:
    """Print in one line why set-up ends; return the exit status."""
    print('set-up: ' + text, file=sys.stderr)
    return 1


if __name__ == '__main__':
    try:
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(stop('interrupted; make goes on from nothing next time.'))
