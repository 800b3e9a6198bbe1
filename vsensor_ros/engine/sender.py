"""Who sends the messages of a stream, and in what order they go out."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from vsensor_ros.engine.events import Token

CLOCKS_APART = 1_000_000_000  # ns; stamps further than this from ours are another clock's
PATIENCE = 5_000_000_000  # ns of nothing but stamps behind an estimate's, then they are believed
AHEAD = 250_000_000  # ns by which a stamp may lie ahead of the node's clock unasked
AGREE = 3  # messages in a row that lie further ahead by the same: then their clock is believed
MOST = 64  # sets of channels that came together, kept at hand
NEVER = -2**63  # ns, before any stamp
HELD = 10_000_000  # ns by which an estimate may be stamped after its state, at a fault


@dataclass(eq=False)
class Sender:
    """
    One sender on a stream, known by the channels that it was seen to send together.

    Mostly there is one. Of the JointStates on one topic several may each send some joints; each
    has stamps of its own. All times are in ns, of the engine's clock unless it says otherwise.
    """

    number: int
    channels: set[str]
    first: Token | None = None  # its first message: what has changed since is a measurement
    heard: int = 0  # when its last message came
    template: Token | None = None  # its last message with the most channels
    taken: int = 0  # when that came
    carried: int = 0  # healthy channels in it
    last_sent: int = NEVER  # the stamp that went out last
    offset: int = 0  # of the clock of its stamps to the engine's
    ahead: int = AHEAD  # ns by which its stamps may lie ahead of the engine's clock
    doubted: tuple[int, int] = (0, 0)  # by how much the last one that lay further did; in a row
    composed: bool = False  # some of what went out is not as it came
    blocked: int | None = None  # since when all stamps were too old to go out
    refused: int = NEVER  # the last of these

    def keep(self, token: Token, carried: int, now: int, max_age: int) -> None:
        """Take a message for the template, unless the one there is has more channels."""
        self.heard = now
        if carried >= self.carried or now - self.taken > max_age:
            self.take(token, now)
            self.carried = carried

    def take(self, token: Token, now: int) -> None:
        """Take a message for the template."""
        if self.first is None:
            self.first = token
        self.template, self.taken, self.heard = token, now, now

    def join(self, other: Sender) -> None:
        """Learn that two were one."""
        self.channels |= other.channels
        self.composed |= other.composed
        self.last_sent = max(self.last_sent, other.last_sent)
        if other.taken > self.taken:
            self.template, self.taken, self.first = other.template, other.taken, other.first
        self.heard = max(self.heard, other.heard)

    def forget(self, now: int) -> None:
        """Begin anew after the clock went back; what its messages look like is still so."""
        self.last_sent, self.blocked, self.composed = NEVER, None, False
        self.offset, self.taken, self.carried = 0, 0, 0
        self.heard = min(self.heard, now)

    def sends(self, stamp: int, now: int) -> None:
        """Note that a live message goes out."""
        self.offset, self.last_sent, self.blocked = stamp - now, stamp, None

    def believes(self, stamp: int, now: int) -> bool:
        """
        Tell whether a stamp that lies far ahead of the engine's clock is to be believed.

        A single one is a mistake: what comes after it would be old, and an estimate from the
        future. AGREE in a row are another clock, and so is the very first.
        """
        lead, (before, row) = stamp - now, self.doubted
        row = row + 1 if row and abs(lead - before) <= AHEAD else 1
        self.doubted = lead, row
        if row < AGREE and self.last_sent != NEVER:
            return False
        self.ahead, self.doubted = lead + AHEAD, (0, 0)
        return True

    @property
    def apart(self) -> bool:
        """Whether its stamps are of another clock than the engine's."""
        return abs(self.offset) > CLOCKS_APART

    def stamp_for(self, time: int, at_once: bool) -> int:
        """
        Return the stamp of an estimate for a time: that time, on the driver's clock.

        at_once: may be later by HELD, if only so it is newer than what went out.
        """
        stamp = time + self.offset if self.apart else time
        if at_once and 0 <= self.last_sent - stamp < HELD:
            return self.last_sent + 1
        return stamp

    def in_order(self, stamp: int, now: int, max_age: int,
                 warn: Callable[[float], None]) -> bool:
        """
        Tell whether a message with this stamp may go out: when it is newer than what went out.

        A clock that was set back is believed when for max_age nothing but older stamps has come,
        and they go on increasing; behind estimates, and by less than CLOCKS_APART, which passes
        by itself, for PATIENCE. warn: is told, then, by how many seconds the stamps step back.
        """
        if stamp > self.last_sent:
            self.blocked = None
            return True
        if self.blocked is None:
            self.blocked, self.refused = now, stamp
        goes_on, self.refused = stamp > self.refused, stamp
        if goes_on:  # else it is late itself, and says nothing of the clock
            self.offset = stamp - now
        back = self.last_sent - stamp
        patience = PATIENCE if self.composed or back <= CLOCKS_APART else max_age
        if not goes_on or now - self.blocked < patience:
            return False
        warn(back * 1e-9)
        self.blocked, self.last_sent = None, NEVER
        return True


class Senders:
    """The senders on one stream, told apart by the channels that come together."""

    def __init__(self) -> None:
        self.all: list[Sender] = []
        self._made = 0
        self._of: dict[str, Sender] = {}  # by channel
        self._by_presence: dict[tuple[str, ...], Sender] = {}

    def _new(self) -> Sender:
        self._made += 1
        self.all.append(Sender(self._made, set()))
        return self.all[-1]

    def sender(self, present: tuple[str, ...]) -> Sender:
        """Return who sends the channels that are present in one message, at least one."""
        sender = self._by_presence.get(present)
        if sender is None:
            known = list(dict.fromkeys(self._of[c] for c in present if c in self._of))
            sender = known[0] if known else self._new()
            for other in known[1:]:
                sender.join(other)
                self.all.remove(other)
            sender.channels |= set(present)
            self._of.update(dict.fromkeys(sender.channels, sender))
            if len(known) > 1 or len(self._by_presence) >= MOST:
                self._by_presence.clear()
            self._by_presence[present] = sender
        return sender

    def of(self, channel: str) -> Sender:
        """Return who sends a channel; if it was never heard, who is there."""
        sender = self._of.get(channel)
        if sender is None:
            sender = self._of[channel] = self.all[0] if self.all else self._new()
            sender.channels.add(channel)
        return sender

    def serving(self, channels: Iterable[str]) -> dict[Sender, list[str]]:
        """Return these channels by who sends them."""
        result: dict[Sender, list[str]] = {}
        for channel in channels:
            result.setdefault(self.of(channel), []).append(channel)
        return result
