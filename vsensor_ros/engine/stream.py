"""
One stream of messages: which of them go on, and what is to stand in for those that do not.

A message with no failed channel in it goes on as it came, whatever its stamp; only what was
composed lately must be followed by something newer. What stands in for the others is made by the
`Composer`. All times are in ns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import math

from vsensor_ros.engine.apart import Apart
from vsensor_ros.engine.channel import Channel, REAL
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.composer import Composer, NEVER_SEEN, NOT_NEWER
from vsensor_ros.engine.events import AS_IT_CAME, Composition, Forward, Message, Token
from vsensor_ros.engine.heard import Heard
from vsensor_ros.engine.sender import Sender, Senders
from vsensor_ros.engine.settings import StreamPlan
from vsensor_ros.engine.wanted import Recall, Wanted
from vsensor_ros.engine.withheld import Withheld
from vsensor_ros.reason import Reason

UNREADABLE = Reason('unreadable')
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
        self._clock, self._say, self._count = clock, say, count
        self._withheld, self._apart = Withheld(), Apart()
        self._max_age = {c.name: c.max_age for c in channels}
        self.heard = Heard(self._max_age, clock)
        self.composer = Composer(index, plan, channels, clock, period, recall, self.heard,
                                 self.senders, say, self._withhold)
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
            self.heard.note(self.names[0], float(values[0]), now)
            only = self._only  # mostly it is so
            only.take(token, now)
            if stamp is not None and (back := only.sends(stamp, now)):
                self._step_back(back)
            return AS_IT_CAME
        for name, value in zip(self.names, values):
            if isinstance(value, Reason):
                self.heard.lack(name, value, now)
            else:
                self.heard.note(name, value, now)
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
        for name in self.names:
            self.heard.lack(name, reason, now)

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
        self.heard.leap(ahead)

    def forget(self) -> None:
        """Begin anew after the clock went back."""
        for sender in self.senders.all:
            sender.forget(self._clock.now)
        self.heard.forget()
        self._withheld, self._apart = Withheld(), Apart()

    # ------------------------------------------------------------------- what is known of them

    def ahead(self, name: str) -> int:
        """Return how far [ns] a channel's last stamp was ahead of the clock."""
        return self.senders.of(name).lead()

    def why_silent(self, name: str) -> Reason | None:
        """Return why a healthy channel is not to be had live, or None when it is."""
        now, topic = self._clock.now, self.plan.source
        if self.heard.fresh(name):
            behind = self.senders.of(name).behind
            stuck = behind is not None and now - behind > self._max_age[name]
            return Reason.of('stale messages', topic=topic, why=NOT_NEWER) if stuck else None
        return self.heard.why_nothing(name, topic)

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
        if not self.plan.stamped or not self.heard.fresh(name):
            self._apart.forget(name)
            return None
        ahead = self.ahead(name)
        if not self._apart.steadily(name, ahead, self._max_age[name], now):
            return None
        return Reason.of('input of another clock', name=name, seconds=ahead * 1e-9,
                         clock=now * 1e-9)

    # --------------------------------------------------------------------------- what goes out

    def fail(self, failed: frozenset[str], passing: frozenset[str]) -> list[Composition]:
        """
        Compose these channels from now on; those passing have failed, too.

        Returns what waited of late drivers of which nothing is failed any more.
        """
        waited: list[Composition] = []
        self.passing, self.composer.failed = passing, failed | passing
        if self.plain and failed:
            lasting = self._clock.lasting()
            for channel in self.channels:  # what it said last went out; nobody noted it till now
                silence = self.heard.silence(channel.name)
                if silence is not None and self.active:
                    channel.value = self.heard.latest(channel.name)
                    channel.sent = lasting - silence
            self.plain = False
        if failed != self.failed:
            self.failed = failed
            waited = self.composer.turn(failed)
            for channel in self.channels:
                if channel.name not in failed | passing:
                    channel.why = None
        return waited

    def compose(self, time: int, wanted: Mapping[str, Wanted], at_once: bool,
                ) -> tuple[list[Composition], dict[str, Reason]]:
        """Return what goes out in place of these channels at a tick, see `Composer.compose`."""
        if not self.active or time == 0:
            return [], {}
        return self.composer.compose(time, wanted, at_once)


def is_absent(value: float | Reason) -> bool:
    """Tell whether a message does not have a channel in it, so that others may send it."""
    return isinstance(value, Reason) and value.code == ABSENT
