"""
The bridge between desk and machine: kinds of virtual sensors, and the file that holds them.

A new kind is a file in ``kinds/`` and a line here, so that it is known wherever designs are.
"""

from vsensor_ros.observers.design import Design
from vsensor_ros.observers.entry import Entry, Key, Refusal
from vsensor_ros.observers.isolability import (
    Distinction,
    Isolability,
    NONE,
    Residual,
    STRENGTHS,
    STRONG,
    WEAK,
)
from vsensor_ros.observers.kinds import (
    Batch,
    Bent,
    Kind,
    kind_named,
    kind_names,
    register,
    StepOfSome,
    Told,
    Tracked,
)
from vsensor_ros.observers.kinds.extended import EXTENDED, ExtendedSensor, Model, Tried
from vsensor_ros.observers.kinds.functional import FUNCTIONAL, VirtualSensor
from vsensor_ros.observers.kinds.functional.convergence import settling_time
from vsensor_ros.observers.kinds.functional.tracking import (
    deviation_after,
    horizon,
    Tracking,
)
from vsensor_ros.observers.kinds.takagi_sugeno import ScheduledSensor, TAKAGI_SUGENO
from vsensor_ros.observers.knowledge import Certificate, Limit, Noise, OrderStep, Proof, Rung

register(FUNCTIONAL)
register(EXTENDED)
register(TAKAGI_SUGENO)

__all__ = ['NONE', 'STRENGTHS', 'STRONG', 'WEAK', 'Batch', 'Bent', 'Certificate', 'Design',
           'Distinction', 'Entry', 'ExtendedSensor', 'Isolability', 'Key', 'Kind', 'Limit',
           'Model', 'Noise', 'OrderStep', 'Proof', 'Refusal', 'Residual', 'Rung',
           'ScheduledSensor', 'StepOfSome', 'Told', 'Tracked', 'Tracking', 'Tried',
           'VirtualSensor', 'deviation_after', 'horizon', 'kind_named', 'kind_names', 'register',
           'settling_time']
