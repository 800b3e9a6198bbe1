"""Keep BLAS to one thread, and numbers beyond use from warning, while something is designed."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, ExitStack
from threading import Lock
import warnings

import numpy as np
from scipy.linalg import LinAlgWarning

_lock = Lock()
_of_the_process = ExitStack()  # what holds for all threads, from the first that enters to the last
_inside = 0


@contextmanager
def calmly() -> Iterator[None]:
    """
    Keep BLAS to one thread, and numbers beyond use from warning; in several threads, too.

    On many small matrices two threads are three times slower than one (without threadpoolctl the
    environment can say so: OPENBLAS_NUM_THREADS=1). Candidates beyond use are told by the check
    of their equations.
    """
    global _inside
    with _lock:
        if not _inside:
            _calm_the_process()
        _inside += 1
    try:
        with np.errstate(all='ignore'):  # of this thread alone
            yield
    finally:
        with _lock:
            _inside -= 1
            if not _inside:
                _of_the_process.close()


def _calm_the_process() -> None:
    try:
        from threadpoolctl import threadpool_limits
        _of_the_process.enter_context(threadpool_limits(1, user_api='blas'))
    except ImportError:
        pass  # the environment may say it
    _of_the_process.enter_context(warnings.catch_warnings())
    warnings.simplefilter('ignore', LinAlgWarning)
    warnings.simplefilter('ignore', RuntimeWarning)
