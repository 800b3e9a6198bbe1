"""
The kind nonlinear: z = phi(x), a function of the states that unknown inputs do not reach.

z' = F(z, y, u), or z+ = F(z, y, u); vhat = g(z, y, u). All are expressions of the safe language.
The covariance of the error goes along, by their slopes. While the channel is believed its readings
correct z (*tracks*: what is 0 in truth); of one of which no convergence is known so does what
healthy sensors say of z (*residuals*), then and after. Where a condition fails nothing is said.

Letters: k states of z, m inputs, L sensors, R runs.
"""

from vsensor_ros.observers.kinds import Kind
from vsensor_ros.observers.kinds.nonlinear.batch import make_batch
from vsensor_ros.observers.kinds.nonlinear.section import read_section, write_section
from vsensor_ros.observers.kinds.nonlinear.sensor import Condition, NonlinearSensor

NONLINEAR = Kind('nonlinear', write_section, read_section, make_batch)

__all__ = ['NONLINEAR', 'Condition', 'NonlinearSensor']
