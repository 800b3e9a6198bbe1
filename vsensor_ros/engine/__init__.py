"""The engine: decides who serves each channel and what goes out; knows no ROS."""

from vsensor_ros.engine.bumpless import Bumpless
from vsensor_ros.engine.switch import Decision, Policy, Source, Switch

__all__ = ['Bumpless', 'Decision', 'Policy', 'Source', 'Switch']
