"""
The isolator as a node of its own: it listens, and says which sensors have failed, by how much.

It shares parameters, intake and engine with the replacer, but speaks in nobody's place, and
listens to nobody else who isolates. It has no thread of its own: whoever polls it lets it tick.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from threading import RLock
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.service import Service
from rclpy.subscription import Subscription
from std_srvs.srv import Trigger

from vsensor_ros.engine import Live
from vsensor_ros.node.diagnostics import encode
from vsensor_ros.node.estimates import Estimates
from vsensor_ros.node.graph import Complaint, complaints, ends_of, publishers
from vsensor_ros.node.hearing import hear, start_engine
from vsensor_ros.node.isolation_record import EVERY, IsolationRecord
from vsensor_ros.node.log import Log
from vsensor_ros.node.parameters import Settings
from vsensor_ros.node.polling import Polled, SimulatedTime
from vsensor_ros.node.private_rclpy import key_of
from vsensor_ros.node.qos import ISOLATION, kept, qos_options
from vsensor_ros.node.topics import open_topics
from vsensor_ros.node.verdicts import statuses

PERIOD = 1.0  # s between two reports when nothing changes
LOOK = 2.0  # s between two looks at the graph


class Isolator:
    """
    One isolator on a node. Times are in ns.

    Public methods take `lock`, which is held while it is polled: they may come from any thread.
    """

    def __init__(self, node: Node, settings: Settings) -> None:
        """Open all topics; raises Refused, and RuntimeError (RCLError)."""
        self.node, self.settings = node, settings
        self.lock = RLock()
        self.changed: Callable[[], Any] = _nothing  # called when it says something else
        self.log = Log(node.get_logger())
        self.simulated = bool(node.get_parameter('use_sim_time').value)
        group = Polled()
        clock = SimulatedTime(node, group) if self.simulated else None
        self._time: Callable[[], int | None] = time.time_ns if clock is None else clock.read
        self.topics = open_topics(node, group, settings.sensors, speaks=False)
        # what it says is for others to act on, whatever the file tells a replacer
        self.engine = start_engine(node, settings, self.topics, self.simulated,
                                   replace(settings.isolator, mode='advise'))
        self.record = IsolationRecord(settings.isolator_record, node.get_fully_qualified_name(),
                                      settings.design_hash, self.engine, self.lock, self.log)
        self.estimates = Estimates(node)
        hearing = hear(node, group, self.topics, settings.commands, self.engine, self.log)
        self.inlets = hearing.inlets
        takers = list(hearing.takers)
        if clock is not None:
            takers.insert(0, (clock.subscription, lambda: 0))  # `_time` looks there itself
        self.subscriptions: tuple[Subscription, ...] = tuple(end for end, _ in takers)
        self._takers = {key_of(subscription): take for subscription, take in takers}

    def close(self) -> None:
        """Close all topics; nothing may poll any more."""
        self.record.keep()
        for subscription in self.subscriptions:
            self.node.destroy_subscription(subscription)
        self.estimates.close(self.node)

    def activate(self, patient: bool = False) -> None:
        """Look from now on; what came in meanwhile is old."""
        with self.lock:
            self.engine.resume(self._time(), time.monotonic())
            self.poll()

    def deactivate(self) -> None:
        """Do nothing: it rests when nobody polls it."""

    def apply(self, live: Live) -> None:
        """Take over parameters that may change; none of them is about isolation."""

    def clear(self, name: str) -> None:
        """Believe a sensor that is healthy again; raises KeyError."""
        with self.lock:
            self.engine.clear(name)
        self.changed()

    @property
    def due(self) -> int:
        """When, by the system's clock, it wants to be polled, whatever arrives."""
        return self.engine.due

    def poll(self, ready: Iterable[int] | None = None) -> int:
        """Take what has arrived, tick if it is time; return how many messages."""
        with self.lock:
            engine = self.engine
            engine.look(self._time(), time.monotonic())
            taken = 0
            for key in self._takers if ready is None else ready:
                taken += self._takers[key]()
            for at in engine.ticks():
                engine.tick(at)
            self.estimates.show_sizes(engine)
            if engine.changed():
                self.changed()
            for remark in engine.remarks():
                self.log.say(remark.what, remark.level, remark.subject)
            return taken


class Announcer:
    """Says on ``~/isolation`` what an isolator has found: on change, and at 1 Hz."""

    def __init__(self, node: Node, isolator: Isolator) -> None:
        self.node, self.isolator = node, isolator
        self._ends = [end for end in ends_of(isolator.settings)
                      if not end.speaks and end.topic != isolator.settings.isolation_topic]
        self._suspected: set[Complaint] = set()  # at the last look
        self._told: set[Complaint] = set()
        self.publisher = node.create_publisher(
            DiagnosticArray, ISOLATION, kept(), qos_overriding_options=qos_options())
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # goes on when simulated time stops
        self._timers = [node.create_timer(PERIOD, self.report, clock=steady),
                        node.create_timer(LOOK, self.look_around, clock=steady),
                        node.create_timer(EVERY, isolator.record.keep, clock=steady)]
        self._guard = node.create_guard_condition(self.report)
        isolator.changed = self._guard.trigger
        self.active = False

    def turn(self, active: bool) -> None:
        """Tell from now on that it is active, or not: who does not look says nothing."""
        self.active = active

    def close(self) -> None:
        """Close the topic."""
        self.isolator.changed = _nothing
        for timer in self._timers:
            self.node.destroy_timer(timer)
        self.node.destroy_guard_condition(self._guard)
        self.node.destroy_publisher(self.publisher)

    def report(self) -> None:
        """Tell how things are now."""
        if not self.active:
            return
        with self.isolator.lock:
            verdict = self.isolator.engine.verdict
        assert verdict is not None
        self.publisher.publish(encode(
            statuses(verdict, self.isolator.settings.design.sensors,
                     self.node.get_fully_qualified_name().lstrip('/'), 'advise'),
            self.node.get_clock().now().nanoseconds))

    def look_around(self) -> None:
        """Look at the graph; what is wrong at two looks is said: half discovered looks wrong."""
        heard = publishers(self.node, {inlet.topic for inlet in self.isolator.inlets})
        seen = set(complaints(self.node, self._ends))
        with self.isolator.lock:
            for inlet in self.isolator.inlets:
                seen.update(inlet.complaints(heard[inlet.topic]))
                inlet.watch(len(heard[inlet.topic]) > 1)
        for complaint in sorted(seen & self._suspected - self._told, key=str):
            self.node.get_logger().error(str(complaint))
        self._told |= seen & self._suspected
        self._suspected = seen


def offer_clear(node: Node, isolator: Isolator,
                is_active: Callable[[], bool]) -> tuple[Service, ...]:
    """Open ``~/<sensor>/clear`` (Trigger): the sensor is believed again."""
    def clear(name: str) -> Callable[[Any, Any], Any]:
        def answer(request: Any, response: Any) -> Any:
            response.success = is_active()
            response.message = 'the isolator is not active; activate it first'
            if response.success:
                isolator.clear(name)
                response.message = f'{name} is believed'
            return response
        return answer
    return tuple(node.create_service(Trigger, f'~/{sensor}/clear', clear(sensor))
                 for sensor in isolator.settings.design.sensors)


def _nothing() -> None:
    """Nobody wants to know."""
