"""
How long the algebra of functions searches: the study's systems, and tanks in a row.

Chains of 2 to 8 tanks (gamma* among products of degree 3), and cascades of as many heated tanks,
found, reduced and confirmed from end to end. Processor time on one core, the least of three.

    python -m benchmark.functions [MOST]
"""

from __future__ import annotations

from collections.abc import Callable
import importlib.util
from pathlib import Path
import sys
import time
from typing import Any

import numpy as np

from vsensor_ros.designer.algebra import find, System
from vsensor_ros.designer.algebra.dictionary import Atom, build
from vsensor_ros.designer.algebra.invariant import largest
from vsensor_ros.designer.algebra.model import read
from vsensor_ros.functions.expression import Name

SYSTEMS = Path(__file__).parents[1] / 'test/designer/algebra/systems.py'
RUNS = 3
LARGEST = 8
DEGREE = 3


def chain(n: int) -> System:
    """Return n tanks in a row; the inflow is unknown, the first level is lost."""
    x = [f'x{i}' for i in range(1, n + 1)]
    flow = ['rho', *(f'0.4*sqrt({a} - {b})' for a, b in zip(x, x[1:])), f'0.4*sqrt({x[-1]})']
    return System(dict.fromkeys(x, (0.5, 9.0)),
                  {name: f'{flow[i]} - {flow[i + 1]}' for i, name in enumerate(x)},
                  {f'level{i}': name for i, name in enumerate(x[1:], 2)}, {'level1': 'x1'}, {},
                  {'rho': (0.0, 2.0)})


def heated(n: int) -> System:
    """Return n heated tanks in a row; the inflow is unknown, the last thermometer is lost."""
    V, T = ([f'{letter}{i}' for i in range(1, n + 1)] for letter in 'VT')
    flow = ['rho', *(f'0.5*sqrt({v})' for v in V)]
    f = {v: f'{flow[i]} - {flow[i + 1]}' for i, v in enumerate(V)}
    f['T1'] = '(rho*(15 - T1) + P)/V1'
    f.update({T[i]: f'{flow[i]}*({T[i - 1]} - {T[i]})/{V[i]}' for i in range(1, n)})
    return System({**dict.fromkeys(V, (0.5, 3.0)), **dict.fromkeys(T, (20.0, 60.0))}, f,
                  {f'level{i}': v for i, v in enumerate(V, 1)}, {'last': T[-1]},
                  {'P': (0.0, 10.0)}, {'rho': (0.0, 2.0)})


def taken(work: Callable[[], Any]) -> tuple[float, Any]:
    """Return the least processor time [s] of some runs, and what came of the last."""
    least, result = float('inf'), None
    for _ in range(RUNS):
        start = time.process_time()
        result = work()
        least = min(least, time.process_time() - start)
    return least, result


def systems() -> dict[str, System]:
    """Return the study's systems, as the tests have them."""
    spec = importlib.util.spec_from_file_location('systems', SYSTEMS)
    assert spec is not None and spec.loader is not None
    module = sys.modules['systems'] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return {name: case.system for name, case in module.CASES.items()}


def main(most: int = LARGEST) -> None:
    """Print a line for each system, and for each number of tanks."""
    for name, system in systems().items():
        took, answer = taken(lambda system=system: find(system))  # type: ignore[misc]
        print(f'{name:26s}  {took:5.2f} s  {answer.observer.grade}', flush=True)
    print('tanks  chain: products  gamma*      time  heated cascade: order      time')
    for n in range(2, most + 1):
        model = read(chain(n))
        start = time.process_time()
        dictionary = build(model.states, [[Atom(Name(name))] for name in model.states], DEGREE)
        assert dictionary is not None
        gamma = largest(model, dictionary)
        searched = time.process_time() - start
        assert np.isfinite(gamma).all()
        start = time.process_time()
        answer = find(heated(n))
        took = time.process_time() - start
        said = f'order {len(answer.observer.names)}' if answer.observer else answer.verdict.value
        print(f'{n:5d}  {len(dictionary):15d}  {gamma.shape[1]:6d}  {searched:6.2f} s  '
              f'{said:>21s}  {took:6.2f} s', flush=True)


if __name__ == '__main__':
    main(*map(int, sys.argv[1:]))
