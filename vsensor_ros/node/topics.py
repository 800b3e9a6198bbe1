"""
Message streams: what arrives on topics, and what goes out in place of failed channels.

A message with no failed channel in it goes on as the bytes that came. While a channel of a driver
is failed, its messages are composed: the latest live one is the template, the failed channels are
written into it, and every other channel is what it last said.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
import copy
from dataclasses import dataclass, field
import math
from typing import Any, NamedTuple

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from vsensor_ros.engine.channel import Channel, REAL, VIRTUAL
from vsensor_ros.engine.clock import NodeClock
from vsensor_ros.node.accessor import compile_holder, has_stamp, NOT_THERE, put_stamp, trace
from vsensor_ros.node.cdr import decode, Reader, Reading
from vsensor_ros.node.driver import blank, Driver, Drivers
from vsensor_ros.node.parameters import Sensor
from vsensor_ros.node.polling import DEPTH, LISTEN, Polled, subscribe
from vsensor_ros.node.qos import qos_options
from vsensor_ros.node.variance import compile_variance

NOT_NEWER = 'not sent on: not newer than what went out'
FROM_THE_FUTURE = 'not sent on: stamp far ahead of the clock'
ONLY_NAN = 'nothing but NaN arrives'
SPEAK = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)


class Substitute(NamedTuple):
    """What is to go out for a failed channel."""

    value: float | None  # NaN marks it as failed; None: nothing is to go out
    fault_set: tuple[str, ...] | None = None  # of the virtual sensor that says so
    deviation: float = math.inf  # standard deviation; inf when not known
    above: float | None = None  # see Channel.serve


@dataclass(eq=False)
class Stream:
    """The messages of one input topic, on their way to one output topic. Times are in ns."""

    sensors: tuple[Sensor, ...]
    channels: tuple[Channel, ...]  # of these sensors
    subscription: Subscription
    publisher: Publisher
    clock: NodeClock
    say: Callable[[str], None]  # an error
    hold: Callable[[], None]  # waits until a composed message is due
    active: bool = False  # sends
    failed: frozenset[str] = frozenset()  # channels that are composed
    passing: frozenset[str] = frozenset()  # failed, too, but let through all the same
    plain: bool = True  # nothing was ever composed: every message goes on
    drivers: Drivers = field(default_factory=Drivers)
    _latest: dict[str, float] = field(default_factory=dict)  # by channel: what it said
    _heard: dict[str, int] = field(default_factory=dict)  # and when, by the node's clock
    _lacks: dict[str, tuple[str, int]] = field(default_factory=dict)  # why it did not, and when

    def __post_init__(self) -> None:
        kind = self.sensors[0].kind
        self.reader = Reader(kind, [s.accessor.path for s in self.sensors])
        self.kind, self._stamped = kind, has_stamp(kind)
        self.names = tuple(s.name for s in self.sensors)
        self._max_age = {c.name: c.max_age for c in self.channels}
        self._longest = max(self._max_age.values())
        self._only = self.drivers.sender(self.names) if len(self.names) == 1 else Driver(set())
        self.absent = tuple(NOT_THERE.format(s.accessor.path) for s in self.sensors)
        self._set_variance = {s.name: compile_variance(kind, s.accessor.path)
                              for s in self.sensors}
        self._named = [(compile_holder(steps[:i]), step.field, step.names)
                       for steps in (trace(kind, s.accessor.path) for s in self.sensors)
                       for i, step in enumerate(steps) if step.names is not None]
        self._send = self.publisher.handle.publish_raw

    # -------------------------------------------------------------------------- what comes in

    def lacks(self, reason: str, now: int) -> None:
        """Note that something arrived that says nothing of any channel."""
        self._lacks.update(dict.fromkeys(self.names, (reason, now)))

    def heard(self, name: str) -> bool:
        """Tell whether a channel has ever spoken, since the clock went back."""
        return name in self._heard or self._lacks.get(name, ('', 0))[0] == ONLY_NAN

    def latest(self, name: str) -> float:
        """Return what a channel said last, NaN before it spoke."""
        return self._latest.get(name, math.nan)

    def fresh(self, name: str, now: int) -> bool:
        """Tell whether a channel has spoken within its max_age."""
        heard = self._heard.get(name)
        return heard is not None and now - heard <= self._max_age[name]

    def why_silent(self, name: str, now: int) -> str | None:
        """Return in words why a healthy channel is not to be had live, or None when it is."""
        topic = self.sensors[0].input
        if self.fresh(name, now):
            blocked = self.drivers.of(name).blocked
            stuck = blocked is not None and now - blocked > self._max_age[name]
            return f'messages arrive on {topic}, but are {NOT_NEWER}' if stuck else None
        reason, at = self._lacks.get(name, ('', 0))
        if reason and now - at <= self._max_age[name]:
            if reason == ONLY_NAN:
                return f'{ONLY_NAN} on {topic}'
            return f'messages arrive on {topic}, but {reason}'
        return f'nothing comes on {topic}'

    def driver_silence(self, name: str) -> str:
        """Return in words for how long a channel's driver has been silent, '' if it is not."""
        driver = self.drivers.of(name)
        if driver.raw is None or not self._silent(driver):
            return ''
        return f'its driver has been silent for {(self.clock.now - driver.heard) * 1e-9:.1f} s'

    def _silent(self, driver: Driver) -> bool:
        return self.clock.now - driver.heard > self._longest

    def forget(self) -> None:
        """Begin anew after the clock went back."""
        for driver in self.drivers.all:
            driver.forget(self.clock.now)
        self._heard.clear()
        self._lacks.clear()

    def accept(self, raw: bytes, reading: Reading) -> str | None:
        """
        Send a live message on, or keep what it says for the messages composed of it.

        Returns why a message that should have gone out did not, or None. Raises RuntimeError when
        the middleware cannot send it.
        """
        now, values, stamp = self.clock.now, reading.values, reading.stamp
        if self.plain and self.active and len(values) == 1 and values[0].__class__ is float and (
                stamp is None
                or self._only.last_sent < stamp <= now + self._only.ahead):
            self._send(raw)  # mostly it is so, and soon is better
            self._keep(raw, stamp, float(values[0]), now)
            return None
        if reading.foreign:
            return self._pass_foreign(raw, values[0], now)
        for name, value in zip(self.names, values):
            if isinstance(value, str):
                self._lacks[name] = value, now
            else:
                self._note(name, value, now)
        driver = self.drivers.sender(self.names if str not in map(type, values) else tuple(
            n for n, v, absent in zip(self.names, values, self.absent) if v != absent))
        failed = self.failed and self.failed & driver.channels
        driver.keep(raw, sum(v.__class__ is float and n not in failed
                             for n, v in zip(self.names, values)) if len(values) > 1 else 0,
                    now, self._max_age[self.names[0]])
        if failed or not self.active:
            return None  # it goes out in the next message that is composed
        if stamp is not None:
            if stamp > now + driver.ahead and not driver.believes(stamp, now):
                return FROM_THE_FUTURE
            if stamp <= driver.last_sent and not driver.in_order(
                    stamp, now, self._longest, self._step_back):
                return NOT_NEWER
            driver.sends(stamp, now)
        if not self.plain:
            raw = self._blended(raw, reading)
        self._send(raw)
        return None

    def _keep(self, raw: bytes, stamp: int | None, value: float, now: int) -> None:
        """Note what went out of the one channel there is."""
        self._note(self.names[0], value, now)
        driver = self._only
        driver.take(raw, now)
        if stamp is not None:
            driver.sends(stamp, now)

    def _note(self, name: str, value: float, now: int) -> None:
        """Note what a channel says; with NaN it is there, but says nothing."""
        self._latest[name] = value
        if math.isnan(value):
            self._lacks[name] = ONLY_NAN, now
        else:
            self._heard[name] = now

    def _pass_foreign(self, raw: bytes, why: Any, now: int) -> str | None:
        """Pass on a message of other joints, with its own stamps, if its driver is healthy."""
        if self.failed and self._same_driver(raw, now):
            return None
        self.lacks(why, now)
        if self.active:
            self._send(raw)
        return None

    def _same_driver(self, raw: bytes, now: int) -> bool:
        """
        Take a message that shares joints with a failed driver's for its template.

        One with numbers that have no names may be anybody's: it is not sent, nor a template.
        """
        message = decode(self.kind, raw)
        if any(not getattr(holder, names) or len(getattr(holder, field)) > len(
                getattr(holder, names)) for find, field, names in self._named
                if (holder := find(message)) is not None):
            self.lacks(self.absent[0], now)
            return True
        for driver in self.drivers.all:
            if not self.failed & driver.channels or driver.raw is None:
                continue
            template = self._template(driver)
            if any(set(s.accessor.names(message)) & set(s.accessor.names(template))
                   for s in self.sensors):
                driver.keep(raw, 0, now, self._max_age[self.names[0]])
                self.lacks(self.absent[0], now)
                return True
        return False

    def _blended(self, raw: bytes, reading: Reading) -> bytes:
        """Return a live message with what is left of the offsets of the last switch."""
        lasting = self.clock.lasting()
        changed = {}
        for i, (channel, value) in enumerate(zip(self.channels, reading.values)):
            if value.__class__ is float and math.isfinite(value) and \
                    channel.name not in self.passing:
                put = channel.serve(REAL, (), value, lasting)
                if put != value:
                    changed[i] = put
        if not changed:
            return raw
        written = self.reader.write(raw, reading, changed)
        return raw if isinstance(written, str) else written

    def _step_back(self, seconds: float) -> None:
        sensor = self.sensors[0]
        self.say(f'the stamps on {sensor.input} stay {seconds:.1f} s behind what went out on '
                 f'{sensor.output}: they step back there now; mend the clock of the driver')

    # --------------------------------------------------------------------------- what goes out

    def fail(self, failed: frozenset[str], passing: frozenset[str] = frozenset()) -> None:
        """Compose these channels from now on; those passing have failed, too."""
        self.passing = passing
        if self.plain and failed:
            lasting = self.clock.lasting()
            for channel in self.channels:  # what it said last went out; nobody noted it till now
                heard = self._heard.get(channel.name)
                if heard is not None and self.active:
                    channel.value = self._latest[channel.name]
                    channel.sent = lasting - (self.clock.now - heard)
            self.plain = False
        if failed != self.failed:
            self.failed = failed
            for driver in self.drivers.all:
                driver.carried, driver.problem = 0, None

    def compose(self, time: int, substitutes: Mapping[str, Substitute],
                at_once: bool = False) -> dict[str, str]:
        """
        Send each template with these channels replaced, stamped with the state's time.

        All other channels are as they were last heard, NaN when that is too long ago. A driver
        none of whose channels has a value sends nothing; beside others, one without is NaN.
        at_once: may be stamped a little later. Returns by channel why nothing went out for it, ''
        if NaN did. Raises RuntimeError when the middleware cannot send it.
        """
        troubles: dict[str, str] = {}
        if not self.active or time == 0:
            return troubles
        for driver, names in self.drivers.serving(substitutes).items():
            stopped = [name for name in names if substitutes[name].value is None]
            if len(stopped) == len(names) and not any(
                    self.fresh(name, self.clock.now) for name in driver.channels
                    if name not in names):
                continue
            driver.problem = self._compose(driver, time, substitutes, at_once)
            for name in names if driver.problem else stopped:
                troubles[name] = driver.problem or ''
        return troubles

    def _compose(self, driver: Driver, time: int, substitutes: Mapping[str, Substitute],
                 at_once: bool) -> str | None:
        now = self.clock.now
        message = self._template(driver)
        if message is None:
            return 'no message of its driver was ever seen, so frame and names are not known'
        if self._silent(driver) and not driver.blanked and driver.first and driver.raw:
            blank(message, decode(self.kind, driver.first), decode(self.kind, driver.raw))
            driver.blanked = True
        stamp = driver.stamp_for(time, at_once)
        if not driver.in_order(stamp, time, self._longest, self._step_back):
            assert driver.blocked is not None
            return NOT_NEWER if now - driver.blocked > self._longest else None
        for sensor, channel in zip(self.sensors, self.channels):
            if sensor.name not in driver.channels:
                continue
            substitute = substitutes.get(sensor.name)
            problem = self._fill_live(message, sensor, channel) if substitute is None else \
                self._fill(message, sensor, channel, substitute, time)
            if problem is not None:
                return problem
        if self._stamped:
            put_stamp(message, stamp)
        if driver.apart and not driver.composed:
            self.say(f'the stamps on {self.sensors[0].input} are {driver.offset * 1e-9:+.1f} s '
                     'from the clock of this node; the estimates in their place follow them')
        self.hold()
        self.publisher.publish(message)
        driver.last_sent, driver.composed = stamp, True
        return None

    def _fill(self, message: Any, sensor: Sensor, channel: Channel, substitute: Substitute,
              time: int) -> str | None:
        """Write a substitute into a message; return why it cannot be written, or None."""
        value = math.nan if substitute.value is None else substitute.value
        if substitute.fault_set is not None:
            value = channel.serve(VIRTUAL, substitute.fault_set, value,
                                  self.clock.lasting(time), substitute.above)
        set_variance = self._set_variance[sensor.name]
        if set_variance is not None:
            set_variance(message, substitute.deviation)
        return sensor.accessor.put(message, value)

    def _fill_live(self, message: Any, sensor: Sensor, channel: Channel) -> str | None:
        """Write what a healthy channel said last into a message."""
        put = sensor.accessor.put
        if self.fresh(sensor.name, self.clock.now):
            value = self._latest[sensor.name]
            if math.isfinite(value) and sensor.name not in self.passing:
                value = channel.serve(REAL, (), value, self.clock.lasting())
            return put(message, value)
        if isinstance(sensor.accessor.get(message), float):
            return put(message, math.nan)
        return None  # neither known nor there

    def _template(self, driver: Driver) -> Any:
        """Return the message that a driver's are made of, decoded when it is needed."""
        if driver.message is None:
            if driver.raw is not None:
                driver.message = decode(self.kind, driver.raw)
            elif not self._stamped:
                driver.message = self.kind()
        return driver.message


def open_streams(node: Node, group: Polled, sensors: Sequence[Sensor],
                 channels: Mapping[str, Channel], clock: NodeClock,
                 say: Callable[[str], None], hold: Callable[[], None]) -> tuple[Stream, ...]:
    """Create the subscription and the publisher of each topic, once and for all."""
    streams = []
    for topic in dict.fromkeys(sensor.input for sensor in sensors):
        sharing = tuple(sensor for sensor in sensors if sensor.input == topic)
        kind, output = sharing[0].kind, sharing[0].output
        publisher = node.create_publisher(
            kind, output, copy.copy(SPEAK), qos_overriding_options=qos_options(),
            event_callbacks=PublisherEventCallbacks(use_default_callbacks=False))
        streams.append(Stream(
            sharing, tuple(channels[s.name] for s in sharing),
            subscribe(node, group, kind, topic, LISTEN), publisher, clock, say, hold))
    return tuple(streams)
