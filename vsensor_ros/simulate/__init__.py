"""Truth: plants that run, sensors that fail, recordings that replay. Pure: no ROS here."""

from vsensor_ros.simulate.fault import FAULTS, Recorded
from vsensor_ros.simulate.simulate import simulate

__all__ = ['FAULTS', 'Recorded', 'simulate']
