"""
What the replacer says of itself, on ``~/status``, on ``/diagnostics`` and in the log.

On change and at 1 Hz, in the executor's thread: a snapshot is taken under the replacer's lock,
which is cheap; the messages are made of it outside, so that the loop never waits for words.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from functools import lru_cache
import math
import time

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile

from vsensor_ros.bank import Rehearsal
from vsensor_ros.engine import ChannelState, EngineState
from vsensor_ros.node.diagnostics import (
    channel_facts,
    describe,
    describe_loop,
    encode,
    Lately,
    LOOP,
    number,
    Report,
    Scene,
)
from vsensor_ros.node.graph import (
    Complaint,
    complaints,
    End,
    ends_of,
    publishers,
    silent_isolation,
)
from vsensor_ros.node.isolation_record import EVERY
from vsensor_ros.node.pace import Health
from vsensor_ros.node.parameters import DIAGNOSTICS
from vsensor_ros.node.qos import DIAGNOSTICS_TOPIC, ISOLATION, kept, qos_options, STATUS
from vsensor_ros.node.replacer import Replacer
from vsensor_ros.node.reports import LATELY, MOST_STRANGERS
from vsensor_ros.node.reserve import Chance, chance, look_for, origins_of, without_reserve, worth
from vsensor_ros.node.verdicts import statuses

PERIOD = 1.0  # s between two reports when nothing changes
SOONEST = 0.1  # s between two reports, however much changes
LOOK = 2.0  # s between two looks at the graph
MOST_LINES = 10  # in the log after one look
MOST_TOLD = 1000  # complaints that are remembered, not to be said again
GRACE = 5.0  # s for which a reserve may be lacking before it is a warning: all has to start
QUIET = 5.0  # s between two log lines that say the same of a channel
WINDOW = 1.0  # s that rates are taken over, at least
THROWN = 'thrown away'  # what is counted under that name lately; no sensor can be called so
NODE = 'replacer'  # name of the status that is about no channel, on ~/status


class Rates:
    """How many readings come in a second, over the last whole window between two looks."""

    def __init__(self) -> None:
        self._since = 0.0
        self._before: dict[str, int] = {}
        self._rates: dict[str, float] = {}

    def look(self, readings: dict[str, int], now: float) -> dict[str, float]:
        """Return the rates [Hz] by channel, given what has come in up to a steady time [s]."""
        passed = now - self._since
        if passed >= WINDOW:
            if self._before:
                self._rates = {name: (count - self._before[name]) / passed
                               for name, count in readings.items()}
            self._since, self._before = now, readings
        return self._rates


class Reporter:
    """Tells what a replacer does, from when it is configured until it is cleaned up."""

    def __init__(self, node: Node, replacer: Replacer) -> None:
        self.node, self.replacer = node, replacer
        self.active = False
        # what it says of itself is its own: two of one name would be taken for one
        self.ends = (*ends_of(replacer.settings), *(
            End(node.resolve_topic_name(topic), DIAGNOSTICS, True)
            for topic in (STATUS, ISOLATION)))
        self.topics = {s.name: {s.input, s.output} for s in replacer.settings.sensors}
        settings = replacer.settings
        self._isolation = End(settings.isolation_topic, settings.isolation_type, False)
        self._inputs = {self._isolation.topic, *(inlet.topic for inlet in replacer.inlets)}
        self._origins = origins_of(settings)
        self._tell = lru_cache(MOST_STRANGERS)(settings.isolation_names.tell)
        self.found: tuple[Complaint, ...] = ()  # on the graph, at the last two looks
        self._suspected: set[Complaint] = set()  # at the last look
        self._told: set[Complaint] = set()
        self._lately = Lately()
        self._lacking: dict[str, float] = {}  # by channel: since when it has no reserve, in s
        self._rates = Rates()
        self._spoken: dict[tuple[str, str], float] = {}  # by channel and source: when logged
        self._logged: dict[str, str] = {}  # by channel: the source logged last
        self._reported = 0.0
        self._hurried = False
        self.status = node.create_publisher(
            DiagnosticArray, STATUS, kept(), qos_overriding_options=qos_options())
        self.diagnostics = node.create_publisher(
            DiagnosticArray, DIAGNOSTICS_TOPIC, QoSProfile(depth=10),
            qos_overriding_options=qos_options())
        self.isolation = None if replacer.engine.verdict is None else node.create_publisher(
            DiagnosticArray, ISOLATION, kept(), qos_overriding_options=qos_options())
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # goes on when simulated time stops
        self._timers = [node.create_timer(PERIOD, self.report, clock=steady),
                        node.create_timer(LOOK, self.look_around, clock=steady)]
        if self.isolation is not None:
            self._timers.append(node.create_timer(EVERY, replacer.record.keep, clock=steady))
        self._guard = node.create_guard_condition(self._hurry)
        replacer.changed = self._guard.trigger

    def turn(self, active: bool) -> None:
        """Tell from now on that it is active, or not; what was lately is no matter then."""
        self.active, self._lately, self._lacking = active, Lately(), {}

    def close(self) -> None:
        """Close the topics."""
        self.replacer.changed = _nothing
        for timer in self._timers:
            self.node.destroy_timer(timer)
        self.node.destroy_guard_condition(self._guard)
        for publisher in (self.status, self.diagnostics, self.isolation):
            if publisher is not None:
                self.node.destroy_publisher(publisher)

    def _hurry(self) -> None:
        """Report a change at once, or as soon as one may."""
        wait = self._reported + SOONEST - time.monotonic()
        if wait <= 0.0:
            self.report()
        elif not self._hurried:
            self._hurried = True
            self._every(wait)

    def _every(self, period: float) -> None:
        timer = self._timers[0]
        timer.timer_period_ns = round(period * 1e9)
        timer.reset()

    def report(self) -> None:
        """Tell how things are now."""
        if self._hurried:
            self._hurried = False
            self._every(PERIOD)
        now = self._reported = time.monotonic()
        with self.replacer.lock:
            engine, health = self.replacer.snapshot(), self.replacer.health()
            strangers = self.replacer.reports.strangers()
            verdict = self.replacer.engine.verdict
            state = 'inactive' if not self.active else \
                'starting' if self.replacer.start.waits else 'active'
        channels = engine.channels
        rates = self._rates.look({c.name: c.readings for c in channels}, now)
        self._note_reserves(channels if state == 'active' else (), now)
        scene = self._scene(engine, now)
        sharing = defaultdict(set)
        for channel in channels:
            sharing[channel.topic].add(channel.name)
        reports = [describe(c, scene, sharing[c.topic]) for c in channels] \
            if state == 'active' else []
        unknown = [f'{self._isolation.topic}: {self._tell(name)}' for name in strangers]
        loop = describe_loop(engine, state, self._lately.grown(LOOP, engine.left_out, now),
                             [*self._about(None), *unknown],
                             self._lately.grown(THROWN, health.thrown_away, now))
        stamp = self.node.get_clock().now().nanoseconds
        # keeps our names off the isolation's, and those of two robots apart
        prefix = f'{self.node.get_fully_qualified_name().lstrip("/")}: '
        told = list(zip(channels, reports))
        pace = _loop_facts(engine, health, state)
        self.status.publish(encode(
            [*((c.name, r, _status_facts(c, rates.get(c.name, math.nan))) for c, r in told),
             (NODE, loop, pace)], stamp))
        self.diagnostics.publish(encode(
            [*((prefix + c.name, r, channel_facts(c, scene, rates.get(c.name, math.nan)))
               for c, r in told),
             (prefix + LOOP, loop, pace)], stamp))
        if self.isolation is not None and verdict is not None:
            settings = self.replacer.settings
            self.isolation.publish(encode(statuses(
                verdict, settings.design.sensors, prefix.removesuffix(': '),
                settings.isolator.mode), stamp))
        for channel, told_now in told:
            self._log(told_now, now)
            self._log_reserve(channel, scene, now)

    def _scene(self, engine: EngineState, now: float) -> Scene:
        settings, channels = self.replacer.settings, engine.channels
        return Scene(
            self.node.get_fully_qualified_name(), settings.design, self.replacer.policies,
            engine.faulty, {c.name: self._about(c.name) for c in channels},
            {c.name: self._lately.grown(c.name, c.switches, now) for c in channels},
            frozenset(name for name, since in self._lacking.items() if now - since >= GRACE),
            self._origins)

    def _note_reserves(self, channels: Iterable[ChannelState], now: float) -> None:
        """Note since when real channels lack a reserve that they should have."""
        for channel in channels:
            if channel.source == 'real' and chance(channel.reserve) is Chance.MEND:
                self._lacking.setdefault(channel.name, now)
            else:
                self._lacking.pop(channel.name, None)

    def _about(self, name: str | None) -> list[str]:
        """Return what was found on the graph about a channel; None: about no channel."""
        return [str(c) for c in self.found if (
            c.topic in self.topics[name] and c.about in ('', name) if name
            else not any(c.topic in topics for topics in self.topics.values()))]

    def _log(self, report: Report, now: float) -> None:
        """Log a change of source; of what toggles, no more than a line a while."""
        before = self._logged.get(report.name)
        key = report.name, report.source
        if before == report.source or now < self._spoken.get(key, 0.0):
            return
        self._logged[report.name], self._spoken[key] = report.source, now + QUIET
        line, log = f'{report.name}: {report.message}', self.node.get_logger()
        if report.source == 'none':  # rclpy allows one severity a line of code
            log.error(line)
        elif report.source == 'virtual' or (report.source == 'silent' and before):
            log.warning(line)
        elif before:
            log.info(line)

    def _log_reserve(self, channel: ChannelState, scene: Scene, now: float) -> None:
        """Log now and then who could not be replaced, and once who never can."""
        name, reserve, log = channel.name, channel.reserve, self.node.get_logger()
        if reserve is None or now < self._spoken.get((name, 'reserve'), 0.0):
            return
        line = f'{name}: {"; ".join(without_reserve(name, reserve, scene.origins))}'
        if name in scene.lacking:
            self._spoken[name, 'reserve'] = now + LATELY
            log.warning(line)
        elif chance(reserve) is Chance.NEVER and not scene.faulty:
            self._spoken[name, 'reserve'] = math.inf
            log.info(line)

    def look_around(self) -> None:
        """Look at the graph; what is wrong at two looks is said: half discovered looks wrong."""
        heard = publishers(self.node, self._inputs)
        seen = set(complaints(self.node, self.ends))
        if self.replacer.settings.isolator.mode != 'act':
            seen.update(silent_isolation(
                self.node, self._isolation, heard[self._isolation.topic]))
        with self.replacer.lock:
            for inlet in self.replacer.inlets:
                seen.update(inlet.complaints(heard[inlet.topic]))
                inlet.watch(len(heard[inlet.topic]) > 1)
        self._origins = {name: look_for(self.node, origin, heard[origin.topic])
                         for name, origin in self._origins.items()}
        self.found = tuple(sorted(seen & self._suspected, key=str))
        for complaint in [c for c in self.found if c not in self._told][:MOST_LINES]:
            self.node.get_logger().error(str(complaint))
            self._told.add(complaint)
        if len(self._told) > MOST_TOLD:  # they come from outside
            self._told.clear()
        self._suspected = seen


def _nothing() -> None:
    """Nobody wants to know any more."""


_NOT_REHEARSED = Rehearsal(math.nan, math.nan, math.nan, math.nan, math.nan, 0.0)


def _status_facts(channel: ChannelState, rate: float) -> Mapping[str, object]:
    """
    Return the state of a channel for programs; the keys are part of the interface.

    rate: of its readings [Hz].
    """
    low, high = channel.interval or (math.nan, math.nan)
    mean, rms, worst, _, within, compared = channel.rehearsed or _NOT_REHEARSED
    return {
        'source': channel.source,
        'valid': str(channel.source in ('real', 'virtual')).lower(),
        'fault_set': ' '.join(channel.fault_set),
        'grade': channel.grade,
        'value': number(channel.value),
        'unit': channel.unit,
        'deviation': number(channel.deviation),
        'offset': number(channel.offset),
        'switches': channel.switches,
        'last_step': number(channel.last_step),
        'virtual_s': f'{channel.virtual_s:.3f}',
        'since_s': f'{channel.since_s:.3f}',
        'forced': str(channel.forced).lower(),
        'isolated_s': f'{channel.isolated_s:.3f}',
        'isolated_by': ' '.join(channel.isolated_by),
        'recovering_s': f'{channel.recovering_s:.3f}',
        'residual': number(channel.residual),
        'low': number(low),
        'high': number(high),
        'outside_region': str(channel.outside_region).lower(),
        'outside_domain': channel.outside_domain,
        'restarts': channel.restarts,
        'readings_hz': number(rate),
        'not_used': sum(channel.counts.values()),
        'reason': channel.reason or '',
        'reserve': 'ready' if channel.reserve is None else 'not ready',
        'reserve_reason': channel.reserve or '',
        'reserve_worth': worth(channel),
        'reserve_deviation': number(channel.reserve_deviation),
        'reserve_mean': number(mean),
        'reserve_rms': number(rms),
        'reserve_worst': number(worst),
        'reserve_within': number(within),
        'reserve_compared_s': f'{compared:.1f}',
        'remaining_s': number(channel.remaining_s),
    }


def _loop_facts(engine: EngineState, health: Health, state: str) -> Mapping[str, object]:
    """Return how the loop keeps up, for programs."""
    return {
        'state': state,
        'rate': number(health.rate),
        'achieved': number(health.achieved),
        'step_p50': number(health.step_p50),
        'step_p99': number(health.step_p99),
        'step_max': number(health.step_max),
        'jitter_p99': number(health.jitter_p99),
        'overruns': engine.left_out,
        'ticks': engine.ticks,
        'estimates': engine.estimates,
        'starts': engine.starts,
        'not_used': health.not_used,
        'thrown_away': health.thrown_away,
        'faulty': ' '.join(engine.faulty),
        'spoken_of': ' '.join(engine.spoken_of),
        **{f'clock_{way.replace(" ", "_")}': count for way, count in engine.jumps.items()},
        **_command_facts(engine),
    }


def _command_facts(engine: EngineState) -> Mapping[str, object]:
    """Return how each command is, for programs."""
    facts: dict[str, object] = {}
    for command in engine.commands:
        key = f'command_{command.name}'
        facts[key] = command.trouble or command.lack or 'OK'
        facts[f'{key}_lead'] = number(command.lead)
        facts[f'{key}_from_arrival'] = command.from_arrival
        facts[f'{key}_not_used'] = sum(command.counts.values())
    return facts
