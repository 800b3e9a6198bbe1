"""The case of two replacers, with a process that ends as it is told to in place of the second."""

from contextlib import nullcontext
import time
from types import SimpleNamespace

import pytest

from vsensor_ros.lab.injection import restart_cases
from vsensor_ros.lab.injection.case_context import CaseContext
from vsensor_ros.lab.process import Process

# what a replacer does until SIGTERM, as far as this case is concerned
SECOND = 'trap "echo last words; exit {status}" TERM; echo up; while :; do sleep 0.01; done'


@pytest.mark.parametrize('status, wrong', [
    (0, []), (3, ['the second one: it ended with 3 (last words)'])])
def test_a_second_replacer_that_ends_badly_is_told(tmp_path, monkeypatch, status, wrong):
    failed_over = []
    monkeypatch.setattr(restart_cases, 'fail_over', lambda *_: failed_over.append(True))
    log = tmp_path / 'log'

    def start():
        return Process('the second', ['none'], 1, log, ['sh', '-c', SECOND.format(status=status)])

    def until(condition, within, what):
        end = time.monotonic() + 60.0
        while 'up' not in log.read_text():
            assert time.monotonic() < end, what
            time.sleep(0.01)

    context = SimpleNamespace(
        target='y2', tested=SimpleNamespace(wiring=SimpleNamespace(
            ports={'y2': SimpleNamespace(output='/y2')})),
        wrong=[], start=start, until=until, play=lambda seconds: time.sleep(0.001),
        excused=lambda **_: nullcontext(), told=lambda *_, within: None, forget_path=lambda: None,
        end=lambda process: CaseContext.end(context, process))
    restart_cases.two_replacers(context)
    assert context.wrong == wrong and failed_over == [True]
