"""Whom the replacer's own isolator must blame, and whom it did; pure, no ROS."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.lab.injection.truth import Truth
from vsensor_ros.lab.injection.verdict import Evidence, Said
from vsensor_ros.observers import Isolability, NONE

HEALTHY, SUSPECTED, ISOLATED, MODEL = 'healthy', 'suspected', 'isolated', 'model'
# what readings alone show, by kind of fault; and what only residuals do
BY_READINGS = {'freeze': 'stuck', 'drop_out': 'drop-out', 'not_a_number': 'drop-out',
               'infinity': 'drop-out', 'noise': 'noise'}
BY_RESIDUALS = {'bias': 'bias', 'drift': 'drift'}


@dataclass
class Injected:
    """A fault that was injected; times in s, monotonic."""

    sensor: str
    fault: str
    kind: str   # what the isolator has to call it; '': it must blame nobody
    began: float
    healed: float = math.inf
    over: float = math.inf  # when it was believed again
    awaited: bool = False   # it has to be blamed before it heals


@dataclass(frozen=True)
class Found:
    """What became of an injected fault; None: nothing did."""

    sensor: str
    fault: str
    kind: str | None        # what the isolator called it
    blamed_s: float | None  # from the fault to the verdict
    replaced_s: float | None    # from the fault to the virtual sensor
    error: float | None     # worst of what went out for it then, a part of the range
    rms: float | None       # the same, root mean square

    def __str__(self) -> str:
        if self.kind is None:
            return f'{self.sensor} nobody blamed'
        if self.replaced_s is None:
            return f'{self.sensor} {self.kind}, found in {self.blamed_s:.2f} s'
        return f'{self.sensor} {self.kind}, replaced in {self.replaced_s:.2f} s' + (
            '' if self.error is None else f', {100.0 * self.error:.2g} % off')


def expected(found: Isolability, sensors: Sequence[str], faults: Mapping[str, str],
             ) -> tuple[str, frozenset[str]] | None:
    """
    Return the state that faults of a kind by sensor, all new, lead to, and who must be blamed.

    It follows from what the design says that its residuals tell; None: it says nothing of these
    together.
    """
    shown = frozenset(s for s, fault in faults.items() if fault in BY_READINGS)
    felt = frozenset(s for s, fault in faults.items() if fault in BY_RESIDUALS
                     and found.by_residuals(s) != NONE)
    if not felt:
        return (ISOLATED if shown else HEALTHY), shown
    others = {s: [o for o in sensors if o != s] for s in felt}
    if len(felt) > 1 and not shown and all(felt & set(r.support) for r in found.residuals):
        return MODEL, frozenset()
    if all(found.by_residuals(s, others[s]) != NONE for s in felt):
        return ISOLATED, felt | shown
    if len(felt) > 1 or shown:
        return None
    [sensor] = felt
    if all(found.by_residuals(sensor, [o]) != NONE for o in others[sensor]):
        return ISOLATED, felt
    return SUSPECTED, frozenset()


def judge_blame(said: Sequence[Said], injected: Sequence[Injected], begun: float) -> list[str]:
    """Return what was wrong with whom the isolator blamed; begun: of the case [s], monotonic."""
    wrong = []
    strange: dict[str, tuple[float, str]] = {}
    for each in said:
        for sensor, kind in each.kinds.items():
            if not any(i.sensor == sensor and i.kind and i.began <= each.arrival <= i.over
                       for i in injected):
                strange.setdefault(sensor, (each.arrival - begun, kind))
    wrong += [f'{sensor} was blamed ({kind}), {at:.2f} s from the begin, and must not be'
              for sensor, (at, kind) in strange.items()]
    for fault in injected:
        last = _last_kind(said, fault)
        if fault.awaited and last is not None and last != fault.kind:
            wrong.append(f'{fault.sensor}: {fault.fault} was called {last}, not {fault.kind}')
    return wrong


def found_of(fault: Injected, heard: Evidence, truth: Truth) -> Found:
    """Return what became of a fault."""
    name = fault.sensor
    blamed = next((s.arrival for s in _while(heard.said, fault) if name in s.kinds), None)
    replaced = next((s.arrival for s in heard.told if fault.began <= s.arrival <= fault.healed
                     and s.facts.get(name, {}).get('source') == 'virtual'), None)
    # another fault that nobody knows of yet is in the estimate, too
    blind = [] if replaced is None else [
        span for span in heard.blind.get(name, ()) if span[0] > replaced]
    errors = [] if replaced is None else [
        value - float(truth.at(name, out.time)) for out in heard.outs
        if replaced <= min(out.said, out.arrival) and out.arrival <= fault.healed
        and not any(begin <= out.arrival <= end for begin, end in blind)
        and isinstance(value := out.values.get(name), float) and math.isfinite(value)]
    part = np.abs(errors) / truth.span[name]
    return Found(name, fault.fault, _last_kind(heard.said, fault), _since(fault, blamed),
                 _since(fault, replaced), float(part.max()) if errors else None,
                 float(np.sqrt(np.mean(part**2))) if errors else None)


def _since(fault: Injected, time: float | None) -> float | None:
    return None if time is None else time - fault.began


def _while(said: Sequence[Said], fault: Injected) -> list[Said]:
    return [s for s in said if fault.began <= s.arrival <= fault.over]


def _last_kind(said: Sequence[Said], fault: Injected) -> str | None:
    """Return what a fault was called before it healed, at last; None: it was not blamed."""
    kinds = [s.kinds[fault.sensor] for s in _while(said, fault)
             if fault.sensor in s.kinds and s.arrival <= fault.healed]
    return kinds[-1] if kinds else None
