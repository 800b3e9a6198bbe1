"""
The replacer: forwards the healthy, speaks for the failed.

The wiring of one node from topics to the engine, and back. It has no thread of its own: whoever
polls it takes messages, lets the engine tick, and publishes what the engine says.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from threading import RLock
import time
import traceback
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from vsensor_ros.bad_input import BadInput
from vsensor_ros.engine import (
    Composition,
    EngineState,
    Live,
    Substitute,
)
from vsensor_ros.isolator import Settings as IsolatorSettings
from vsensor_ros.node.estimates import Estimates
from vsensor_ros.node.hearing import hear, start_engine
from vsensor_ros.node.intake import not_sent
from vsensor_ros.node.isolation_record import IsolationRecord
from vsensor_ros.node.log import Log
from vsensor_ros.node.pace import Health, Pace
from vsensor_ros.node.parameters import DIAGNOSTICS, Refused, Settings
from vsensor_ros.node.polling import Polled, SimulatedTime
from vsensor_ros.node.private_rclpy import key_of
from vsensor_ros.node.qos import DIAGNOSTICS_TOPIC
from vsensor_ros.node.reports import Reports, Statuses, Text
from vsensor_ros.node.start import Start
from vsensor_ros.node.topics import open_topics, Topic
from vsensor_ros.reason import Reason


class Replacer:
    """
    One replacer on a node; it sends nothing until activated. Times are in ns.

    Public methods take `lock`, which is held while it is polled: they may come from any thread.
    """

    def __init__(self, node: Node, settings: Settings) -> None:
        """Open all topics; raises Refused."""
        self.node, self.settings = node, settings
        self.policies = settings.live.policies  # as they are now
        self.lock = RLock()
        self.changed: Callable[[], Any] = _nothing  # called when a channel's source changes
        self.log = Log(node.get_logger())
        self.pace = Pace()
        self.simulated = bool(node.get_parameter('use_sim_time').value)
        self._sending: int | None = None  # when what a tick has to say is due
        try:
            self._open(Polled())
        except RuntimeError as error:  # RCLError
            problem = str(error).partition(', at ')[0]
            raise Refused([BadInput(node.get_fully_qualified_name(), 'topics', problem,
                                    'give the topics other names')]) from None

    def _open(self, group: Polled) -> None:
        node, settings = self.node, self.settings
        clock = SimulatedTime(node, group) if self.simulated else None
        self._time: Callable[[], int | None] = time.time_ns if clock is None else clock.read
        self.topics = open_topics(node, group, settings.sensors)
        self.engine = start_engine(node, settings, self.topics, self.simulated, self._isolator())
        self.record = IsolationRecord(settings.isolator_record, node.get_fully_qualified_name(),
                                      settings.design_hash, self.engine, self.lock, self.log)
        names = settings.isolation_names
        self.reports = Reports(
            node, group, settings.isolation_topic,
            Statuses(names, settings.isolation_topic == DIAGNOSTICS_TOPIC)
            if settings.isolation_type == DIAGNOSTICS else Text(names), names,
            lambda text, subject: self.log.say(text, subject=subject))
        self.start = Start(self.reports, self.engine.heard_any,
                           lambda text: self.log.say(text, 'warning'))
        self.estimates = Estimates(node)
        self._shown = 0  # time of the reserves that were published last
        takers: list[tuple[Subscription, Callable[[], int]]] = [
            (s, self._take_isolation) for s in self.reports.subscriptions]
        hearing = hear(node, group, self.topics, settings.commands, self.engine, self.log)
        self.inlets = hearing.inlets
        takers.extend(hearing.takers)
        self.readers = {inlet.topic: inlet.reader for inlet in self.inlets}
        if clock is not None:
            takers.insert(0, (clock.subscription, _nothing))  # `_time` looks there itself
        self.subscriptions = tuple(subscription for subscription, _ in takers)
        self._takers = {key_of(subscription): take for subscription, take in takers}

    def _isolator(self) -> IsolatorSettings | None:
        """Return what the own isolator is told; None: who only may have one has none."""
        settings, found = self.settings.isolator, self.settings.design.isolability
        if settings.mode == 'advise' and (found is None or not found.residuals):
            self.log.say('isolator: none, because no residual of the design tells of a fault; '
                         'make it with designer --isolate', 'info')
            return None
        return settings

    def close(self) -> None:
        """Close all topics; nothing may poll any more."""
        self.record.keep()
        with self.lock:
            for subscription in self.subscriptions:
                self.node.destroy_subscription(subscription)
            for topic in self.topics:
                self.node.destroy_publisher(topic.publisher)
            self.estimates.close(self.node)

    # ------------------------------------------------------------------- what may be asked of it

    def activate(self, patient: bool = False) -> None:
        """
        Send from now on. What came in meanwhile is old: it is read, but not sent.

        patient: wait until it is known what isolation said before.
        """
        with self.lock:
            self.engine.resume(self._time(), time.monotonic())
            self.pace.rest()
            self.poll()
            if patient:
                self.start.begin()
            else:
                self._set_active(True)

    def deactivate(self) -> None:
        """Send nothing from now on."""
        with self.lock:
            self.start.end()
            self._set_active(False)

    def _set_active(self, active: bool) -> None:
        self.engine.activate(active)
        self.changed()

    def force(self, name: str) -> None:
        """Treat a sensor as faulty until released; raises ValueError, one line, and KeyError."""
        self._ask(partial(self.engine.force, name))

    def release(self, name: str) -> None:
        """End the force on a sensor; raises KeyError."""
        self._ask(partial(self.engine.release, name))

    def clear(self, name: str) -> None:
        """Believe a sensor that is healthy again; raises ValueError, one line, and KeyError."""
        self._ask(partial(self.engine.clear, name))

    def reset(self) -> None:
        """Start all virtual sensors anew, forget forces, holds and latches."""
        self._ask(self.engine.reset)

    def apply(self, live: Live) -> None:
        """Take over parameters that may change."""
        with self.lock:
            self.policies = live.policies
            self._ask(partial(self.engine.apply, live))

    def _ask(self, request: Callable[[], list[Composition]]) -> None:
        with self.lock:
            self._send(request())
            self._tell()

    def snapshot(self) -> EngineState:
        """Return how each channel is now."""
        with self.lock:
            return self.engine.snapshot(time.monotonic())

    def health(self) -> Health:
        """Return how the loop keeps up."""
        with self.lock:
            return Health(self.settings.rate, self.pace.achieved(), *self.pace.step(),
                          self.pace.jitter(round(1e9 / self.settings.rate)),
                          self.reports.not_used, self.reports.thrown_away)

    @property
    def due(self) -> int:
        """When, by the system's clock, it wants to be polled, whatever arrives."""
        return self.engine.due

    # ------------------------------------------------------------------------------ one round

    def poll(self, ready: Iterable[int] | None = None) -> int:
        """
        Take what has arrived, tick if it is time; return how many messages.

        ready: keys of the subscriptions to look at; all by default. By the system's clock a tick
        comes first, so that it is never late for what has just arrived; by a simulated one last,
        because time moves on only when all has been said.
        """
        with self.lock:
            if self.start.is_over():
                self._set_active(True)
            engine = self.engine
            engine.look(self._time(), time.monotonic())
            if not self.simulated and engine.now >= engine.due:
                self._tick()
            taken = 0
            for key in self._takers if ready is None else ready:
                taken += self._takers[key]()
            if self.simulated:
                self._tick()
            self._tell()
            return taken

    def _take_isolation(self) -> int:
        self.reports.take(self.engine.now)
        self._send(self.engine.isolate(self.reports.report()))
        return 0

    def _tick(self) -> None:
        """Let the engine step as far as time has come, and send what it says."""
        engine = self.engine
        for at in engine.ticks():
            self.pace.begin()
            made = engine.tick(at)
            if made:
                self._sending = engine.send_at(at)
                self._send(made)
                self._sending = None
            self.pace.end()
        self._show_reserves()
        self.estimates.show_sizes(self.engine)

    def _show_reserves(self) -> None:
        """Publish what could be said in place of healthy sensors, and what else is wanted."""
        time = self.engine.state_time
        if time is not None and time != self._shown and self.estimates.listeners():
            self._shown = time
            self.estimates.send_reserves(time, self.engine.reserves())
            self.estimates.send_functionals(time, self.engine.functionals())

    def _tell(self) -> None:
        """Let people know what is new."""
        if self.engine.changed():
            self.changed()
        for remark in self.engine.remarks():
            self.log.say(remark.what, remark.level, remark.subject)

    # ----------------------------------------------------------------------- what goes out

    def _send(self, made: Sequence[Composition]) -> None:
        """Publish messages, and tell the engine how that went."""
        estimates: dict[int, list[tuple[str, Substitute]]] = {}  # by time
        for composition in made:
            topic = self.topics[composition.stream]
            trouble = self._publish(topic, composition)
            self.engine.done(composition, trouble)
            if trouble is None:
                estimates.setdefault(composition.time, []).extend(
                    (topic.sensors[i].name, said) for i, said in composition.fields
                    if isinstance(said, Substitute) and said.fault_set is not None)
        for at, those in estimates.items():
            self.estimates.send(at, those)

    def _publish(self, topic: Topic, composition: Composition) -> Reason | None:
        """Publish a message that the engine composed; return why it did not go out, or None."""
        try:
            message = topic.compose(composition)
            if isinstance(message, Reason):
                return message
            self._wait_until_due()
            topic.publisher.publish(message)
        except RuntimeError as error:  # RCLError
            return not_sent(error)
        except Exception as error:  # nothing that goes wrong with one topic ends the others
            self.log.say(traceback.format_exc(), subject=(topic.index, type(error)))
            return Reason.of('mistake', error=type(error).__name__)
        return None

    def _wait_until_due(self) -> None:
        """Wait, within a tick, until it is time to send: all else is done then."""
        if self._sending:
            left, self._sending = self._sending - time.time_ns(), None
            if 0 < left <= self.engine.lead:
                self.pace.wait(left)


def _nothing() -> int:
    """Nobody wants to know."""
    return 0
