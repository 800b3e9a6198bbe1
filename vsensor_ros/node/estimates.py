"""
What the virtual sensors say, on ``~/estimates``, while somebody listens.

Of a failed channel value, deviation and offset of each estimate that went out; of a healthy one
its reading, and beside it what would have gone out. And what is wanted besides sensors, and how
large each fault is.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from vsensor_ros.engine import Engine, Functional, Reserve, SizeNow, Substitute
from vsensor_ros.node.qos import ESTIMATES, qos_options


class Estimates:
    """One message for each time at which something is said."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(
            DiagnosticArray, ESTIMATES,
            QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT),
            qos_overriding_options=qos_options())
        self._sized = 0  # time [ns] of the sizes of faults that were published last

    def listeners(self) -> int:
        """Return how many listen; nothing is worth computing for none."""
        return int(self._publisher.get_subscription_count())

    def send(self, at: int, estimates: Sequence[tuple[str, Substitute]]) -> None:
        """Publish what went out for these channels, stamped with the time of the state [ns]."""
        if estimates and self.listeners():
            self._publish(at, [_status(name, said) for name, said in estimates])

    def send_reserves(self, at: int, reserves: Sequence[Reserve]) -> None:
        """Publish what would have gone out for these channels, beside their readings."""
        if reserves:
            self._publish(at, [_reserve(said) for said in reserves])

    def send_functionals(self, at: int, functionals: Sequence[Functional]) -> None:
        """Publish what is wanted besides sensors: functionals of the states, and faults."""
        if functionals:
            self._publish(at, [_functional(said) for said in functionals])

    def show_sizes(self, engine: Engine) -> None:
        """Publish how large the faults of sensors and commands are, once for each time."""
        if self.listeners():
            at, sizes = engine.fault_sizes()
            if sizes and at != self._sized:
                self._sized = at
                self._publish(at, [_size(said) for said in sizes])

    def _publish(self, at: int, status: list[DiagnosticStatus]) -> None:
        message = DiagnosticArray(status=status)
        message.header.stamp = Time(sec=at // 10**9, nanosec=at % 10**9)
        self._publisher.publish(message)

    def close(self, node: Node) -> None:
        """Close the topic."""
        node.destroy_publisher(self._publisher)


def _status(name: str, said: Substitute) -> DiagnosticStatus:
    return _status_of(name, '', {'value': said.value, 'deviation': said.deviation,
                                 'offset': said.offset, **_bounds(said.interval)})


def _reserve(said: Reserve) -> DiagnosticStatus:
    return _status_of(said.name, 'reserve' if said.ready else 'reserve, not ready', {
        'reading': said.reading, 'reserve': said.estimate, 'reserve_deviation': said.deviation})


def _functional(said: Functional) -> DiagnosticStatus:
    return _status_of(said.name, '' if said.ready else 'not ready', {
        'value': said.value, 'deviation': said.deviation, **_bounds(said.interval)})


def _bounds(interval: tuple[float, float] | None) -> dict[str, float]:
    return {} if interval is None else {'low': interval[0], 'high': interval[1]}


def _size(said: SizeNow) -> DiagnosticStatus:
    why = f'misled by {", ".join(said.misled_by)}, faulty' if said.misled_by else said.method
    return _status_of(f'fault.{said.name}', why, {
        'value': said.value, 'deviation': said.deviation})


def _status_of(name: str, message: str, facts: Mapping[str, float]) -> DiagnosticStatus:
    return DiagnosticStatus(
        level=DiagnosticStatus.OK, name=name, message=message,
        values=[KeyValue(key=key, value=repr(float(value))) for key, value in facts.items()])
