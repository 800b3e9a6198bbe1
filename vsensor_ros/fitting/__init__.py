"""A plant fitted to recordings at the desk: its parameters, its noise, and how far it is good."""

from vsensor_ros.fitting.fit import Fit, fit

__all__ = ['Fit', 'fit']
