"""
The kind extended: a Kalman filter on the plant's equations, linearised at its estimate.

One filter of all states reads the healthy sensors of its fault set; while the failed ones are
believed they correct it, too. Parameters that are not known exactly are *considered* (Schmidt):
they are not estimated, but what they may do is in the covariance. Nothing is proved of it. What
healthy sensors say beside what it expects, in the mean over a while, widens its deviation, and
withdraws it for good when it is beyond all chance.

Letters: n states, m inputs, d unknown inputs, p parameters, L sensors, R runs of k numbers each.
"""

from vsensor_ros.observers.kinds import Kind
from vsensor_ros.observers.kinds.extended.batch import make_batch
from vsensor_ros.observers.kinds.extended.section import read_section, write_section
from vsensor_ros.observers.kinds.extended.sensor import ExtendedSensor, Model, Tried

EXTENDED = Kind('extended', write_section, read_section, make_batch,
                lambda entry: entry.model.angle)

__all__ = ['EXTENDED', 'ExtendedSensor', 'Model', 'Tried']
