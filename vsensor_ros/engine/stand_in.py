"""What goes out in place of failed sensors: estimates, or what there is without them."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
import math

from vsensor_ros.bank import Bank, Disagreement
from vsensor_ros.engine.channel import Channel, REAL, VIRTUAL
from vsensor_ros.engine.choice import BETTER
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.decision import Decision, Source
from vsensor_ros.engine.events import Composition, Substitute
from vsensor_ros.engine.limits import Limits
from vsensor_ros.engine.settings import Live
from vsensor_ros.engine.stream import Stream
from vsensor_ros.engine.wanted import Wanted
from vsensor_ros.observers import Design, Refusal
from vsensor_ros.reason import Reason

OUT_OF_LINE = 4.0  # standard deviations
LATE = 0.1  # s that stamps may be off before one speaks of clocks
UNKNOWN = Disagreement(math.nan, math.nan)


class StandIn:
    """Speaks for failed channels, without a step where one source follows another."""

    def __init__(self, design: Design, bank: Bank, clock: Clock, live: Live,
                 held: dict[str, float], stream_of: Callable[[str], Stream | None]) -> None:
        """
        Begin with nothing said.

        held: by sensor the last value worth holding, which this keeps up to date. stream_of: where
        a sensor is heard, None of a command.
        """
        self._design = design
        self.apply(live)
        self.estimates = 0  # that went out
        self._bank, self._clock, self._held = bank, clock, held
        self._stream_of = stream_of

    def apply(self, live: Live) -> None:
        """Take over settings that may change."""
        self.live = live
        self._limits = Limits(self._design, live.max_deviation)

    def ready(self, fault_set: tuple[str, ...], name: str) -> bool:
        """Tell whether a virtual sensor may serve."""
        return self._bank.ready(fault_set, name) and self._exceeded(fault_set, name) is None

    def converges(self, fault_set: tuple[str, ...], name: str) -> bool:
        """Tell whether one that has not forgotten its start knows how little is left of it."""
        return self._bank.converging(fault_set, name) \
            and self._bank.deviation(fault_set, name) < math.inf \
            and self._exceeded(fault_set, name) is None

    def deviation(self, fault_set: tuple[str, ...], name: str) -> float:
        """Return the standard deviation of an estimate now; infinite when not known."""
        return self._bank.deviation(fault_set, name)

    def why_not(self, fault_set: tuple[str, ...], name: str) -> Reason | None:
        """Return why a virtual sensor may not serve, or None when it may."""
        reason = self._bank.why_not(fault_set, name)
        return self._exceeded(fault_set, name) if reason is None else self._told_apart(reason)

    def why_not_again(self, fault_set: tuple[str, ...], name: str) -> Reason | None:
        """Return why one that was given up is not clearly good enough by now; None: it is."""
        reason = self.why_not(fault_set, name)
        if reason is None and (close := self._exceeded(fault_set, name, BETTER)) is not None:
            reason = Reason.of('not clearly good', limit=close.fact('limit'),
                               deviation=self.deviation(fault_set, name))
        return reason

    def never(self, fault_set: tuple[str, ...], name: str) -> Reason | None:
        """Return why a virtual sensor cannot serve, however long one waits; None: it may."""
        if self._bank.warm_up(fault_set, name) == math.inf:
            lack = self._bank.why_not(fault_set, name)
            return lack if lack is not None and lack.code == 'several rows' else \
                Reason('start unknown')
        if self._limits.largest(name, self._bank.grows(fault_set, name)) is None:
            return Reason('no limit')
        return None

    def remaining(self, fault_set: tuple[str, ...], name: str) -> float:
        """Return how long [s] a virtual sensor is good enough yet; inf: its end is not to come."""
        entry = self._bank.entry(fault_set, name)
        if entry is None or isinstance(entry, Refusal):
            return math.inf
        limit = self._limits.largest(name, self._bank.grows(fault_set, name))
        return math.inf if limit is None else self._bank.remaining(fault_set, name, limit)

    def _exceeded(self, fault_set: tuple[str, ...], name: str,
                  share: float = 1.0) -> Reason | None:
        """Return why an estimate is not within a share of its limits, or None when it is."""
        entry = self._bank.entry(fault_set, name)
        if entry is None or isinstance(entry, Refusal):
            return None

        def measured() -> float:
            found = self._bank.measured(fault_set, name)
            return math.nan if found is None else found.error
        return self._limits.exceeded(entry, name, self._bank.deviation(fault_set, name), measured,
                                     self._bank.grows(fault_set, name), share)

    def _told_apart(self, reason: Reason) -> Reason:
        """Tell an input that is silent from one whose stamps are of another clock."""
        if reason.code not in ('input silent', 'no reading yet'):
            return reason
        name = reason.fact('name')
        stream = self._stream_of(name)
        silence = None if stream is None else stream.heard.silence(name)
        if stream is None or silence is None:
            return reason
        ahead = stream.ahead(name) * 1e-9
        if abs(ahead) < LATE and reason.code == 'input silent':  # nothing of it went out, say
            ahead = silence * 1e-9 - reason.fact('seconds')
        if not stream.heard.fresh(name):
            return Reason.of('input silent', name=name, seconds=silence * 1e-9)
        if abs(ahead) < LATE:
            return reason
        return Reason.of('input of another clock', name=name, seconds=ahead,
                         clock=self._clock.now * 1e-9)

    def speak(self, stream: Stream, decisions: Mapping[str, Decision],
              distrusted: Collection[str], at: int, at_once: bool = False) -> list[Composition]:
        """
        Return what stands in for the failed channels of a stream at the time of a tick.

        distrusted: sensors whose readings may have been faulty. at_once: see `Stream.compose`.
        """
        wanted: dict[str, Wanted] = {}
        passing = set()
        for channel in stream.channels:
            name, decision = channel.name, decisions[channel.name]
            if decision.source is Source.REAL:
                if name in stream.failed or name in stream.passing:
                    channel.why = None
                continue
            estimate = self._estimate(channel, decision.fault_set, distrusted) \
                if decision.source is Source.VIRTUAL else None
            if estimate is not None:
                channel.why = None
                wanted[name] = estimate
                continue
            action = self._without_estimate(channel, decision)
            if action == 'pass':
                passing.add(name)
            else:
                wanted[name] = Wanted({'stop': None, 'nan': math.nan}.get(
                    action, self._held.get(name)))
        waited = stream.fail(frozenset(wanted), frozenset(passing))
        if not wanted:
            return waited
        made, troubles = stream.compose(at, wanted, at_once)
        for channel in stream.channels:
            if channel.name in troubles:
                _note(channel, troubles[channel.name])
        return waited + made

    def _estimate(self, channel: Channel, fault_set: tuple[str, ...],
                  distrusted: Collection[str]) -> Wanted | None:
        value = self._bank.estimate(fault_set, channel.name)
        if value is None:
            return None
        above, deviation = None, self._bank.deviation(fault_set, channel.name)
        if channel.source == REAL:  # what went out last may be the fault
            above = self._bank.disagreement(fault_set, channel.name) or UNKNOWN
        elif channel.source == VIRTUAL and fault_set != channel.fault_set:
            old = self._bank.entry(channel.fault_set, channel.name)
            reads = () if old is None or isinstance(old, Refusal) else old.reads
            left = channel.shortest(
                channel.value - channel.blend.left(self._clock.lasting()) - value)
            if not set(distrusted).isdisjoint(reads):  # what it read may be the fault
                above = UNKNOWN if abs(left) > OUT_OF_LINE * deviation else Disagreement(0.0, left)
        entry = self._bank.entry(fault_set, channel.name)
        assert entry is not None and not isinstance(entry, Refusal)  # for it has an estimate
        return Wanted(value, fault_set, deviation, self._bank.interval(fault_set, channel.name),
                      entry.grade, above, self._bank.run(fault_set, channel.name))

    def _without_estimate(self, channel: Channel, decision: Decision) -> str:
        """Note that nobody serves a channel, and why; return what goes out instead."""
        channel.stop(self._clock.lasting())
        action = self.live.without_estimate
        if action == 'hold' and channel.name not in self._held:
            action = 'stop'
        why = decision.reason if decision.source is Source.NONE else \
            self.why_not(decision.fault_set, channel.name)
        channel.why = Reason.of('instead', why=why or Reason('ready just now'),
                                instead=Reason(action))
        return action

    def sent(self, stream: Stream, composition: Composition) -> None:
        """Note that a message went out."""
        stream.composer.sent(composition)
        for i, field in composition.fields:
            if not isinstance(field, Substitute):
                continue
            if field.fault_set is not None:
                self._held[stream.names[i]] = field.value
                self.estimates += 1
            elif (why := stream.channels[i].why) is not None and math.isnan(field.value):
                # nothing was to go out, but it shares its message with others
                stream.channels[i].why = Reason.of('instead', why=why.fact('why'),
                                                   instead=Reason('nan'))

    def failed(self, stream: Stream, composition: Composition, trouble: Reason) -> None:
        """Note that a message cannot be made, so that its channels have no source."""
        stream.composer.trouble([stream.names[i] for i, _ in composition.fields], trouble)
        for i, field in composition.fields:
            if isinstance(field, Substitute):
                _note(stream.channels[i], trouble)


def _note(channel: Channel, trouble: Reason) -> None:
    """Note why a failed channel has no message."""
    channel.why = Reason.of('instead', why=trouble, instead=Reason('stop'))
