"""The kind functional: an observer of linear functionals of the state (the method, E1 to E4)."""

from vsensor_ros.observers.kinds import Kind
from vsensor_ros.observers.kinds.functional.argument_name import argument_name, sum_place, together
from vsensor_ros.observers.kinds.functional.batch import make_batch
from vsensor_ros.observers.kinds.functional.section import read_section, write_section
from vsensor_ros.observers.kinds.functional.virtual_sensor import decay_of, VirtualSensor

__all__ = ['FUNCTIONAL', 'VirtualSensor', 'argument_name', 'decay_of', 'sum_place',
           'together']

FUNCTIONAL = Kind('functional', write_section, read_section, make_batch)
