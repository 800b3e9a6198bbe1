"""
The engine: what comes from sensors goes in, what is to go out in their place comes out.

It knows no ROS and has no clock. Readings, commands, what isolation says, requests and the time
are events: each is a call, with plain data as its arguments. Messages to be made come back as
`Composition`, what people should hear is taken with `remarks`, what there is to see with
`snapshot`. The same events lead to the same results, from a running node or from a recording.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
import traceback
from types import MappingProxyType

from vsensor_ros.bank import Bank
from vsensor_ros.engine.bumpless import Bumpless
from vsensor_ros.engine.channel import Channel
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.commands import Commands
from vsensor_ros.engine.decision import Source
from vsensor_ros.engine.events import (
    Composition,
    Forward,
    Functional,
    IsolationReport,
    Message,
    Remark,
    Reserve,
    together,
    Token,
)
from vsensor_ros.engine.fault_sizes import SizeNow
from vsensor_ros.engine.intake import Intake
from vsensor_ros.engine.own_isolator import Learnt, NOBODY, OwnIsolator, SOURCE
from vsensor_ros.engine.settings import Live, Setup
from vsensor_ros.engine.stand_in import StandIn
from vsensor_ros.engine.state import EngineState, stopped
from vsensor_ros.engine.stream import Stream, UNREADABLE
from vsensor_ros.engine.switch import Switch
from vsensor_ros.engine.ticks import Ticks
from vsensor_ros.engine.view import by_channel, View
from vsensor_ros.isolator import Verdict
from vsensor_ros.reason import Reason

LOOK = 50_000_000  # ns between two looks at what the sources are
SETTLE = 4  # rounds for decisions and readiness to agree; else the next tick goes on

Messages = list[Composition]


class Engine:
    """Decides who serves each channel, and estimates. Times are in ns, steady ones in s."""

    def __init__(self, setup: Setup) -> None:
        """Begin with all sensors healthy and silent; raises ValueError, one line."""
        self._design = setup.design
        self._bank = Bank(setup.design, setup.rate, setup.max_age, setup.jump_ahead,
                          setup.command_ends, setup.guard)
        self._switch = Switch.of(setup.design, setup.live.policies)
        self._clock = Clock(round(setup.jump_ahead * 1e9), setup.simulated)
        self._ticks = Ticks(self._bank, self._clock)
        self._own = None if setup.isolator is None or setup.isolator.mode == 'off' \
            else OwnIsolator(setup)
        self._intake = Intake(self._bank, self._clock, self._own)
        self._commands = Commands(setup.design.inputs, self._bank, self._clock, self._intake)
        self._stand_in = StandIn(setup.design, self._bank, self._clock, setup.live,
                                 self._intake.held, self._stream_of)
        blend = Bumpless(setup.live.time_constant)
        self._channels = {
            s: Channel(s, max(round(setup.max_age[s] * 1e9), 3 * self._bank.period), blend,
                       angle=self._bank.angles.get(s))
            for s in setup.design.sensors}
        self._streams = [
            Stream(i, plan, [self._channels[s] for s in plan.names], self._clock,
                   self._bank.period, self._bank.recall, self._intake.say, self._intake.count)
            for i, plan in enumerate(setup.streams)]
        self._believed: frozenset[str] = frozenset()  # the faulty set that the bank knows
        self._isolated: dict[str, int] = {}  # by reported sensor: since when, as time lasts
        self._others = NOBODY  # what others who isolate say
        self._starts = 0
        self._moved = 0.0  # when simulated time did, by a steady clock
        self._turned = False  # a decision has changed
        self._found = False  # the own isolator says something else
        self._looked = 0  # when it was seen last what the channels are
        self._seen: list[tuple[str, int]] = []  # and what they were, with the switches
        self._view = View(setup.design, self._bank, self._clock, self._streams, self._stand_in)
        self._watch()

    @property
    def now(self) -> int:
        """The time that the engine was told last; 0 before it was told any."""
        return self._clock.now

    @property
    def due(self) -> int:
        """When, by the system's clock, it should be asked for `ticks` again."""
        return self._ticks.due

    @property
    def lead(self) -> int:
        """By how much a message may be ready before it is due."""
        return self._ticks.lead

    # --------------------------------------------------------------------------- time and life

    def look(self, now: int | None, steady: float) -> None:
        """Take the time; None: the clock says nothing new. After a jump all starts anew."""
        before = self._clock.now
        jump = self._clock.look(now)
        if self._clock.now != before:
            self._moved = steady
        if not before or jump > 0:  # what came before the clock began came at 0
            for stream in self._streams:
                stream.leap(jump or self._clock.now)
        if not jump:
            return
        self._intake.say('warning', Reason.of(
            'clock jumped ahead' if jump > 0 else 'clock jumped back',
            seconds=abs(jump) * 1e-9), 'clock')
        self._start_anew()
        if jump < 0:
            for stream in self._streams:
                stream.forget()

    def resume(self, now: int | None, steady: float) -> None:
        """Take the time after a rest in which nobody told it; the virtual sensors start anew."""
        if not self._clock.now:
            self.look(now, steady)
        self._clock.resume(now)
        self._moved = steady
        if self._bank.time is not None:
            self._start_anew()

    def activate(self, active: bool = True) -> None:
        """Send from now on, or nothing more. What came in before is old, and not sent."""
        for stream in self._streams:
            stream.active = active

    def _start_anew(self) -> None:
        self._restart()
        self._ticks.restart()
        self._intake.forget()
        self._commands.forget()
        if self._own is not None:
            self._own.restart()

    def _restart(self) -> None:
        self._starts += 1
        self._bank.reset()
        self._bank.distrust(self._believed)

    # ---------------------------------------------------------------------------- what comes in

    def judge(self, stream: int, message: Message, token: Token,
              related: int | None = None) -> Forward | Reason | None:
        """
        Tell whether a message of a stream goes on. Then let the engine `learn` from it.

        Forward: now, perhaps with some numbers changed. None: it is kept for the messages that
        are composed. A reason: it should go on, but does not; that is counted. token: stands for
        the message in a Composition. related: see `Stream.judge_foreign`.
        """
        where = self._streams[stream]
        return where.judge_foreign(message, token, related) if message.foreign else \
            where.judge(message, token)

    def failed_templates(self, stream: int) -> list[tuple[int, Token]] | None:
        """Return what a foreign message may be related to; None, mostly: nothing has failed."""
        return self._streams[stream].failed_templates()

    def learn(self, stream: int, message: Message, received: int) -> None:
        """Take what a message says. received: its time when it has no stamp."""
        self._intake.readings(self._streams[stream], message, received)

    def unreadable(self, stream: int) -> None:
        """Note that something arrived on a stream that is no message."""
        where = self._streams[stream]
        where.lacks(UNREADABLE, self._clock.now)
        self.count(where.names[0], UNREADABLE)

    def command(self, name: str, value: float | Reason, stamp: int | None, received: int) -> None:
        """Take a command; it counts from its stamp, or from when it was received: `Commands`."""
        self._commands.take(name, value, stamp, received)

    def count(self, name: str, why: Reason) -> None:
        """Count, and say now and then, what of a channel was not used or not sent, and why."""
        self._intake.count(name, why)

    def leave_out(self, name: str) -> None:
        """Count a message for a channel that came from a publisher who was not chosen."""
        self._intake.count(name, Reason('not chosen'), quietly=True)

    # ------------------------------------------------------------------------------- requests

    def isolate(self, report: IsolationReport) -> Messages:
        """Take what others who isolate say in all: see `together`."""
        self._others = report
        return self._command(self._isolate) if self._new_report() else []

    def _new_report(self) -> bool:
        """Put together what all say who isolate; tell whether others are faulty than before."""
        now, lasting = self._clock.now, self._clock.lasting()
        faulty = together(*(report for _, report in self._reports())).faulty
        self._isolated = {  # a time from before the clock began is now
            s: self._isolated.get(s, lasting - (max(0, now - since) if since else 0))
            for s, since in faulty.items() if s in self._channels}
        if self._isolated.keys() == self._switch.reported:
            return False
        names = ', '.join(s for s in self._design.sensors if s in self._isolated)
        self._intake.say('info', Reason.of('faulty sensors', names=names or 'none'), 'faulty')
        return True

    def _reports(self) -> list[tuple[str, IsolationReport]]:
        """Return what each says who isolates, with what it is called."""
        own = [] if self._own is None else [(SOURCE, self._own.report())]
        return [('isolation', self._others), *own]

    def _blamed(self) -> dict[str, tuple[str, ...]]:
        """Return by whom each sensor is called faulty."""
        said = self._reports()
        return {s: tuple(source for source, report in said if s in report.faulty)
                for s in self._isolated}

    def _isolate(self, time: int) -> Switch:
        return self._switch.isolate(frozenset(self._isolated), time)

    def force(self, name: str) -> Messages:
        """Treat a sensor as faulty until released; raises CannotServe and KeyError."""
        return self._command(
            lambda time: self._switch.force(name, time, self._stand_in.never))

    def release(self, name: str) -> Messages:
        """End the force on a sensor; raises KeyError."""
        return self._command(lambda time: self._switch.release(name, time))

    def clear(self, name: str) -> Messages:
        """
        Believe a sensor that is healthy again; raises ValueError, one line, and KeyError.

        What the engine's own isolator has against it is forgotten; what others say is not.
        """
        self._forgive((name,))
        return self._command(lambda time: self._switch.clear(name, time))

    def reset(self) -> Messages:
        """Start all virtual sensors anew, forget forces, holds, latches and own isolation."""
        self._restart()
        if self._own is not None:
            self._own.restart()  # what it has not judged yet is of before
        self._forgive(self._design.sensors)
        return self._command(lambda time: self._switch.reset(time))

    def _forgive(self, names: tuple[str, ...]) -> None:
        if self._own is not None and self._own.clear(names) and self._new_report():
            self._switch = self._isolate(self._clock.lasting())

    def apply(self, live: Live) -> Messages:
        """Take over settings that may change."""
        if live.time_constant != self._stand_in.live.time_constant:
            for channel in self._channels.values():
                channel.blend = channel.blend.with_time_constant(
                    live.time_constant, self._clock.lasting())
        self._stand_in.apply(live)
        self._watch()
        return self._command(lambda _: self._switch.with_policies(live.policies))

    def _watch(self) -> None:
        """Note whose silence counts."""
        self._watched = [(name, stream) for stream in self._streams for name in stream.names
                         if self._stand_in.live.policies[name].silent_is_faulty]

    def _command(self, act: Callable[[int], Switch]) -> Messages:
        self._switch = act(self._clock.lasting())
        return self._decide()[0]

    def _stream_of(self, name: str) -> Stream | None:
        """Return where a sensor is heard; None of a command."""
        return next((stream for stream in self._streams if name in stream.names), None)

    # ------------------------------------------------------------------------------ decisions

    def ticks(self) -> Iterator[int]:
        """Yield the times of the ticks that are due now; call `tick` for each before the next."""
        return self._ticks.now(self._believed)

    def send_at(self, at: int) -> int:
        """Return when the messages of a tick are due; 0: at once."""
        return self._ticks.send_at(at)

    def tick(self, at: int) -> Messages:
        """Step the virtual sensors to a tick, and speak for the failed."""
        if self._watched:
            self._silence()
        if self._own is not None and self._own.step(self._clock.now):
            self._turned = self._found = True
            for why, subject in self._own.news():
                self._intake.say('warning', why, subject)
            if self._new_report():
                self._switch = self._isolate(self._clock.lasting())
        lag = self._lag()
        self._ticks.advance(at, lag)
        if lag is None:
            return []
        made, spoken = self._decide()
        at = self._ticks.time
        for stream in self._streams:
            if stream not in spoken and not self._switch.faulty.isdisjoint(stream.names):
                made += self._speak(stream, at)
        return made

    def _lag(self) -> int | None:
        """Return by how much older than a tick its estimates are wanted; None: nobody asks."""
        names = self._switch.faulty | self._switch.forced
        if not names:
            return None
        return min((stream.composer.lag(name) for stream in self._streams for name in stream.names
                    if name in names), default=None)

    def _silence(self) -> None:
        """Tell the switch who has fallen silent, of those whose silence counts."""
        before = self._switch.silent
        silent = frozenset(
            name for name, stream in self._watched if not stream.heard.fresh(name)
            and (stream.heard.ever(name) or name in before))
        if silent != before:
            self._switch = self._switch.silence(silent, self._clock.lasting())

    def _decide(self) -> tuple[Messages, list[Stream]]:
        """Let the switch decide, the bank follow; return what the streams that changed say."""
        self._ticks.catch_up(self._lag() or 0)
        before = {s: (d.source, d.fault_set) for s, d in self._switch.decisions.items()}
        for _ in range(SETTLE):  # what is read decides who is ready, and that who is read
            if self._switch.faulty != self._believed:
                self._believed = self._switch.faulty
                self._bank.distrust(self._believed, self._ticks.time, self._onsets())
                self._switch = self._switch.untold()
            self._switch = self._switch.decide(self._clock.lasting(), self._stand_in)
            if self._switch.faulty == self._believed:
                break
        changed = {s for s, d in self._switch.decisions.items()
                   if (d.source, d.fault_set) != before[s]}
        if not changed:
            return [], []
        self._turned = True
        spoken = [stream for stream in self._streams if not changed.isdisjoint(stream.names)]
        at = self._ticks.time
        return [m for stream in spoken for m in self._speak(stream, at, True)], spoken

    def _onsets(self) -> dict[str, int]:
        """Return since when, on the clock, isolation says that sensors are faulty."""
        now, lasting = self._clock.now, self._clock.lasting()
        return {s: now - (lasting - since) for s, since in self._isolated.items()}

    def _speak(self, stream: Stream, at: int, at_once: bool = False) -> Messages:
        """Return what stands in for failed channels; a mistake in one stream ends no other."""
        try:
            return self._stand_in.speak(stream, self._switch.decisions, self._believed, at,
                                        at_once)
        except Exception as error:
            self.count(stream.names[0], Reason.of('mistake', error=type(error).__name__))
            self._intake.say('error', Reason.of('trace', text=traceback.format_exc()),
                             (stream.names, type(error)))
            return []

    def done(self, composition: Composition, trouble: Reason | None = None) -> None:
        """
        Note that a composed message went out, or why it did not.

        'not sent' and 'mistake' are counted and may not be so the next time; any other trouble is
        why its channels have no source.
        """
        stream = self._streams[composition.stream]
        if trouble is None:
            self._stand_in.sent(stream, composition)
        elif trouble.code in ('not sent', 'mistake'):
            self.count(stream.names[0], trouble)
        else:
            self._stand_in.failed(stream, composition, trouble)

    # ----------------------------------------------------------------------- what can be seen

    @property
    def verdict(self) -> Verdict | None:
        """What the engine's own isolator says; None: there is none."""
        return None if self._own is None else self._own.verdict

    def fault_sizes(self) -> tuple[int, list[SizeNow]]:
        """Return how large each fault is, and of which time; 0: nothing is known."""
        sizes = None if self._own is None else self._own.sizes
        return (0, []) if sizes is None or sizes.time is None else (
            sizes.time, sizes.now(self._switch.faulty))

    def learnt(self) -> Learnt | None:
        """Return what the engine's own isolator has learnt, to be saved; None: there is none."""
        return None if self._own is None else self._own.learnt()

    def go_on_from(self, path: str | Path, design_hash: str) -> None:
        """Let the own isolator go on from what it had learnt; raises BadInput, changes nothing."""
        if self._own is not None:
            self._own.go_on(path, design_hash)

    def remarks(self) -> list[Remark]:
        """Return what is to be said to people, once."""
        return self._intake.remarks()

    def changed(self) -> bool:
        """
        Tell whether a channel, or what the own isolator says, is another since this was asked.

        It looks at once after a decision, else every LOOK.
        """
        if not self._turned and 0 <= self._clock.now - self._looked < LOOK:
            return False
        found, self._found = self._found, False
        self._turned, self._looked = False, self._clock.now
        before, self._seen = self._seen, self._view.sources(self._switch)
        return found or self._seen != before

    def reserve(self, name: str) -> tuple[tuple[str, ...], float] | None:
        """
        Return who would speak for a sensor if it failed now; None: nobody.

        That is the fault set of a virtual sensor, and its standard deviation [unit of the sensor].
        """
        would = self._view.would(self._switch, name)
        return None if would.source is not Source.VIRTUAL else \
            (would.fault_set, self._bank.deviation(would.fault_set, name))

    @property
    def state_time(self) -> int | None:
        """Time of the virtual sensors' last step; None before the first."""
        return self._bank.time

    def reserves(self) -> list[Reserve]:
        """Return what could be said in place of each healthy sensor, at `state_time`."""
        return self._view.reserves(self._switch)

    def functionals(self) -> list[Functional]:
        """Return what is wanted besides sensors, at `state_time`; faults, too."""
        return self._view.functionals(self._switch)

    def heard_any(self) -> bool:
        """Tell whether any sensor has spoken, since the clock went back."""
        return any(stream.heard.ever(name) for stream in self._streams for name in stream.names)

    def snapshot(self, steady: float) -> EngineState:
        """
        Return how everything is; steady: now, by a clock that never jumps.

        What is said of the virtual sensors is as of their last step: while all sensors are healthy
        that may be some ticks ago.
        """
        still = steady - self._moved if self._clock.simulated else 0.0
        counts = by_channel(self._intake.counts().items())
        return EngineState(
            self._view.channels(self._switch, self._isolated, self._blamed(), counts,
                                stopped(still)),
            tuple(s for s in self._design.sensors if s in self._switch.faulty),
            tuple(s for s in self._design.sensors if s in self._others.knows),
            self._ticks.count, self._ticks.left_out, self._stand_in.estimates,
            MappingProxyType(dict(self._clock.jumps)),
            self._starts + sum(self._bank.jumps.values()), still, self._commands.states(counts))
