"""Processes of this computer as an executor, of which one that dies takes no other task along."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, ExitStack
from multiprocessing import active_children, get_context, parent_process, resource_tracker
import os
import signal
from threading import local, Lock, Thread
from typing import Any

from vsensor_ros.designer.calm import calmly

# BLAS reads them when numpy is loaded
ONE_THREAD = dict.fromkeys(('OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'OMP_NUM_THREADS'), '1')


class Processes(Executor):
    """
    So many processes, BLAS kept to one thread in each.

    Each is a pool of its own: when a process dies (killed, out of memory), just its task fails,
    with BrokenProcessPool, and another takes its place. Ctrl-C reaches none of them; ``with``,
    left by an exception, ends them. A script that uses it needs ``if __name__ == '__main__':``.
    """

    def __init__(self, count: int) -> None:
        resource_tracker.ensure_running()  # started later, it would let Ctrl-C through
        self._threads = ThreadPoolExecutor(count, initializer=_hear_no_interrupt)
        self._of_thread = local()  # .pool
        self._pools: list[ProcessPoolExecutor] = []
        self._pids: set[int] = set()
        self._lock = Lock()
        self._stopped = False

    def submit(self, function: Callable[..., Any], /, *given: Any, **named: Any) -> Future[Any]:
        """Let a process do it when one is free."""
        return self._threads.submit(self._do, function, given, named)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no more, and end when all is done."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait)

    def __exit__(self, kind: type[BaseException] | None, *rest: object) -> None:
        if kind is not None:
            with self._lock:
                self._stopped = True
                self._terminate()
        self.shutdown(cancel_futures=kind is not None)

    def _do(self, function: Callable[..., Any], given: tuple[Any, ...],
            named: dict[str, Any]) -> Any:
        pool = getattr(self._of_thread, 'pool', None) or self._started()
        try:
            return pool.submit(function, *given, **named).result()
        except BrokenProcessPool:
            self._of_thread.pool = None
            raise

    def _started(self) -> ProcessPoolExecutor:
        if self._stopped:
            raise BrokenProcessPool('no process is started any more')
        pool = ProcessPoolExecutor(1, get_context('spawn'), initializer=_prepare)
        with self._lock, _environment(ONE_THREAD):
            self._pools.append(pool)
            first = pool.submit(os.getpid)  # when this returns the process has its environment
        try:
            pid = first.result()
        except BrokenProcessPool:
            if not self._pids:  # the next would do the same
                self._stopped = True
                raise BrokenProcessPool('a process ended as it started; a script that uses them '
                                        "needs if __name__ == '__main__':") from None
            raise
        with self._lock:
            self._pids.add(pid)
            if self._stopped:
                self._terminate()
        self._of_thread.pool = pool
        return pool

    def _terminate(self) -> None:
        for process in active_children():
            if process.pid in self._pids:
                process.terminate()


def _hear_no_interrupt() -> None:
    """Block Ctrl-C in this thread, and so in all processes that it starts."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


_for_good = ExitStack()


def _prepare() -> None:
    """Prepare a process for its tasks: it is calm all along, and ends when its parent is gone."""
    _for_good.enter_context(calmly())  # entered for each task, it would cost milliseconds
    Thread(target=_end_with_the_parent, daemon=True).start()


def _end_with_the_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
