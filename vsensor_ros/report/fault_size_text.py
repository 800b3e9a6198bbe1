"""What a design says of how large faults are, in words: for the terminal and the page."""

from __future__ import annotations

from collections.abc import Mapping

from vsensor_ros.observers import FaultSize, FaultSizes
from vsensor_ros.observers.fault_size import METHODS, SLIDING, TWISTING, VIRTUAL, WALK
from vsensor_ros.report import design_text

HEAD = 'How large a fault is'
WORDS = {VIRTUAL: 'its reading less its virtual sensor', WALK: 'a Kalman filter in which it walks '
         'at random', SLIDING: 'a sliding mode of the first order',
         TWISTING: 'a super-twisting sliding mode'}


def rows(sizes: FaultSizes, units: Mapping[str, str]) -> list[tuple[str, str, list[str]]]:
    """Return for each sensor and command its name, what is taken, and what else there is."""
    said = [(size.name, _taken(size, units.get(size.name, '')),
             _others(size, units.get(size.name, ''))) for size in sizes.found]
    return [*said, *((name, f'not told: {why}', []) for name, why in sizes.refused.items())]


def _taken(size: FaultSize, unit: str) -> str:
    assumed = '; assumed noise' if size.assumed else ''
    by = f', and {size.disturbed:.3g} times the unknown inputs' if size.disturbed else ''
    return (f'{WORDS[size.method]}, to {design_text.number(size.noise, unit)} by the noise of the '
            f'readings, {design_text.number(size.deviation, unit)} with that of the process'
            f'{by}; 63 % of a step in {design_text.number(size.response, "s")}{assumed}')


def _others(size: FaultSize, unit: str) -> list[str]:
    found = [f'{method}: {design_text.number(size.others[method], unit)}'
             for method in METHODS if method in size.others]
    # both sliding modes mostly lack the same
    lacks: dict[str, list[str]] = {}
    for method in METHODS:
        if method in size.why_not:
            lacks.setdefault(size.why_not[method], []).append(method)
    return [*found, *(f'no {" and no ".join(methods)}: {why}' for why, methods in lacks.items())]
