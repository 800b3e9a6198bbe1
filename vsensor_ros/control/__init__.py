"""The loop: what becomes of a controller when virtual sensors speak for those that it reads."""

from vsensor_ros.control.closed_loop import Case, check_loop, closed_loop, ClosedLoop
from vsensor_ros.control.controller import Controller
from vsensor_ros.control.controller_file import load_controller

__all__ = ['Case', 'ClosedLoop', 'Controller', 'check_loop', 'closed_loop', 'load_controller']
