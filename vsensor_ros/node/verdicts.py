"""
What the isolator says, on ``~/isolation``: one status a sensor, and one for the isolator.

It is in the shape that the isolation topic of a replacer takes, and diagnostic_aggregator: ERROR
is faulty, OK healthy, WARN suspected, which changes nothing. The `hardware_id` is the sensor.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from diagnostic_msgs.msg import DiagnosticStatus

from vsensor_ros.isolator import HEALTHY, ISOLATED, MODEL, Verdict
from vsensor_ros.node.diagnostics import number, Report
from vsensor_ros.reason import Reason

NAME = 'isolator'  # what the names of its statuses begin with, after that of the node


def statuses(verdict: Verdict, sensors: Sequence[str], node: str, mode: str,
             ) -> Iterator[tuple[str, Report, Mapping[str, object]]]:
    """Yield name, report and facts of each status; node: its full name, without a / in front."""
    prefix = f'{node}: {NAME}'
    faults = {fault.sensor: fault for fault in verdict.faults}
    suspected = {name for names in verdict.candidates for name in names}
    for sensor in sensors:
        facts: dict[str, object] = {}
        level, message = DiagnosticStatus.OK, HEALTHY
        if sensor in faults:
            fault = faults[sensor]
            level, message = DiagnosticStatus.ERROR, str(fault.reason(verdict.time))
            facts = {'kind': fault.kind, 'onset': number(fault.onset * 1e-9),
                     'found': number(fault.found * 1e-9), 'unit': fault.unit,
                     'size': 'nan' if fault.size is None else number(fault.size)}
        elif sensor in suspected:
            level = DiagnosticStatus.WARN
            message = str(next(why for why in verdict.reasons if why.code == 'fault ambiguous'))
        yield f'{prefix}: {sensor}', Report(sensor, level, message, sensor, ''), facts
    told = _told(verdict)
    level = DiagnosticStatus.WARN if verdict.state not in (HEALTHY, ISOLATED) \
        else DiagnosticStatus.OK
    left = next((dict(why.facts)['seconds'] for why in verdict.notes
                 if why.code == 'fault learning'), 0.0)
    yield prefix, Report(NAME, level, '; '.join(map(str, told)) or verdict.state, '', ''), {
        'state': verdict.state, 'mode': mode, 'learning_s': number(left),
        'faulty': ' '.join(verdict.faulty),
        'candidates': ' | '.join(' '.join(names) for names in verdict.candidates)}


def _told(verdict: Verdict) -> list[Reason]:
    """Return what is said of no sensor in particular."""
    return [why for why in verdict.reasons if why.code == 'fault ambiguous'] \
        if verdict.state != MODEL and verdict.candidates else list(verdict.notes)
