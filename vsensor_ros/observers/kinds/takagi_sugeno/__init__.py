"""
The kind takagi_sugeno: injection scheduled by premises, of which a form bounds the error.

z' = sum_i h_i(p) (N_i z + J_i y0 + B_i u + a_i), vhat = Cv z + Q y0. While premises are in their
ranges the bound of e' S e falls towards 1. Where they are not nothing is proved: the run waits at
its start, with the bound that holds there, and such steps are counted.
"""

from vsensor_ros.observers.kinds import Kind
from vsensor_ros.observers.kinds.takagi_sugeno.batch import make_batch
from vsensor_ros.observers.kinds.takagi_sugeno.section import read_section, write_section
from vsensor_ros.observers.kinds.takagi_sugeno.sensor import ScheduledSensor

TAKAGI_SUGENO = Kind('takagi_sugeno', write_section, read_section, make_batch)

__all__ = ['TAKAGI_SUGENO', 'ScheduledSensor']
