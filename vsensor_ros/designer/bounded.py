"""
The least sensitive virtual sensor where none can be decoupled from all unknown inputs.

As many unknown inputs as can be are decoupled exactly; the others disturb the estimate, and how
much is stated: the peak over frequency of what they do to the error.
Source: method 2 (composition, SVD fallback) and 3.6; D section 3.2.
"""

from __future__ import annotations

from dataclasses import replace

from vsensor_ros.designer.composition import composed
from vsensor_ros.designer.disturbance import told
from vsensor_ros.designer.least_disturbed import ALIKE, least_disturbed, WORTH
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.relaxation import relax
from vsensor_ros.designer.sentences import say
from vsensor_ros.observers import VirtualSensor
from vsensor_ros.reason import Reason

LARGEST_HINTED = 60  # states of a plant for which a refusal names the alternative


def least_sensitive(problem: Problem, prefer: str, decay: float | None,
                    ) -> VirtualSensor | None:
    """
    Return the virtual sensor that unknown inputs disturb least; None where none is stable.

    For a problem that has no decoupled one. ``prefer``: 'quiet' takes the least order that is
    disturbed within WORTH of the least, 'least' the least order there is. Of a functional with
    several rows, every row that can be decoupled is decoupled (method 2, Composition).
    """
    relaxed = relax(problem)
    if relaxed is None:
        return None
    sensor = composed(problem, prefer, decay)
    if sensor is None:
        sensor = least_disturbed(relaxed, prefer, decay)
        if sensor is not None:
            sensor = replace(
                sensor, method=f'{sensor.method}; {told(problem, relaxed.kept, sensor)}')
    return sensor


def alternative(problem: Problem) -> str:
    """Say in one sentence what ``least_sensitive`` has to offer; '' if nothing, or if unknown."""
    if len(problem.A) > LARGEST_HINTED:
        return ''
    relaxed = relax(problem)
    if relaxed is None:
        return ''
    order, gain = relaxed.order, ALIKE * WORTH * relaxed.least
    if not relaxed.quick:  # whether its filter is fast enough to be taken is known when it is
        sensor = least_disturbed(relaxed, 'quiet', None)
        if sensor is None:
            return ''
        order, gain = sensor.order, sensor.disturbance_gain
    plant = problem.plant
    return say(Reason.of(
        'alternative', order=order, gain=gain, unit=plant.units.get(problem.channel, ''),
        names=tuple(plant.disturbances[i] for i in relaxed.kept), terms=bool(plant.terms)))
