"""
What an engineer may do to the replacer while it runs: reset, force, release, clear.

Two services a sensor are cheap enough: fifty sensors take 0.03 s and 10 MB at the start, and
0.6 ms each time the executor wakes, which without simulated time is about once a second.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.service import Service
from std_srvs.srv import SetBool, Trigger

from vsensor_ros.engine import CannotServe
from vsensor_ros.node.replacer import Replacer
from vsensor_ros.node.reserve import mends

# one for all: rclpy holds each line of code that throttles to the clock it had first
STEADY = Clock(clock_type=ClockType.STEADY_TIME)


def offer(node: Node, replacer: Replacer, is_active: Callable[[], bool]) -> tuple[Service, ...]:
    """
    Open the services of a replacer; whoever asks while it is not active is told so.

    ``~/reset`` (Trigger), ``~/<sensor>/force`` (SetBool: true for virtual, false to release),
    ``~/<sensor>/clear`` (Trigger). The names in a design are legal in ROS.
    """
    def answer(response: Any, act: Callable[[], None], done: Callable[[], str]) -> Any:
        """Do it between two polls; what cannot be done is said in the response."""
        try:
            if not is_active():
                raise ValueError('the replacer is not active; activate it first')
            with replacer.lock:
                act()
                response.success, response.message = True, done()
        except CannotServe as error:
            mend = [] if error.reason is None else mends(error.channel, error.reason, {})
            response.success, response.message = False, '; '.join([str(error), *mend])
        except ValueError as error:
            response.success, response.message = False, str(error)
        node.get_logger().info(f'asked by service: {response.message}',
                               throttle_duration_sec=0.1, throttle_time_source_type=STEADY)
        return response

    def state(name: str) -> str:
        """Say who serves a channel now."""
        channel = next(c for c in replacer.snapshot().channels if c.name == name)
        return f'{name} is {channel.source}' + (f': {channel.reason}' if channel.reason else '')

    def force(name: str) -> Callable[[Any, Any], Any]:
        return lambda request, response: answer(
            response,
            (lambda: replacer.force(name)) if request.data else (lambda: replacer.release(name)),
            lambda: state(name))

    def clear(name: str) -> Callable[[Any, Any], Any]:
        return lambda request, response: answer(
            response, lambda: replacer.clear(name), lambda: state(name))

    def reset(request: Any, response: Any) -> Any:
        return answer(response, replacer.reset, lambda: '; '.join(
            state(c.name) for c in replacer.snapshot().channels if c.source != 'real')
            or 'all are real')

    services = [node.create_service(Trigger, '~/reset', reset)]
    for sensor in replacer.settings.design.sensors:
        services.append(node.create_service(SetBool, f'~/{sensor}/force', force(sensor)))
        services.append(node.create_service(Trigger, f'~/{sensor}/clear', clear(sensor)))
    return tuple(services)
