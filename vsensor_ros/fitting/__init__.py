"""A plant fitted to recordings at the desk: delays, parameters, noise, and how far it is good."""

from vsensor_ros.fitting.align import align, Aligned
from vsensor_ros.fitting.fit import Fit, fit

__all__ = ['Aligned', 'Fit', 'align', 'fit']
