"""Who failed: residuals of virtual sensors, judged by what the healthy machine has shown."""

from vsensor_ros.isolator.isolator import Isolator
from vsensor_ros.isolator.record import load, save
from vsensor_ros.isolator.settings import Settings
from vsensor_ros.isolator.verdict import Fault, HEALTHY, ISOLATED, MODEL, Verdict

__all__ = ['HEALTHY', 'ISOLATED', 'MODEL', 'Fault', 'Isolator', 'Settings', 'Verdict', 'load',
           'save']
