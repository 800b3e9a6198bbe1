"""
One stream of messages: which of them go on, and what is to stand in for those that do not.

A message with no failed channel in it goes on as it came, whatever its stamp; only what was
composed lately must be followed by something newer. While a channel of a sender is failed, its
messages are composed: the latest live one is the template, the failed channels are written into
it, and every other channel is what it last said. All times are in ns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import math
from types import MappingProxyType

from vsensor_ros.engine.apart import Apart
from vsensor_ros.engine.channel import Channel, REAL, VIRTUAL
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.events import (
    AS_IT_CAME,
    Composition,
    Forward,
    Message,
    Substitute,
    Token,
)
from vsensor_ros.engine.sender import Sender, Senders
from vsensor_ros.engine.settings import StreamPlan
from vsensor_ros.engine.wanted import Recall, recalled, Wanted
from vsensor_ros.engine.withheld import Withheld
from vsensor_ros.reason import Reason

UNREADABLE, NOT_NEWER, ONLY_NAN, NEVER_SEEN = map(Reason, (
    'unreadable', 'not newer', 'only NaN', 'never seen'))
ABSENT = 'not in the message'  # code of the reason why a message has no value of a channel


class Stream:
    """The messages of one input, on their way to one output."""

    def __init__(self, index: int, plan: StreamPlan, channels: Sequence[Channel], clock: Clock,
                 period: int, recall: Recall, say: Callable[[str, Reason], object],
                 count: Callable[[str, Reason], object]) -> None:
        """
        Begin with nothing heard; channels: those of the plan, in its order.

        period: of the ticks. recall: what was estimated. say: something to people, of a level.
        count: what of a channel did not go on, and why.
        """
        self.index, self.plan, self.names, self.channels = index, plan, plan.names, channels
        self.active = False  # sends
        self.failed: frozenset[str] = frozenset()  # channels that are composed
        self.passing: frozenset[str] = frozenset()  # failed, too, but let through all the same
        self.plain = True  # nothing was ever composed: every message goes on
        self.senders = Senders()
        self._clock, self._period, self._recall = clock, period, recall
        self._say, self._count = say, count
        self._wanted: Mapping[str, Wanted] = {}  # at the last tick
        self._latest: dict[str, float] = {}  # by channel: what it said
        self._heard: dict[str, int] = {}  # and when, by the engine's clock
        self._lacks: dict[str, tuple[Reason, int]] = {}  # why it did not, and when
        self._withheld, self._apart = Withheld(), Apart()
        self._max_age = {c.name: c.max_age for c in channels}
        self._longest = max(self._max_age.values())
        self._only = self.senders.sender(self.names) if len(self.names) == 1 else \
            Sender(0, set())

    # -------------------------------------------------------------------------- what comes in

    def judge(self, message: Message, token: Token) -> Forward | Reason | None:
        """
        Tell whether a live message goes on.

        None: it is kept for the next one that is composed. A reason: it should have gone on, and
        does not; that is counted. The numbers of channels that are not in the stream's names are
        nobody's.
        """
        now, values, stamp = self._clock.now, message.values, message.stamp
        if self.plain and self.active and len(values) == 1 and values[0].__class__ is float:
            self._note(self.names[0], float(values[0]), now)
            only = self._only  # mostly it is so
            only.take(token, now)
            if stamp is not None and (back := only.sends(stamp, now)):
                self._step_back(back)
            return AS_IT_CAME
        for name, value in zip(self.names, values):
            if isinstance(value, Reason):
                self._lacks[name] = value, now
            else:
                self._note(name, value, now)
        present = self.names if Reason not in map(type, values) else tuple(
            n for n, v in zip(self.names, values) if not is_absent(v))
        sender = self.senders.sender(present)
        failed = self.failed and self.failed & sender.channels
        sender.keep(token, sum(v.__class__ is float and n not in failed
                               for n, v in zip(self.names, values)) if len(values) > 1 else 0,
                    now, self._max_age[self.names[0]])
        if failed or not self.active:
            if stamp is not None:
                sender.keeps(token, stamp, values, now, self.active)
            return None
        if stamp is not None:
            if sender.floors and not sender.follows(
                    present, stamp, now, self._longest, self._step_back):
                self._withhold(present)
                return NOT_NEWER
            if back := sender.sends(stamp, now):
                self._step_back(back)
        return AS_IT_CAME if self.plain else self._blended(values)

    def judge_foreign(self, message: Message, token: Token,
                      related: int | None) -> Forward | Reason | None:
        """
        Tell whether a message without any channel of the stream goes on, with its own stamps.

        related: the number of a sender with failed channels whose template shares names with it;
        then it is that sender's. ANYBODYS: it has numbers without names, so that it may be any
        one's. None: it is others', or no sender has failed channels.
        """
        now, why = self._clock.now, message.values[0]
        assert isinstance(why, Reason)
        self.lacks(why, now)
        if related is not None:
            for sender in self.senders.all:
                if sender.number == related:
                    sender.keep(token, 0, now, self._max_age[self.names[0]])
                    if message.stamp is not None:
                        sender.keeps(token, message.stamp, message.values, now, self.active)
            return None
        return AS_IT_CAME if self.active else None

    def failed_templates(self) -> list[tuple[int, Token]] | None:
        """Return the templates of the senders with failed channels, by their numbers; or None."""
        if not self.failed:
            return None
        return [(sender.number, sender.template) for sender in self.senders.all
                if self.failed & sender.channels and sender.template is not None]

    def lacks(self, reason: Reason, now: int) -> None:
        """Note that something arrived that says nothing of any channel."""
        self._lacks.update(dict.fromkeys(self.names, (reason, now)))

    def _note(self, name: str, value: float, now: int) -> None:
        """Note what a channel says; with NaN it is there, but says nothing."""
        self._latest[name] = value
        if math.isnan(value):
            self._lacks[name] = ONLY_NAN, now
        else:
            self._heard[name] = now

    def _blended(self, values: Sequence[float | Reason]) -> Forward:
        """Let a live message go on with what is left of the offsets of the last switch."""
        lasting = self._clock.lasting()
        changed = {}
        for i, (channel, value) in enumerate(zip(self.channels, values)):
            if isinstance(value, float) and math.isfinite(value) and \
                    channel.name not in self.passing:
                put = channel.serve(REAL, (), value, lasting)
                if put != value:
                    changed[i] = put
        return Forward(changed) if changed else AS_IT_CAME

    def _withhold(self, names: Iterable[str]) -> None:
        """Note that channels do not go out, because they would not be newer than what did."""
        for name in names:
            self._count(name, NOT_NEWER)
            self._withheld.note(name, self._clock.now)

    def _step_back(self, by: int) -> None:
        self._say('error', Reason.of('stamps step back', topic=self.plan.source,
                                     output=self.plan.output, seconds=by * 1e-9))

    def leap(self, ahead: int) -> None:
        """Take no time [ns] for silence that the clock left out: it jumped ahead, or began."""
        for sender in self.senders.all:
            sender.leap(ahead)
        self._heard = {name: heard + ahead for name, heard in self._heard.items()}
        self._lacks = {name: (why, at + ahead) for name, (why, at) in self._lacks.items()}

    def forget(self) -> None:
        """Begin anew after the clock went back."""
        for sender in self.senders.all:
            sender.forget(self._clock.now)
        self._heard.clear()
        self._lacks.clear()
        self._withheld, self._apart = Withheld(), Apart()

    # ------------------------------------------------------------------- what is known of them

    def heard(self, name: str) -> bool:
        """Tell whether a channel has ever spoken, since the clock went back."""
        return name in self._heard or self._lacks.get(name, (None, 0))[0] == ONLY_NAN

    def latest(self, name: str) -> float:
        """Return what a channel said last, NaN before it spoke."""
        return self._latest.get(name, math.nan)

    def fresh(self, name: str) -> bool:
        """Tell whether a channel has spoken within its max_age."""
        heard = self._heard.get(name)
        return heard is not None and self._clock.now - heard <= self._max_age[name]

    def silence(self, name: str) -> int | None:
        """Return the time [ns] since a channel spoke, whatever its stamp; None before it did."""
        heard = self._heard.get(name)
        return None if heard is None else self._clock.now - heard

    def ahead(self, name: str) -> int:
        """Return how far [ns] a channel's last stamp was ahead of the clock."""
        return self.senders.of(name).lead()

    def why_silent(self, name: str) -> Reason | None:
        """Return why a healthy channel is not to be had live, or None when it is."""
        now, topic = self._clock.now, self.plan.source
        if self.fresh(name):
            behind = self.senders.of(name).behind
            stuck = behind is not None and now - behind > self._max_age[name]
            return Reason.of('stale messages', topic=topic, why=NOT_NEWER) if stuck else None
        reason, at = self._lacks.get(name, (None, 0))
        if reason is not None and now - at <= self._max_age[name]:
            if reason == ONLY_NAN:
                return Reason.of('only NaN on', topic=topic)
            return Reason.of('useless messages', topic=topic, why=reason)
        return Reason.of('nothing comes', topic=topic)

    @property
    def never_seen(self) -> Reason | None:
        """Why no message could be composed, for want of one to begin with; None: it could."""
        return NEVER_SEEN if self.plan.stamped and all(
            sender.template is None for sender in self.senders.all) else None

    def why_odd(self, name: str) -> Reason | None:
        """Return what is to be said of a channel that is live: not all goes on, or can be used."""
        return self._withheld.why(name, NOT_NEWER, self._clock.now) or self._of_another_clock(name)

    def _of_another_clock(self, name: str) -> Reason | None:
        """Return that no virtual sensor can use what a channel says, for its stamps are off."""
        now = self._clock.now
        if not self.plan.stamped or not self.fresh(name):
            self._apart.forget(name)
            return None
        ahead = self.ahead(name)
        if not self._apart.steadily(name, ahead, self._max_age[name], now):
            return None
        return Reason.of('input of another clock', name=name, seconds=ahead * 1e-9,
                         clock=now * 1e-9)

    def composes(self, name: str) -> bool:
        """Tell whether messages with a channel are composed, so that a live one does not go on."""
        sender = self.senders.known(name)
        return sender is not None and sender.composes

    def lag(self, name: str) -> int:
        """Return by how much older than the tick estimates of a channel are wanted."""
        sender = self.senders.known(name)
        if sender is None:
            return 0
        return sender.lag if sender.composes else self._lateness(sender)

    def _lateness(self, sender: Sender) -> int:
        return sender.lateness(self._period, 2 * self._longest)

    def driver_silence(self, name: str) -> Reason | None:
        """Return for how long a channel's driver has been silent, None when it is not."""
        sender = self.senders.of(name)
        if sender.template is None or not self._silent(sender):
            return None
        return Reason.of('driver silent', seconds=(self._clock.now - sender.heard) * 1e-9)

    def _silent(self, sender: Sender) -> bool:
        return self._clock.now - sender.heard > self._longest

    # --------------------------------------------------------------------------- what goes out

    def fail(self, failed: frozenset[str], passing: frozenset[str]) -> list[Composition]:
        """
        Compose these channels from now on; those passing have failed, too.

        Returns what waited of late drivers of which nothing is failed any more.
        """
        waited: list[Composition] = []
        self.passing = passing
        if self.plain and failed:
            lasting = self._clock.lasting()
            for channel in self.channels:  # what it said last went out; nobody noted it till now
                heard = self._heard.get(channel.name)
                if heard is not None and self.active:
                    channel.value = self._latest[channel.name]
                    channel.sent = lasting - (self._clock.now - heard)
            self.plain = False
        if failed != self.failed:
            self.failed = failed
            for sender in self.senders.all:
                sender.carried = 0
                waited += self._turn(sender)
            for channel in self.channels:
                if channel.name not in failed | passing:
                    channel.why = None
        return waited

    def _turn(self, sender: Sender) -> list[Composition]:
        """Let a sender begin or end to be one whose messages are composed; return the last."""
        failed = not self.failed.isdisjoint(sender.channels)
        if failed and not sender.composes:
            sender.begin(self._lateness(sender))
            if sender.offset:
                self._say('error', Reason.of('clock of its own', topic=self.plan.source,
                                             seconds=sender.offset * 1e-9))
        elif not failed and sender.composes:
            waited = self._waited(sender, self._clock.now)  # came before that was believed
            sender.end()
            return waited
        return []

    def compose(self, time: int, wanted: Mapping[str, Wanted], at_once: bool,
                ) -> tuple[list[Composition], dict[str, Reason]]:
        """
        Make of each template a message with these channels replaced, for the time of the tick.

        All other channels are as they were last heard, NaN when that is too long ago. A sender
        none of whose channels has a value sends nothing; beside others, one without is NaN.
        at_once: may be stamped a little later. The messages of a late driver keep their stamps,
        with the estimates of then. Returns the messages, and by failed channel why there is none.
        """
        made: list[Composition] = []
        troubles: dict[str, Reason] = {}
        if not self.active or time == 0:
            return made, troubles
        self._wanted = wanted
        for sender, names in self.senders.serving(wanted).items():
            stopped = [name for name in names if wanted[name].value is None]
            if len(stopped) == len(names) and not any(
                    self.fresh(name) for name in sender.channels if name not in names):
                sender.waiting.clear()
                continue
            if sender.late:
                made += self._of_late(sender, time)
                continue
            composed = self._compose(sender, time, wanted, at_once)
            if isinstance(composed, Composition):
                made.append(composed)
            elif composed is not None:
                self.trouble(sender.channels, composed)
                troubles.update(dict.fromkeys(names, composed))
        return made, troubles

    def trouble(self, names: Sequence[str] | set[str], why: Reason | None) -> None:
        """Note why live channels in a composed message do not go out, None when they do."""
        for channel in self.channels:
            if channel.name in names and channel.name not in self.failed | self.passing:
                channel.why = why

    def sent(self, composition: Composition) -> None:
        """Note that a composed message went out."""
        names = [self.names[i] for i, _ in composition.fields]
        for sender in self.senders.all:
            if sender.number == composition.sender:
                sender.sent(names, composition.stamp, self._clock.now)
        self.trouble(names, None)

    def _compose(self, sender: Sender, time: int, wanted: Mapping[str, Wanted],
                 at_once: bool) -> Composition | Reason | None:
        """Return a message, or why there is none; None: none this time."""
        now = self._clock.now
        if sender.template is None and self.plan.stamped:
            return NEVER_SEEN
        stamp = sender.stamp_for(time, at_once)
        if stamp <= sender.newest:
            self._withhold(sender.channels)
            if sender.held_up is None:
                sender.held_up = now
            return NOT_NEWER if now - sender.held_up > self._longest else None
        sender.held_up = None
        return self._composition(sender, sender.template, stamp, time, time, wanted)

    def _of_late(self, sender: Sender, tick: int) -> list[Composition]:
        """
        Return the messages of a late driver that came since the last tick, with their stamps.

        When it has said nothing for max_age: its last one, for the time that its messages would be
        of now. Sooner, what is live in that one would get a stamp that it does not have.
        """
        made = self._waited(sender, tick)
        stamp = tick - sender.lag
        if not made and stamp > sender.newest and \
                self._clock.now - sender.spoke > self._longest:
            made.append(self._composition(sender, sender.template, stamp, stamp, tick,
                                          recalled(self._wanted, stamp, self._recall)))
        return made

    def _waited(self, sender: Sender, tick: int) -> list[Composition]:
        """Return the messages of a late driver that waited, with the estimates at their stamps."""
        made, newest = [], sender.newest
        for token, stamp, values in sender.waiting:
            if stamp > newest:
                newest = stamp
                made.append(self._composition(
                    sender, token, stamp, stamp, tick,
                    recalled(self._wanted, stamp, self._recall),
                    {name: value for name, value in zip(self.names, values)
                     if isinstance(value, float)}))
            else:
                self._withhold(sender.channels)
        sender.waiting.clear()
        return made

    def _composition(self, sender: Sender, template: Token | None, stamp: int, time: int,
                     tick: int, wanted: Mapping[str, Wanted],
                     said: Mapping[str, float] = MappingProxyType({})) -> Composition:
        """Return a message; said: by channel what a late one says itself."""
        return Composition(
            self.index, sender.number, template, sender.first, self._silent(sender), stamp,
            time, tuple((i, self._field(channel, wanted.get(channel.name), tick,
                                        said.get(channel.name)))
                        for i, channel in enumerate(self.channels)
                        if channel.name in sender.channels))

    def _field(self, channel: Channel, wanted: Wanted | None, time: int,
               said: float | None) -> Substitute | float | None:
        """Return what is to be written for a channel, failed or live; see Composition."""
        lasting = self._clock.lasting(time)
        if wanted is not None:
            value = math.nan if wanted.value is None else wanted.value
            if wanted.fault_set is not None:
                value = channel.serve(VIRTUAL, wanted.fault_set, value, lasting, wanted.above,
                                      wanted.deviation, wanted.run)
            offset = channel.blend.left(lasting) if wanted.fault_set is not None else 0.0
            interval = channel.beside(wanted.interval, wanted.value, lasting)
            return Substitute(value, wanted.fault_set, wanted.deviation, interval, wanted.grade,
                              offset)
        if not self.fresh(channel.name):
            return None
        value = self._latest[channel.name] if said is None else said
        if math.isfinite(value) and channel.name not in self.passing:
            value = channel.serve(REAL, (), value, self._clock.lasting())
        return value


def is_absent(value: float | Reason) -> bool:
    """Tell whether a message does not have a channel in it, so that others may send it."""
    return isinstance(value, Reason) and value.code == ABSENT
