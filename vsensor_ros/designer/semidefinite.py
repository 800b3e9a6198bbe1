"""
Semidefinite programs, by cvxpy with Clarabel: desk dependencies, imported where they are used.

A solver's word counts for nothing: what it returns has to be checked by eigenvalues.
"""

from __future__ import annotations

from importlib.util import find_spec
from types import ModuleType
from typing import Any
import warnings

import numpy as np

MISSING = 'cvxpy is not installed: pip install cvxpy clarabel'


def is_there() -> bool:
    """Tell whether cvxpy is installed, without loading it."""
    return find_spec('cvxpy') is not None


def solver() -> ModuleType:
    """Return cvxpy. Raises ImportError, with what to install, without it or without Clarabel."""
    try:
        import cvxpy  # large, and needed here only
    except ImportError:
        raise ImportError(MISSING) from None
    if 'CLARABEL' not in cvxpy.installed_solvers():
        raise ImportError(MISSING)
    return cvxpy


def answered(problem: Any, wanted: Any) -> bool:
    """Solve the problem; return whether the wanted variable has finite numbers, right or not."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of inaccuracy: what comes is checked
            problem.solve(solver='CLARABEL')
    except (solver().error.SolverError, ArithmeticError, ValueError):
        return False
    return wanted.value is not None and bool(np.isfinite(wanted.value).all())
