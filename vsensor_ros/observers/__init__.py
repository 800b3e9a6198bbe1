"""
The bridge between desk and machine: kinds of virtual sensors, and the file that holds them.

A new kind is a file in ``kinds/`` and a line here, so that it is known wherever designs are.
"""

from vsensor_ros.observers.design import Design
from vsensor_ros.observers.entry import Entry, FAULT, Key, Refusal
from vsensor_ros.observers.fault_size import FaultSize, FaultSizes, Injection
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
from vsensor_ros.observers.kinds.fault_estimator import FAULT_ESTIMATOR, FaultObserver
from vsensor_ros.observers.kinds.functional import FUNCTIONAL, VirtualSensor
from vsensor_ros.observers.kinds.functional.convergence import settling_time
from vsensor_ros.observers.kinds.functional.tracking import (
    deviation_after,
    horizon,
    Tracking,
)
from vsensor_ros.observers.kinds.nonlinear import Condition, NONLINEAR, NonlinearSensor
from vsensor_ros.observers.kinds.takagi_sugeno import ScheduledSensor, TAKAGI_SUGENO
from vsensor_ros.observers.knowledge import Certificate, Limit, Noise, OrderStep, Proof, Rung

register(FUNCTIONAL)
register(EXTENDED)
register(TAKAGI_SUGENO)
register(NONLINEAR)
register(FAULT_ESTIMATOR)

__all__ = ['FAULT', 'NONE', 'STRENGTHS', 'STRONG', 'WEAK', 'Batch', 'Bent', 'Certificate',
           'Condition', 'Design', 'Distinction', 'Entry', 'ExtendedSensor', 'FaultObserver',
           'FaultSize', 'FaultSizes', 'Injection', 'Isolability', 'Key', 'Kind', 'Limit', 'Model',
           'Noise', 'NonlinearSensor', 'OrderStep', 'Proof', 'Refusal', 'Residual', 'Rung',
           'ScheduledSensor', 'StepOfSome', 'Told', 'Tracked', 'Tracking', 'Tried',
           'VirtualSensor', 'deviation_after', 'horizon', 'kind_named', 'kind_names', 'register',
           'settling_time']
