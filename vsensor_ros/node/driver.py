"""Who sends the messages of a topic, in what order they go out, and what stands in for them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

CLOCKS_APART = 1_000_000_000  # ns; stamps further than this from ours are another clock's
PATIENCE = 5_000_000_000  # ns of nothing but stamps behind an estimate's, then they are believed
MOST = 64  # sets of channels that came together, kept at hand
NEVER = -2**63  # ns, before any stamp
HELD = 10_000_000  # ns by which an estimate may be stamped after its state, at a fault


@dataclass(eq=False)
class Driver:
    """
    One sender on a topic, known by the channels that it was seen to send together.

    Mostly there is one. Of the JointStates on one topic several may each send some joints; each
    has stamps of its own. All times are in ns, of the node's clock unless it says otherwise.
    """

    channels: set[str]
    raw: bytes | None = None  # its last message with the most channels: the template
    taken: int = 0  # when it came
    carried: int = 0  # healthy channels in it
    message: Any = None  # the template, decoded, with what was put into it
    last_sent: int = NEVER  # the stamp that went out last
    offset: int = 0  # of the clock of its stamps to the node's
    composed: bool = False  # some of what went out is not as it came
    blocked: int | None = None  # since when all stamps were too old to go out
    refused: int = NEVER  # the newest of these
    problem: str | None = None  # why nothing goes out, though it should

    def keep(self, raw: bytes, carried: int, now: int, max_age: int) -> None:
        """Take a message for the template, unless the one there is has more channels."""
        if carried >= self.carried or now - self.taken > max_age:
            self.raw, self.message, self.taken, self.carried = raw, None, now, carried

    def join(self, other: Driver) -> None:
        """Learn that two were one."""
        self.channels |= other.channels
        self.composed |= other.composed
        self.last_sent = max(self.last_sent, other.last_sent)
        if other.taken > self.taken:
            self.raw, self.message, self.taken = other.raw, other.message, other.taken

    def forget(self) -> None:
        """Begin anew after the clock went back; what its messages look like is still so."""
        self.last_sent, self.blocked, self.composed = NEVER, None, False
        self.offset, self.taken, self.carried = 0, 0, 0

    def sends(self, stamp: int, now: int) -> None:
        """Note that a live message goes out."""
        self.offset, self.last_sent, self.blocked = stamp - now, stamp, None

    @property
    def apart(self) -> bool:
        """Whether its stamps are of another clock than the node's."""
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
        goes_on = stamp > self.refused
        if goes_on:  # else it is late itself, and says nothing of the clock
            self.refused, self.offset = stamp, stamp - now
        back = self.last_sent - stamp
        patience = PATIENCE if self.composed or back <= CLOCKS_APART else max_age
        if not goes_on or now - self.blocked < patience:
            return False
        warn(back * 1e-9)
        self.blocked, self.last_sent = None, NEVER
        return True


class Drivers:
    """The senders on one topic, told apart by the channels that come together."""

    def __init__(self) -> None:
        self.all: list[Driver] = []
        self._of: dict[str, Driver] = {}  # by channel
        self._by_presence: dict[tuple[str, ...], Driver] = {}

    def sender(self, present: tuple[str, ...]) -> Driver:
        """Return who sends the channels that are present in one message, at least one."""
        driver = self._by_presence.get(present)
        if driver is None:
            known = list(dict.fromkeys(self._of[c] for c in present if c in self._of))
            driver = known[0] if known else Driver(set())
            if not known:
                self.all.append(driver)
            for other in known[1:]:
                driver.join(other)
                self.all.remove(other)
            driver.channels |= set(present)
            self._of.update(dict.fromkeys(driver.channels, driver))
            if len(known) > 1 or len(self._by_presence) >= MOST:
                self._by_presence.clear()
            self._by_presence[present] = driver
        return driver

    def of(self, channel: str) -> Driver:
        """Return who sends a channel; if it was never heard, who is there."""
        driver = self._of.get(channel)
        if driver is None:
            if not self.all:
                self.all.append(Driver(set()))
            driver = self._of[channel] = self.all[0]
            driver.channels.add(channel)
        return driver

    def serving(self, channels: Mapping[str, Any]) -> dict[Driver, list[str]]:
        """Return these channels by who sends them."""
        result: dict[Driver, list[str]] = {}
        for channel in channels:
            result.setdefault(self.of(channel), []).append(channel)
        return result
