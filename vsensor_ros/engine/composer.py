"""
The messages of one stream that are made because a channel in them has failed.

While a channel of a sender is failed, its messages are composed: the latest live one is the
template, the failed channels are written into it, and every other channel is what it last said.
All times are in ns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
import math
from types import MappingProxyType

from vsensor_ros.engine.channel import Channel, REAL, VIRTUAL
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.events import Composition, Substitute, Token
from vsensor_ros.engine.heard import Heard
from vsensor_ros.engine.sender import Sender, Senders
from vsensor_ros.engine.settings import StreamPlan
from vsensor_ros.engine.wanted import Recall, recalled, Wanted
from vsensor_ros.reason import Reason

NOT_NEWER, NEVER_SEEN = map(Reason, ('not newer', 'never seen'))


class Composer:
    """What goes out of a stream in place of messages with failed channels."""

    def __init__(self, index: int, plan: StreamPlan, channels: Sequence[Channel], clock: Clock,
                 period: int, recall: Recall, heard: Heard, senders: Senders,
                 say: Callable[[str, Reason], object],
                 withhold: Callable[[Iterable[str]], object]) -> None:
        """
        Begin with nothing failed; channels: those of the plan, in its order.

        period: of the ticks. recall: what was estimated. heard, senders: of the stream. say:
        something to people, of a level. withhold: notes channels that do not go out, because they
        would not be newer than what did.
        """
        self._index, self._plan, self._names, self._channels = index, plan, plan.names, channels
        self._clock, self._period, self._recall = clock, period, recall
        self._heard, self._senders, self._say, self._withhold = heard, senders, say, withhold
        self._longest = max(c.max_age for c in channels)
        self.failed: frozenset[str] = frozenset()  # and those that pass all the same
        self._wanted: Mapping[str, Wanted] = {}  # at the last tick

    # ------------------------------------------------------------------ what is known of drivers

    def composes(self, name: str) -> bool:
        """Tell whether messages with a channel are composed, so that a live one does not go on."""
        sender = self._senders.known(name)
        return sender is not None and sender.composes

    def lag(self, name: str) -> int:
        """Return by how much older than the tick estimates of a channel are wanted."""
        sender = self._senders.known(name)
        if sender is None:
            return 0
        return sender.lag if sender.composes else self._lateness(sender)

    def _lateness(self, sender: Sender) -> int:
        return sender.lateness(self._period, 2 * self._longest)

    def driver_silence(self, name: str) -> Reason | None:
        """Return for how long a channel's driver has been silent, None when it is not."""
        sender = self._senders.of(name)
        if sender.template is None or not self._silent(sender):
            return None
        return Reason.of('driver silent', seconds=(self._clock.now - sender.heard) * 1e-9)

    def _silent(self, sender: Sender) -> bool:
        return self._clock.now - sender.heard > self._longest

    # --------------------------------------------------------------------------- what goes out

    def turn(self, failed: frozenset[str]) -> list[Composition]:
        """Compose these channels from now on; return what waited of who has none of them."""
        waited: list[Composition] = []
        for sender in self._senders.all:
            sender.carried = 0
            waited += self._turn(sender, failed)
        return waited

    def _turn(self, sender: Sender, failed: frozenset[str]) -> list[Composition]:
        """Let a sender begin or end to be one whose messages are composed; return the last."""
        composed = not failed.isdisjoint(sender.channels)
        if composed and not sender.composes:
            sender.begin(self._lateness(sender))
            if sender.offset:
                self._say('error', Reason.of('clock of its own', topic=self._plan.source,
                                             seconds=sender.offset * 1e-9))
        elif not composed and sender.composes:
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
        self._wanted = wanted
        for sender, names in self._senders.serving(wanted).items():
            stopped = [name for name in names if wanted[name].value is None]
            if len(stopped) == len(names) and not any(
                    self._heard.fresh(name) for name in sender.channels if name not in names):
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
        for channel in self._channels:
            if channel.name in names and channel.name not in self.failed:
                channel.why = why

    def sent(self, composition: Composition) -> None:
        """Note that a composed message went out."""
        names = [self._names[i] for i, _ in composition.fields]
        for sender in self._senders.all:
            if sender.number == composition.sender:
                sender.sent(names, composition.stamp, self._clock.now)
        self.trouble(names, None)

    def _compose(self, sender: Sender, time: int, wanted: Mapping[str, Wanted],
                 at_once: bool) -> Composition | Reason | None:
        """Return a message, or why there is none; None: none this time."""
        now = self._clock.now
        if sender.template is None and self._plan.stamped:
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
                    {name: value for name, value in zip(self._names, values)
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
            self._index, sender.number, template, sender.first, self._silent(sender), stamp,
            time, tuple((i, self._field(channel, wanted.get(channel.name), tick,
                                        said.get(channel.name)))
                        for i, channel in enumerate(self._channels)
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
            offset = doubtful = 0.0
            if wanted.fault_set is not None:
                offset, doubtful = channel.blend.left(lasting), channel.blend.doubtful(lasting)
            interval = channel.beside(wanted.interval, wanted.value, lasting)
            return Substitute(value, wanted.fault_set, wanted.deviation, interval, wanted.grade,
                              offset, doubtful)
        if not self._heard.fresh(channel.name):
            return None
        value = self._heard.latest(channel.name) if said is None else said
        if math.isfinite(value) and channel.name not in self.failed:
            value = channel.serve(REAL, (), value, self._clock.lasting())
        return value
