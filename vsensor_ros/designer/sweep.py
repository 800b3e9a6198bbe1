"""
Go through many independent tasks with any executor: the same results in the same order.

An executor is a ``concurrent.futures.Executor``: ``Processes`` of this computer, Dask's
``Client.get_executor()``, mpi4py's ``MPIPoolExecutor``. None: here, one after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import closing
from dataclasses import fields, is_dataclass
from graphlib import TopologicalSorter
from heapq import heappop, heappush
from queue import SimpleQueue
from typing import Any

IN_FLIGHT = 500  # tasks that an executor holds at a time; each carries its data along

Progress = Callable[[int, int, str], None]


def in_order(function: Callable[..., Any], tasks: Iterable[Sequence[Any]],
             executor: Executor | None = None, progress: Progress | None = None) -> list[Any]:
    """
    Return ``[function(*task) for task in tasks]``, computed by the executor.

    Function, tasks and results must be picklable where it works in other processes. ``progress``
    is told what is done, of how many, and what is next. Raises the first error that comes; what
    has not begun is called off.
    """
    tasks = list(tasks)
    results: list[Any] = [None] * len(tasks)
    with closing(swept([()] * len(tasks), lambda i: begin(executor, function, *tasks[i]), executor,
                       progress, lambda i: f'task {i + 1}')) as begun:
        for i, future in begun:
            results[i] = future.result()
    return results


def swept(needs: Sequence[Sequence[int]], start: Callable[[int], Future[Any]],
          executor: Executor | None = None, progress: Progress | None = None,
          name: Callable[[int], str] = str) -> Generator[tuple[int, Future[Any]], None, None]:
    """
    Go through tasks by their number, and yield each with its future when it is done.

    ``needs``: for each task those before it that must be done, and yielded, before it starts.
    ``start`` starts one. ``progress`` is told, with the ``name`` of what is next. When the caller
    leaves early, what has not begun is called off.
    """
    sorter = TopologicalSorter(dict(enumerate(needs)))
    sorter.prepare()
    limit = 1 if executor is None else IN_FLIGHT
    ready: list[int] = []
    in_flight: dict[Future[Any], int] = {}
    ended: SimpleQueue[Future[Any]] = SimpleQueue()
    over: set[int] = set()
    following = 0
    try:
        while sorter.is_active():
            while following in over:
                following += 1
            if progress is not None:
                progress(len(over), len(needs), name(following))
            for i in sorter.get_ready():
                heappush(ready, i)
            while ready and len(in_flight) < limit:
                i = heappop(ready)
                future = start(i)
                in_flight[future] = i
                future.add_done_callback(ended.put)
            future = ended.get()
            i = in_flight.pop(future)
            yield i, future
            over.add(i)
            sorter.done(i)
    finally:
        for future in in_flight:
            future.cancel()
    if progress is not None:
        progress(len(needs), len(needs), 'done')


def begin(executor: Executor | None, function: Callable[..., Any], *given: Any) -> Future[Any]:
    """Start a task; its future holds its error, too, where the executor is beyond use."""
    try:
        if executor is not None:
            return executor.submit(function, *given)
        return ended_with(function(*given))
    except BrokenExecutor as error:
        return _failed(error)
    except Exception as error:
        if executor is not None:
            raise
        return _failed(error)


def ended_with(result: Any) -> Future[Any]:
    """Return a future of what is known already."""
    future: Future[Any] = Future()
    future.set_result(result)
    return future


def _failed(error: Exception) -> Future[Any]:
    future: Future[Any] = Future()
    future.set_exception(error)
    return future


def as_made(value: Any) -> Any:
    """
    Make what came from another process anew, data classes and all in them.

    It did not come through their making, after which nobody writes to their arrays.
    """
    if is_dataclass(value) and not isinstance(value, type):
        return type(value)(**{field.name: as_made(getattr(value, field.name))
                              for field in fields(value)})
    if type(value) is tuple:
        return tuple(as_made(item) for item in value)
    return value
