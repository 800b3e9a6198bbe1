"""
Who sends the messages of a stream, what their stamps are like, and what may follow what.

Live messages go on whatever their stamps are. These count for what is composed: it is newer than
all that went out before, and what follows it on a channel is newer still.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median_low
from typing import NamedTuple

from vsensor_ros.engine.events import Token
from vsensor_ros.reason import Reason

CLOCKS_APART = 1_000_000_000  # ns; stamps further than this from ours are another clock's
PATIENCE = 5_000_000_000  # ns after the last composed message for which it is to be followed
AHEAD = 250_000_000  # ns by which a stamp may lie ahead of the node's clock unasked
AGREE = 3  # messages in a row that are off by the same: then their clock is believed
MOST = 64  # sets of channels that came together, kept at hand
NEVER = -2**63  # ns, before any stamp
HELD = 10_000_000  # ns by which an estimate may be stamped after its state, at a fault
RECENT = 32  # messages whose stamps are remembered
ENOUGH = 8  # of them that it takes to tell that a driver is late
INCREASING = 0.75  # of their stamps that must be newer than the one before
LATE = 2  # intervals between its messages, and periods, above which a driver is late
WAITING = 20  # messages of a late driver between two ticks that are kept, at most


class Waiting(NamedTuple):
    """A message of a late driver that waits for the estimates at its own stamp."""

    token: Token
    stamp: int
    values: tuple[float | Reason, ...]  # by channel of the stream


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
    # stamps of its last messages that are believed, and when they came
    recent: deque[tuple[int, int]] = field(default_factory=lambda: deque(maxlen=RECENT))
    newest: int = NEVER  # believed stamp that went out, live or composed
    ahead: int = AHEAD  # ns by which its stamps may lie ahead of the engine's clock
    doubted: tuple[int, int, object] = (0, 0, None)  # see `_believes`
    far: tuple[int, int] = (0, NEVER)  # by how much the last stamp that was not lay ahead; when
    # while a channel of it is failed
    composes: bool = False
    late: bool = False  # its messages keep their own stamps
    lag: int = 0  # by how much these are older than the tick, at least
    offset: int = 0  # of the clock of its stamps to the engine's, when that is another
    waiting: deque[Waiting] = field(default_factory=lambda: deque(maxlen=WAITING))
    spoke: int = 0  # when the last message came whose stamp goes on from those before
    held_up: int | None = None  # since when what is composed would not be newer than the rest
    # and afterwards
    floors: dict[str, int] = field(default_factory=dict)  # by channel: the last composed stamp
    composed: int = 0  # when that went out
    passed: bool = False  # a live message has been newer since
    behind: int | None = None  # since when all have been older
    refused: int = NEVER  # the stamp of the last of these

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
        for name, stamp in other.floors.items():
            self.floors[name] = max(stamp, self.floors.get(name, NEVER))
        self.composed = max(self.composed, other.composed)
        self.newest = max(self.newest, other.newest)
        self.recent = max(self.recent, other.recent, key=len)
        if other.composes and not self.composes:
            self.composes, self.late, self.lag = True, other.late, other.lag
            self.offset, self.spoke = other.offset, other.spoke
        if other.taken > self.taken:
            self.template, self.taken, self.first = other.template, other.taken, other.first
        self.heard = max(self.heard, other.heard)

    def leap(self, ahead: int) -> None:
        """Take no time for silence that the clock left out."""
        self.heard += ahead
        self.taken += ahead
        self.spoke += ahead

    def forget(self, now: int) -> None:
        """Begin anew after the clock went back; what its messages look like is still so."""
        self.recent.clear()
        self.waiting.clear()
        self.floors.clear()
        self.newest, self.behind, self.held_up = NEVER, None, None
        self.late, self.lag, self.offset, self.taken, self.carried = False, 0, 0, 0, 0
        self.heard = min(self.heard, now)

    # ----------------------------------------------------------------- what its stamps are like

    def sends(self, stamp: int, now: int) -> int:
        """
        Note the stamp of a live message that goes on; return by how much they step back for good.

        A stamp far from the others may be a mistake. What is composed must not wait for it.
        """
        if self.newest < stamp <= now + self.ahead and now:  # mostly
            self.newest = stamp
            self.recent.append((stamp, now))
            return 0
        before = max(self.newest, stamp)
        far = stamp > now + self.ahead or stamp < before - CLOCKS_APART
        if not now or far and not self._believes(stamp, now):
            self.far = stamp - now, now
            return 0  # 0: no time is known by which it could be judged
        self.recent.append((stamp, now))
        self.newest = max(self.newest, stamp)
        return before - self.newest

    def keeps(self, token: Token, stamp: int, values: tuple[float | Reason, ...], now: int,
              active: bool) -> None:
        """Note a message that does not go on as it came; active: what is composed of it does."""
        if not now or stamp > now + self.ahead:
            self.far = stamp - now, now
            return
        self.recent.append((stamp, now))
        if stamp > self.newest - CLOCKS_APART:
            self.spoke = now
        if active and self.late and token is self.template:
            self.waiting.append(Waiting(token, stamp, values))
            self.lag = max(0, min(self.lag, now - stamp))

    def _believes(self, stamp: int, now: int) -> bool:
        """
        Tell whether a stamp far from the others is believed: as AGREE in a row, or the first.

        Then it is of another clock than those before.
        """
        last = self.recent[-1] if self.recent else None
        lead, (before, row, after) = stamp - now, self.doubted
        row = row + 1 if row and after is last and abs(lead - before) <= AHEAD else 1
        self.doubted = lead, row, last
        if row < AGREE and last is not None:
            return False
        self.doubted = 0, 0, None
        self.recent.clear()
        self.newest = NEVER
        if stamp > now + self.ahead:
            self.ahead = lead + AHEAD
        return True

    def lead(self) -> int:
        """Return by how much its last stamp lay ahead of the clock."""
        stamp, came = self.recent[-1] if self.recent else (NEVER, NEVER)
        return self.far[0] if self.far[1] >= came else stamp - came

    def lateness(self, period: int, most: int) -> int:
        """
        Return by how much its stamps are older than the time when they come; 0: not worth a word.

        That is the least of late, of a driver whose stamps go on. period: of the ticks. most: for
        so long it is remembered what virtual sensors have said.
        """
        if len(self.recent) < ENOUGH:
            return 0
        increasing = sum(b > a for (a, _), (b, _) in pairwise(self.recent))
        least = min(came - stamp for stamp, came in self.recent)
        known = increasing >= INCREASING * (len(self.recent) - 1) and \
            LATE * max(self._interval(), period) < least <= min(most, CLOCKS_APART)
        return least if known else 0

    def _interval(self) -> float:
        """Return the time between two of its messages, in the mean."""
        return (self.recent[-1][1] - self.recent[0][1]) / max(1, len(self.recent) - 1)

    # ------------------------------------------------------------------------ what is composed

    def begin(self, lateness: int) -> None:
        """Note that messages are composed from now on, and how they are to be stamped."""
        self.composes, self.held_up = True, None
        last = [stamp - came for stamp, came in list(self.recent)[-AGREE:]]
        offset = median_low(last) if last else 0
        self.offset = offset if abs(offset) > CLOCKS_APART else 0
        self.lag, self.late = lateness, lateness > 0
        self.spoke = self.recent[-1][1] if self.recent else 0

    def end(self) -> None:
        """Note that no channel is failed any more."""
        self.composes, self.late, self.lag = False, False, 0
        self.waiting.clear()

    def stamp_for(self, time: int, at_once: bool) -> int:
        """
        Return the stamp of what is composed for a time: that time, on the driver's clock.

        at_once: may be later by HELD, if only so it is newer than what went out.
        """
        stamp = time + self.offset
        if at_once and 0 <= self.newest - stamp < HELD:
            return self.newest + 1
        return stamp

    def sent(self, names: Iterable[str], stamp: int, now: int) -> None:
        """Note that a composed message with these channels went out."""
        self.newest = max(self.newest, stamp)
        self.floors.update(dict.fromkeys(names, stamp))
        self.composed, self.passed, self.behind = now, False, None

    def follows(self, present: Iterable[str], stamp: int, now: int, max_age: int,
                warn: Callable[[int], None]) -> bool:
        """
        Tell whether a live message may go out: newer than what was composed of its channels.

        That is asked for PATIENCE; what is older all the time has another clock then. Once one
        was newer, a clock that was set back is believed when for max_age nothing but older stamps
        has come, and they go on increasing. warn: is told, then, by how much the stamps step back.
        """
        back = max((self.floors.get(name, NEVER) for name in present), default=NEVER) - stamp
        over = not 0 <= now - self.composed <= PATIENCE
        believed = False
        if back < 0:
            self.behind, self.passed = None, True
        elif over:
            believed = not self.passed
        else:
            if self.behind is None:
                self.behind, self.refused = now, stamp
            goes_on, self.refused = stamp > self.refused, stamp
            believed = self.passed and goes_on and back > CLOCKS_APART \
                and now - self.behind >= max_age
        if over or believed:
            self.floors.clear()
            self.behind = None
        if believed:
            self.newest = NEVER
            self.recent.clear()
            warn(back)
        return back < 0 or over or believed


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

    def known(self, channel: str) -> Sender | None:
        """Return who sends a channel, None if it was never heard."""
        return self._of.get(channel)

    def serving(self, channels: Iterable[str]) -> dict[Sender, list[str]]:
        """Return these channels by who sends them."""
        result: dict[Sender, list[str]] = {}
        for channel in channels:
            result.setdefault(self.of(channel), []).append(channel)
        return result
