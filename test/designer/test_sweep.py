"""Sweeps: the same design whoever does the work, and nothing lost when somebody stops or dies."""

from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from copy import copy
import os
from pathlib import Path
import signal
import subprocess
import sys
from threading import Barrier, Timer
import time
import warnings

import numpy as np
import pytest
from scipy.linalg import LinAlgWarning
from threadpoolctl import threadpool_info

from vsensor_ros import design, load_plant, Plant, Refusal
from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.calm import calmly
from vsensor_ros.designer.processes import ONE_THREAD, Processes
from vsensor_ros.designer.sweep import in_order
from vsensor_ros.designer.unfinished import Unfinished

CHAIN = """
name: chain
time: continuous
states:
  a: {unit: m, range: [-2, 2]}
  b: {unit: m, range: [-2, 2]}
  c: {unit: m, range: [-2, 2]}
inputs: {u: {unit: m/s, range: [-1, 1]}}
disturbances: {leak: {unit: m/s}}
dynamics: {a: u + leak - a - tanh(a), b: a - b, c: b - c}
sensors:
  ya: {measures: a, unit: m, noise: 0.01}
  yb: {measures: b, unit: m, noise: 0.01}
  yc: {measures: exp(0.5*c), noise: 0.01}
"""
ASKED = {'up_to': 3}


@pytest.fixture(scope='module')
def chain(tmp_path_factory):
    """Make a plant with a term, a curve, an unknown input, and refusals of fewer faults."""
    path = tmp_path_factory.mktemp('chain') / 'chain.yaml'
    path.write_text(CHAIN)
    return load_plant(path)


@pytest.fixture(scope='module')
def alone(chain):
    """Design it one after the other."""
    return design(chain, **ASKED)


@pytest.fixture(scope='module')
def processes():
    with Processes(2) as executor:
        yield executor


def text_of(result, tmp_path):
    path = tmp_path / 'design.json'
    result.save(path)
    return path.read_text()


def key_of(given):
    """Return fault set and channel of a task."""
    return next(part for part in given if type(part) is tuple)


class Meddling(Executor):
    """Does all at once, but meddles with some channels first."""

    def __init__(self, meddle):
        self._meddle = meddle
        self.asked = []

    def submit(self, function, /, *given, **named):
        key = key_of(given)
        self.asked.append(key)
        future = Future()
        try:
            self._meddle(key)
            future.set_result(function(*given, **named))
        except Exception as error:
            future.set_exception(error)
        return future


class Backwards(Executor):
    """Does the latest first, in threads, after a while in which more may come."""

    def __init__(self):
        self._waiting = []

    def submit(self, function, /, *given, **named):
        future = Future()
        self._waiting.append((future, function, given, named))
        Timer(0.05, self._go).start()
        return future

    def _go(self):
        future, function, given, named = self._waiting.pop()
        future.set_result(function(*given, **named))


@contextmanager
def dask_cluster():
    distributed = pytest.importorskip('dask.distributed', reason='dask is not installed: '
                                      "pip install 'dask[distributed]'")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) \
            as cluster, distributed.Client(cluster) as client:
        yield client.get_executor()


@pytest.mark.parametrize('executor', [
    pytest.param(lambda: ThreadPoolExecutor(3), id='threads'),
    pytest.param(Backwards, id='backwards')])
def test_any_executor_gives_the_same_design_file(chain, alone, tmp_path, executor):
    with executor() as given:
        result = design(chain, executor=given, **ASKED)
    assert list(result.entries) == list(alone.entries)
    assert text_of(result, tmp_path) == text_of(alone, tmp_path)


def test_processes_give_the_same_design_file(chain, tmp_path, processes):
    asked = {'fault_sets': [(), ('yc',), ('ya', 'yc')], 'bounded': True, 'prefer': 'least',
             'wanted': {'both': [[0, 1.0, 0], [0, 0, 1]]}}
    result, alone = design(chain, executor=processes, **asked), design(chain, **asked)
    assert list(result.entries) == list(alone.entries)
    assert text_of(result, tmp_path) == text_of(alone, tmp_path)
    virtual = result['yc', 'yc']
    with pytest.raises(ValueError, match='read-only'):
        virtual.N[0, 0] = 1.0
    with pytest.raises(ValueError, match='read-only'):
        virtual.certificate.S[0, 0] = 1.0


def test_what_fewer_faults_rule_out_is_said_of_more_whatever_comes_first(chain, alone):
    with Backwards() as executor:
        result = design(chain, [('ya',), ('ya', 'yb'), ('ya', 'yb', 'yc')], executor=executor)
    reason = result[('ya', 'yb', 'yc'), 'yb'].reason
    assert reason.startswith('already when ya and yb alone have failed')
    assert reason == alone[('ya', 'yb', 'yc'), 'yb'].reason


def test_progress_counts_what_is_done(chain):
    told = []
    design(chain, progress=lambda *one: told.append(one))
    assert told == [(0, 3, 'ya without ya'), (1, 3, 'yb without yb'), (2, 3, 'yc without yc'),
                    (3, 3, 'done')]
    told.clear()
    with ThreadPoolExecutor(2) as executor:
        design(chain, executor=executor, progress=lambda *one: told.append(one))
    assert [done for done, *_ in told] == [0, 1, 2, 3] and told[-1] == (3, 3, 'done')


def test_what_is_no_executor_is_refused(chain):
    with pytest.raises(BadInput, match="executor: '4' is not an executor; give a concurrent"):
        design(chain, executor='4')


def test_an_error_names_its_fault_set_and_loses_nothing_else(chain, alone, tmp_path):
    """Even where others were designed without what the failed one would have told them."""
    def meddle(key):
        if key == (('ya',), 'ya'):
            raise MemoryError('no room')
    work = tmp_path / 'work'
    with pytest.raises(Unfinished) as caught:
        design(chain, up_to=3, executor=Meddling(meddle), work_file=work)
    assert str(caught.value) == ('ya without ya: MemoryError: no room; 1 of 12 channels failed, '
                                 'the others are designed')
    assert list(caught.value.failed) == [(('ya',), 'ya')]
    assert len(caught.value.design.entries) == 11
    again = Meddling(lambda key: None)
    result = design(chain, up_to=3, executor=again, work_file=work)
    # those that follow from it anew, because they are said otherwise
    assert again.asked == [(('ya',), 'ya'), *((s, 'ya') for s in (
        ('ya', 'yb'), ('ya', 'yc'), ('ya', 'yb', 'yc')))]
    assert text_of(result, tmp_path) == text_of(alone, tmp_path)


def test_an_error_without_an_executor_does_the_same(chain, monkeypatch):
    module = sys.modules['vsensor_ros.designer.design']  # not the function of the same name
    pose = module.pose

    def posed(plant, lost, channel, rows):
        if lost == ('yb',):
            raise np.linalg.LinAlgError('did not converge')
        return pose(plant, lost, channel, rows)
    monkeypatch.setattr(module, 'pose', posed)
    with pytest.raises(Unfinished, match='yb without yb: LinAlgError: did not converge') as caught:
        design(chain)
    assert list(caught.value.design.entries) == [(('ya',), 'ya'), (('yc',), 'yc')]
    assert isinstance(caught.value.__cause__, np.linalg.LinAlgError)


DEADLY = (('yb', 'yc'), 'yb')


class Deadly(Executor):
    """Lets the process die that is given some channel."""

    def __init__(self, processes):
        self._processes = processes

    def submit(self, function, /, *given, **named):
        if key_of(given) == DEADLY:
            return self._processes.submit(signal.raise_signal, signal.SIGKILL)
        return self._processes.submit(function, *given, **named)


def test_a_killed_worker_names_its_fault_set_and_loses_nothing_else(chain, alone, processes,
                                                                    tmp_path):
    work = tmp_path / 'work'
    with pytest.raises(Unfinished, match='yb without yb, yc: BrokenProcessPool') as caught:
        design(chain, executor=Deadly(processes), work_file=work, **ASKED)
    assert set(caught.value.failed) == {DEADLY}
    assert isinstance(caught.value.failed[DEADLY], BrokenExecutor)
    result = design(chain, executor=processes, work_file=work, **ASKED)
    assert text_of(result, tmp_path) == text_of(alone, tmp_path)


@pytest.mark.slow
def test_a_dask_cluster_of_two_workers_does_the_same(chain, alone, tmp_path):
    with dask_cluster() as executor:
        assert text_of(design(chain, executor=executor, **ASKED), tmp_path) == text_of(
            alone, tmp_path)
        assert in_order(divmod, [(k, 3) for k in range(9)], executor) == [
            divmod(k, 3) for k in range(9)]
        work = tmp_path / 'work'
        with pytest.raises(Unfinished, match='yb without yb, yc: KilledWorker') as caught:
            design(chain, executor=Deadly(executor), work_file=work, **ASKED)
        assert set(caught.value.failed) == {DEADLY}
        result = design(chain, executor=executor, work_file=work, **ASKED)
        assert text_of(result, tmp_path) == text_of(alone, tmp_path)


def test_what_is_done_when_it_is_stopped_is_not_done_again(chain, alone, tmp_path):
    stopped_after = 7

    def stop(done, *_):
        if done == stopped_after:
            raise KeyboardInterrupt
    work = tmp_path / 'work'
    with pytest.raises(KeyboardInterrupt):
        design(chain, progress=stop, work_file=work, **ASKED)
    again = Meddling(lambda key: None)
    result = design(chain, executor=again, work_file=work, **ASKED)
    assert set(again.asked) == set(list(alone.entries)[stopped_after:])
    assert text_of(result, tmp_path) == text_of(alone, tmp_path)


def test_what_was_answered_without_cvxpy_is_asked_again_with_it(chain, tmp_path, monkeypatch):
    pytest.importorskip('cvxpy')
    work, asked = tmp_path / 'work', []

    def answers():
        asked.clear()
        design(chain, [('ya',)], work_file=work, executor=Meddling(
            lambda k: asked.append(k)))
        return len(asked)
    with monkeypatch.context() as without:
        without.setitem(sys.modules, 'cvxpy', None)
        assert answers() == 1 and answers() == 0
    assert answers() == 1 and answers() == 0


def test_a_work_file_serves_more_fault_sets_and_a_line_that_was_cut_off_is_dropped(
        chain, tmp_path):
    work = tmp_path / 'work'
    design(chain, work_file=work)
    whole = work.read_bytes()
    work.write_bytes(whole[:-20])
    again = Meddling(lambda key: None)
    result = design(chain, up_to=2, executor=again, work_file=work)
    assert again.asked[0] == (('yc',), 'yc') and len(again.asked) == 7
    assert work.read_bytes().startswith(whole)
    assert text_of(result, tmp_path) == text_of(design(chain, up_to=2), tmp_path)


@pytest.fixture(scope='module')
def begun(chain, tmp_path_factory):
    """Return the bytes of a work file in which two fault sets stand."""
    work = tmp_path_factory.mktemp('begun') / 'work'
    design(chain, [('ya',), ('yb',)], work_file=work)
    return work.read_bytes()


def other_plant(chain):
    """Make one that differs in a number that the hash of a design file leaves out."""
    return Plant(**{**vars(chain), 'operating_point': chain.operating_point + 0.5})


@pytest.mark.parametrize(('change', 'line'), [
    (None, 'work file: is of another plant, or of an earlier state of this one; go on with'),
    ({}, 'work file: was begun with other options; go on with what it was begun with, or delete'),
    ((b'"vsensor_ros work"', b'"work"'), 'work file: is no work file of the designer'),
    ((b'"version": ', b'"version": 1'), 'work file: is of another version'),
    ((b'{"lost": null, "entry"', b'{"lost": null, "lost": null, "entry"'), 'lost: stands there'),
    ((b'"entry": {', b'"entry": {"more": 1, '), 'line 2: entry.more: is not a key'),
    ((b'"channel": "yb"', b'"channel": "yz"'), 'line 3: entry.channel: yz is not in its fault'),
    ((b'"N": [[-', b'"N": [['), 'line 3: entry.N: is unstable'),
    ((b'"order": 1', b'"order": NaN'), 'NaN: is not a finite number'),
    ((b'"order": 1', b'"order": 2'), 'entry.N: is not 2 x 2 numbers'),
    ((b'{"lost": null', b'{"lost": null,,'), 'line 2: is not JSON'),
    ((b'{"lost": null', b'\xff'), 'line 2: is not UTF-8'),
    ((b'{"lost": null', b'[1]\n{"lost": null'), 'line 2: is not an object'),
])
def test_a_work_file_that_does_not_fit_is_refused_in_one_line(chain, begun, tmp_path, change,
                                                              line):
    work, text = tmp_path / 'work', begun
    if change:
        assert change[0] in text
        text = text.replace(*change, 1)
    work.write_bytes(text)
    with pytest.raises(BadInput) as caught:
        design(other_plant(chain) if change is None else chain, work_file=work,
               prefer='least' if change == {} else 'quiet')
    assert str(caught.value).startswith(str(work)) and line in str(caught.value)
    assert '\n' not in str(caught.value) and work.read_bytes() == text


def test_a_work_file_that_cannot_be_written_is_said(chain, tmp_path):
    with pytest.raises(BadInput, match='no/work: work file: cannot be written .No such file'):
        design(chain, work_file=tmp_path / 'no' / 'work')
    with pytest.raises(BadInput, match='work file: is no regular file'):
        design(chain, work_file=tmp_path)


def test_plants_errors_and_designs_go_to_other_processes_and_back(chain, alone, processes):
    def there_and_back(what):
        return processes.submit(copy, what).result()
    chain.curves['yc'].linear(1.2)  # something is compiled, which is not sent along
    back = there_and_back(chain)
    assert back is not chain and back.hash() == chain.hash() and back.curves == chain.curves
    assert back.curves['yc'].linear(1.2) == chain.curves['yc'].linear(1.2)
    assert there_and_back(alone).plant_hash == alone.plant_hash
    error = BadInput('a file', 'key', 'is wrong', 'mend it')
    assert str(there_and_back(error)) == str(error)


def root(number, error=None):
    if error is not None:
        raise error
    return number ** 0.5


def test_tasks_of_any_kind_go_over_an_executor_in_order():
    told = []
    with Backwards() as executor:
        assert in_order(root, [(k * k,) for k in range(9)], executor,
                        lambda *one: told.append(one)) == list(range(9))
    assert told[0] == (0, 9, 'task 1') and told[-1] == (9, 9, 'done')
    assert in_order(root, [(4,), (9,)]) == [2.0, 3.0] and in_order(root, []) == []
    for executor in (None, ThreadPoolExecutor(1)):
        with pytest.raises(KeyError, match='mine'):
            in_order(root, [(4,), (9, KeyError('mine')), (16,)], executor)


def blas_threads(info):
    return {one['num_threads'] for one in info if one['user_api'] == 'blas'}


def test_each_process_keeps_to_one_thread_of_blas_and_leaves_the_environment(monkeypatch):
    monkeypatch.delenv('OPENBLAS_NUM_THREADS', raising=False)
    monkeypatch.setenv('OMP_NUM_THREADS', '7')
    with Processes(1) as executor:
        assert blas_threads(executor.submit(threadpool_info).result()) == {1}
        assert [executor.submit(os.getenv, name).result() for name in ONE_THREAD] == ['1'] * 3
    assert 'OPENBLAS_NUM_THREADS' not in os.environ and os.environ['OMP_NUM_THREADS'] == '7'


def test_left_by_an_exception_processes_end_at_once():
    pids = []
    with pytest.raises(KeyboardInterrupt), Processes(1) as executor:
        pids.append(executor.submit(os.getpid).result())
        endless = executor.submit(time.sleep, 3600)
        while not endless.running():
            time.sleep(0.01)
        raise KeyboardInterrupt
    assert isinstance(endless.exception(), BrokenExecutor)
    with pytest.raises(ProcessLookupError):
        os.kill(pids[0], 0)


@pytest.mark.slow
def test_a_script_that_starts_itself_again_is_told_so(tmp_path):
    script = tmp_path / 'script.py'
    script.write_text("""
from vsensor_ros.designer.processes import Processes
with Processes(1) as executor:
    executor.submit(int).result()
""")
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300,
                          env={**os.environ, 'PYTHONPATH': str(Path(__file__).parents[2])})
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1] == (
        'concurrent.futures.process.BrokenProcessPool: a process ended as it started; a script '
        "that uses them needs if __name__ == '__main__':")


def test_threads_are_calm_until_the_last_has_left():
    before = list(warnings.filters)
    inside, outside = Barrier(2), Barrier(2)

    def first():
        with calmly():
            inside.wait()
        outside.wait()

    def second():
        with calmly():
            inside.wait()
            outside.wait()  # the first has left
            with warnings.catch_warnings(record=True) as caught:
                warnings.warn('singular', LinAlgWarning, stacklevel=1)
            return len(caught), blas_threads(threadpool_info())
    with ThreadPoolExecutor(2) as threads:
        one, two = threads.submit(first), threads.submit(second)
        one.result()
        assert two.result() == (0, {1})
    assert warnings.filters == before


def test_the_refusals_are_there(alone):
    """What the tests above are about is in their plant."""
    kinds = {type(entry) for entry in alone.entries.values()}
    assert Refusal in kinds and len(kinds) == 2
    assert any('already when' in entry.reason for entry in alone.refusals)


def test_an_isolating_run_that_is_stopped_keeps_its_pairs(chain, tmp_path):
    work = tmp_path / 'plant.work'
    asked = {'fault_sets': [('yc',)], 'isolate': True}
    whole = design(chain, work_file=work, **asked)
    pairs = [s for s in whole.fault_sets if len(s) == 2]
    assert pairs
    kept = work.read_bytes()
    assert all(f'"fault_set": ["{a}", "{b}"]'.encode() in kept for a, b in pairs)

    def nobody(key):
        raise AssertionError(f'{key} was kept')
    again = design(chain, work_file=work, executor=Meddling(nobody), **asked)
    assert text_of(again, tmp_path) == text_of(whole, tmp_path)
    assert work.read_bytes() == kept
