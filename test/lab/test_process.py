"""Children of ours: what they say, how they end, and that none is left."""

from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

from vsensor_ros.lab.process import Failed, Process

ROOT = Path(__file__).parents[2]


def test_it_ends_with_us_and_says_how(tmp_path):
    log = tmp_path / 'log.txt'
    with Process('the server', ['http.server', '0', '--bind', '127.0.0.1'], 1, log) as server:
        assert server.alive and server.waited() >= 0.0 and server.cpu() >= 0.0
        server.check()
    assert not server.alive and server.popen.returncode == -signal.SIGTERM
    ended = Process('the wrong one', ['no_such_module'], 1, log)
    ended.popen.wait(30.0)
    with pytest.raises(Failed, match='the wrong one ended with 1: .*no_such_module'):
        ended.check()
    ended.check(1)
    assert 'it had ended with 1' in ended.end()


@pytest.mark.skipif(sys.platform != 'linux', reason='prctl is of Linux')
def test_it_dies_with_a_parent_that_is_killed(tmp_path):
    parent = subprocess.Popen([sys.executable, '-c', f"""
from pathlib import Path
import time
from vsensor_ros.lab.process import Process
child = Process('it', ['http.server', '0', '--bind', '127.0.0.1'], 1,
                Path({str(tmp_path)!r}) / 'log')
print(child.popen.pid, flush=True)
time.sleep(60.0)
"""], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    child = Path('/proc') / parent.stdout.readline().strip()
    assert child.is_dir()
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    while child.is_dir() and ') Z' not in (child / 'stat').read_text():  # or the test times out
        time.sleep(0.01)
