"""
The kind fault_estimator: all that may fail of a Takagi-Sugeno plant in discrete time, at once.

xb+ = sum_i h_i(p) (N_i xb + K_i y0 + M_i u) + T2 y0+, vhat = Cv xb: states, faults of actuators a
step before, and for each sensor that may be faulty what a reading of 0 would be off. Nothing is
assumed of how faults change, so their readings tell nothing, and they are not read: equations
with them give the same xb. Their faults are reading less estimate.

While premises are in their ranges and each sample has come, the bound of e' P e falls towards 1.
"""

from vsensor_ros.observers.kinds import Kind
from vsensor_ros.observers.kinds.fault_estimator.batch import make_batch
from vsensor_ros.observers.kinds.fault_estimator.section import read_section, write_section
from vsensor_ros.observers.kinds.fault_estimator.sensor import FaultObserver

FAULT_ESTIMATOR = Kind('fault_estimator', write_section, read_section, make_batch)

__all__ = ['FAULT_ESTIMATOR', 'FaultObserver']
