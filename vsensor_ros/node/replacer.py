"""
The replacer: forwards the healthy, speaks for the failed.

The wiring of one node from topics to bank and switch, and back. It has no thread of its own:
whoever polls it takes messages, steps the bank at its rate and publishes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
import math
from threading import RLock
import time
import traceback
from typing import Any

from rclpy.node import Node
from rclpy.subscription import Subscription

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Bank
from vsensor_ros.engine import Bumpless, Source, Switch
from vsensor_ros.engine.channel import Channel, REAL, VIRTUAL
from vsensor_ros.engine.clock import NodeClock
from vsensor_ros.engine.state import ChannelState, Health
from vsensor_ros.node.cdr import Reader
from vsensor_ros.node.estimates import Estimates
from vsensor_ros.node.intake import Intake
from vsensor_ros.node.log import Log
from vsensor_ros.node.parameters import Command, DIAGNOSTICS, Live, Refused, Settings
from vsensor_ros.node.polling import LISTEN, Polled, SimulatedTime, subscribe
from vsensor_ros.node.qos import DIAGNOSTICS_TOPIC
from vsensor_ros.node.reports import kind_of, Reports
from vsensor_ros.node.snapshot import channel_states, health, Rates, source
from vsensor_ros.node.start import Start
from vsensor_ros.node.ticks import Ticks
from vsensor_ros.node.topics import open_streams, Stream, Substitute
from vsensor_ros.observers import VirtualSensor

LOOK = 50_000_000  # ns between two looks at what the sources are
OUT_OF_LINE = 4.0  # standard deviations
SETTLE = 4  # rounds for decisions and readiness to agree; else the next tick goes on
GOES_OUT = {'stop': 'nothing goes out', 'hold': 'the last value goes out',
            'nan': 'NaN goes out', 'pass': 'the failed reading goes out'}


class Replacer:
    """
    One replacer on a node; it sends nothing until activated. Times are in ns.

    Public methods take `lock`, which is held while it is polled: they may come from any thread.
    """

    def __init__(self, node: Node, settings: Settings) -> None:
        """Open all topics; raises Refused."""
        self.node, self.settings, self.live = node, settings, settings.live
        self.lock = RLock()
        self.changed: Callable[[], Any] = _nothing  # called when a channel's source changes
        try:
            self.bank = Bank(settings.design, settings.rate, settings.max_age,
                             settings.jump_ahead)
        except ValueError as error:
            name, _, problem = str(error).partition(': ')
            problem, _, mend = problem.partition('; ')
            raise Refused([BadInput(node.get_fully_qualified_name(), name, problem, mend)]) \
                from None
        self.switch = Switch.of(settings.design, self.live.policies)
        self.log = Log(node.get_logger())
        self.why: dict[str, str] = {}  # by failed sensor: why it has no estimate
        self.counts = self.log.counts
        self._period = self.bank.period
        self._believed: frozenset[str] = frozenset()  # the faulty set that the bank knows
        self._sources: list[tuple[str, int]] = []  # as last seen, with the switches
        self._looked = 0  # when that was
        self._moved = 0.0  # when the clock did, by a steady one; of simulated time only
        self._rates = Rates()
        try:
            self._open(Polled())
        except RuntimeError as error:  # RCLError
            problem = str(error).partition(', at ')[0]
            raise Refused([BadInput(node.get_fully_qualified_name(), 'topics', problem,
                                    'give the topics other names')]) from None

    def _open(self, group: Polled) -> None:
        node, settings = self.node, self.settings
        simulated = None
        if node.get_parameter('use_sim_time').value:
            simulated = SimulatedTime(node, group)
        self.clock = NodeClock(round(settings.jump_ahead * 1e9),
                               None if simulated is None else simulated.read)
        self.ticks = Ticks(self.bank, self.clock)
        self.pace = self.ticks.pace
        self.intake = Intake(self.bank, self.clock, self.log)
        blend = Bumpless(self.live.time_constant)
        self.channels_of = {
            s.name: Channel(s.name, max(round(settings.max_age[s.name] * 1e9), 3 * self._period),
                            blend) for s in settings.sensors}
        self.streams = open_streams(node, group, settings.sensors, self.channels_of, self.clock,
                                    self.log.say, self.ticks.hold)
        self._watch(self.live)
        self.commands: list[tuple[Command, Reader, Subscription]] = [
            (c, Reader(c.kind, [c.accessor.path]), subscribe(node, group, c.kind, c.topic, LISTEN))
            for c in settings.commands]
        self.reports = Reports(
            node, group, settings.isolation_topic, kind_of(settings.isolation_type, DIAGNOSTICS),
            self.bank.sensors, settings.isolation_topic == DIAGNOSTICS_TOPIC,
            lambda text, subject: self.log.say(text, subject=subject))
        self.start = Start(
            self.reports, lambda: any(s.heard(name) for s in self.streams for name in s.names),
            lambda text: self.log.say(text, 'warning'))
        self.estimates = Estimates(node)
        takers: list[tuple[Subscription, Callable[[], int]]] = [
            *((s, self._take_isolation) for s in self.reports.subscriptions),
            *((s.subscription, partial(self.intake.take_readings, s)) for s in self.streams),
            *((s, partial(self.intake.take_commands, c, reader, s))
              for c, reader, s in self.commands)]
        if simulated is not None:
            takers.insert(0, (simulated.subscription, _nothing))  # the clock looks there itself
        self.subscriptions = tuple(subscription for subscription, _ in takers)
        self._takers = {s.handle.pointer: take for s, take in takers}

    def close(self) -> None:
        """Close all topics; nothing may poll any more."""
        with self.lock:
            for subscription in self.subscriptions:
                self.node.destroy_subscription(subscription)
            for stream in self.streams:
                self.node.destroy_publisher(stream.publisher)
            self.estimates.close(self.node)

    # ------------------------------------------------------------------- what may be asked of it

    def activate(self, patient: bool = False) -> None:
        """
        Send from now on. What came in meanwhile is old: it is read, but not sent.

        patient: wait until it is known what isolation said before.
        """
        with self.lock:
            self.clock.resume()
            self._moved = time.monotonic()
            if self.bank.time is not None:  # nobody polled it meanwhile
                self._restart()
                self.ticks.restart()
                self.pace.rest()
                self.intake.forget()
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
        for stream in self.streams:
            stream.active = active
        self.changed()

    def force(self, name: str) -> None:
        """Treat a sensor as faulty until released; raises ValueError, one line, and KeyError."""
        self._command(lambda: self.switch.force(name, self.clock.lasting()))

    def release(self, name: str) -> None:
        """End the force on a sensor; raises KeyError."""
        self._command(lambda: self.switch.release(name, self.clock.lasting()))

    def clear(self, name: str) -> None:
        """Believe a sensor that is healthy again; raises ValueError, one line, and KeyError."""
        self._command(lambda: self.switch.clear(name, self.clock.lasting()))

    def reset(self) -> None:
        """Start all virtual sensors anew, forget forces, holds and latches."""
        with self.lock:
            self._restart()
            self._command(lambda: self.switch.reset(self.clock.lasting()))

    def apply(self, live: Live) -> None:
        """Take over parameters that may change."""
        with self.lock:
            self._watch(live)
            if live.time_constant != self.live.time_constant:
                for channel in self.channels_of.values():
                    channel.blend = channel.blend.with_time_constant(
                        live.time_constant, self.clock.lasting())
            self.live = live
            self._command(lambda: self.switch.with_policies(live.policies))

    def channels(self) -> list[ChannelState]:
        """Return how each channel is now."""
        with self.lock:
            rates = self._rates.look({name: c.readings for name, c in self.channels_of.items()},
                                     time.monotonic_ns())
            return channel_states(self, rates)

    def clock_age(self) -> float:
        """Return for how many seconds of steady time simulated time has stood still; else 0."""
        return time.monotonic() - self._moved if self.clock.simulated else 0.0

    def health(self) -> Health:
        """Return how the loop keeps up."""
        with self.lock:
            return health(self)

    def _watch(self, live: Live) -> None:
        """Note whose silence counts."""
        self._watched = [(name, stream) for stream in self.streams for name in stream.names
                         if live.policies[name].silent_is_faulty]

    def _command(self, act: Callable[[], Switch]) -> None:
        with self.lock:
            self.switch = act()
            self._decide()

    # ------------------------------------------------------------------------------ one round

    def poll(self, ready: Iterable[int] | None = None) -> int:
        """
        Take what has arrived, tick if it is time; return how many messages.

        ready: pointers of the subscriptions to look at; all by default. By the system's clock a
        tick comes first, so that it is never late for what has just arrived; by a simulated one
        last, because time moves on only when all has been said.
        """
        with self.lock:
            if self.start.is_over():
                self._set_active(True)
            before = self.clock.now
            jump = self.clock.look()
            if self.clock.simulated and self.clock.now != before:
                self._moved = time.monotonic()
            if jump:
                self._jumped(jump)
            if self.clock.now >= self.ticks.due and not self.clock.simulated:
                self._tick()
            taken = 0
            for pointer in self._takers if ready is None else ready:
                taken += self._takers[pointer]()
            if self.clock.simulated:
                self._tick()
            return taken

    def _jumped(self, jump: int) -> None:
        """Start anew: what was read on the old time says nothing of the new one."""
        self.log.say(f'the clock jumped {"ahead" if jump > 0 else "back"} by '
                     f'{abs(jump) * 1e-9:.1f} s; all virtual sensors start anew', 'warning',
                     'clock')
        self._restart()
        self.ticks.restart()
        self.intake.forget()
        if jump < 0:
            for stream in self.streams:
                stream.forget()

    def _restart(self) -> None:
        self.bank.reset()
        self.bank.distrust(self._believed)

    # ------------------------------------------------------------------------ what comes in

    def _take_isolation(self) -> int:
        reported = self.reports.take(self.switch.reported)
        if reported == self.switch.reported:
            return 0
        names = ', '.join(s for s in self.bank.sensors if s in reported)
        self.log.say(f'faulty sensors: {names or "none"}', 'info', 'faulty')
        self._command(lambda: self.switch.isolate(reported, self.clock.lasting()))
        return 0

    # ------------------------------------------------------------------------------ decisions

    def _ready(self, fault_set: tuple[str, ...], name: str) -> bool:
        return self.bank.ready(fault_set, name) and not self._too_uncertain(fault_set, name)

    def _too_uncertain(self, fault_set: tuple[str, ...], name: str) -> bool:
        limit = self.live.max_deviation[name]
        return limit > 0.0 and not self.bank.deviation(fault_set, name) <= limit

    def _why_not(self, fault_set: tuple[str, ...], name: str) -> str | None:
        reason = self.bank.why_not(fault_set, name)
        if reason is None and self._too_uncertain(fault_set, name):
            return (f'its standard deviation {self.bank.deviation(fault_set, name):.3g} is above '
                    f'max_deviation {self.live.max_deviation[name]:.3g}')
        return None if reason is None else str(reason)

    def _decide(self) -> list[Stream]:
        """Let the switch decide, the bank follow; return the streams that changed and so spoke."""
        self.ticks.catch_up()
        before = {s: (d.source, d.fault_set) for s, d in self.switch.decisions.items()}
        for _ in range(SETTLE):  # what is read decides who is ready, and that who is read
            if self.switch.faulty != self._believed:
                self._believed = self.switch.faulty
                self.bank.distrust(self._believed)
            self.switch = self.switch.decide(self.clock.lasting(), self._ready, self._why_not)
            if self.switch.faulty == self._believed:
                break
        at = self.ticks.time
        changed = {s for s, d in self.switch.decisions.items()
                   if (d.source, d.fault_set) != before[s]}
        spoken = [stream for stream in self.streams if not changed.isdisjoint(stream.names)] \
            if changed else []
        for stream in spoken:
            self._safely(stream, self._speak, stream, at, True)
        self.estimates.send(at)
        if changed:
            self._look_for_change()
        return spoken

    def _silence(self) -> None:
        """Tell the switch who has fallen silent, of those whose silence counts."""
        now, before = self.clock.now, self.switch.silent
        silent = frozenset(
            name for name, stream in self._watched if not stream.fresh(name, now)
            and (stream.heard(name) or name in before))
        if silent != before:
            self.switch = self.switch.silence(silent, self.clock.lasting())

    # ----------------------------------------------------------------------- what goes out

    def _tick(self) -> None:
        """Step the bank as far as time has come, and speak for the failed."""
        for at in self.ticks.now(self._believed):
            if self._watched:
                self._silence()
            idle = not (self.switch.faulty or self.switch.forced)
            self.ticks.advance(at, idle)
            if not idle:
                spoken, at = self._decide(), self.ticks.time
                for stream in self.streams:
                    if stream not in spoken and \
                            not self.switch.faulty.isdisjoint(stream.names):
                        self._safely(stream, self._speak, stream, at)
                self.estimates.send(at)
            if not 0 <= self.clock.now - self._looked < LOOK:
                self._look_for_change()

    def _look_for_change(self) -> None:
        self._looked = self.clock.now
        sources = [(source(self, stream, c.name), c.switches)
                   for stream in self.streams for c in stream.channels]
        if sources != self._sources:
            self._sources = sources
            self.changed()

    def _speak(self, stream: Stream, at: int, at_once: bool = False) -> None:
        """Send what stands in for the failed channels of a stream at the time of the state."""
        substitutes: dict[str, Substitute] = {}
        passing = set()
        for channel in stream.channels:
            name, decision = channel.name, self.switch.decisions[channel.name]
            if decision.source is Source.REAL:
                self.why.pop(name, None)
                continue
            substitute = self._estimate(channel, decision.fault_set) \
                if decision.source is Source.VIRTUAL else None
            if substitute is not None:
                self.why.pop(name, None)
            else:
                channel.stop(self.clock.lasting())
                action = self.live.without_estimate
                if action == 'hold' and name not in self.intake.held:
                    action = 'stop'
                reason = decision.reason if decision.source is Source.NONE else \
                    self._why_not(decision.fault_set, name)
                self.why[name] = f'{reason}; {GOES_OUT[action]}'
                if action == 'pass':
                    passing.add(name)
                    continue
                substitute = Substitute({'stop': None, 'nan': math.nan}.get(
                    action, self.intake.held.get(name)))
            substitutes[name] = substitute
        stream.fail(frozenset(substitutes), frozenset(passing))
        if substitutes:
            self._compose(stream, substitutes, at, at_once)

    def _compose(self, stream: Stream, substitutes: dict[str, Substitute], at: int,
                 at_once: bool) -> None:
        for name, trouble in (self._sent(
                stream, stream.compose, at, substitutes, at_once) or {}).items():
            reason = self.why.get(name, '').partition('; ')[0]
            self.why[name] = f'{trouble}; {GOES_OUT["stop"]}' if trouble else \
                f'{reason}; {GOES_OUT["nan"]}'  # because others are in the message
        lasting = self.clock.lasting(at)
        for channel in stream.channels:
            substitute = substitutes.get(channel.name)
            if substitute is not None and substitute.fault_set is not None \
                    and channel.sent == lasting:
                self.intake.held[channel.name] = channel.value
                self.estimates.add(channel, substitute.deviation, channel.blend.left(lasting))

    def _estimate(self, channel: Channel, fault_set: tuple[str, ...]) -> Substitute | None:
        value = self.bank.estimate(fault_set, channel.name)
        if value is None:
            return None
        above, deviation = None, self.bank.deviation(fault_set, channel.name)
        if channel.source == REAL:  # what went out last may be the fault
            known = self.bank.disagreement(fault_set, channel.name)
            above = math.nan if known is None else known
        elif channel.source == VIRTUAL and fault_set != channel.fault_set:
            entry = self.settings.design.entries[channel.fault_set, channel.name]
            fault = isinstance(entry, VirtualSensor) and self._believed.intersection(entry.reads)
            left = channel.value - channel.blend.left(self.clock.lasting()) - value
            if fault and abs(left) > OUT_OF_LINE * deviation:
                above = math.nan  # what it read was faulty already
        return Substitute(value, fault_set, deviation, above)

    def _sent(self, stream: Stream, send: Callable[..., Any], *given: Any) -> Any:
        """Let a stream send; what the middleware refuses is counted and said."""
        try:
            return send(*given)
        except RuntimeError as error:  # RCLError
            self.log.count(stream.names[0], 'not sent: ' + str(error).partition(', at ')[0])
            return None

    def _safely(self, stream: Stream, act: Callable[..., None], *given: Any) -> None:
        """Let nothing that goes wrong with one stream end the others."""
        try:
            act(*given)
        except Exception as error:
            self.log.count(stream.names[0], f'a mistake of this node ({type(error).__name__})')
            self.log.say(traceback.format_exc(), subject=(stream.names, type(error)))


def _nothing() -> int:
    """Nobody wants to know."""
    return 0
