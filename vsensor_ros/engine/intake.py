"""What comes in, and what of it is not used: readings on their way to the bank."""

from __future__ import annotations

from collections import Counter, deque

from vsensor_ros.bank import Bank
from vsensor_ros.engine.channel import Channel
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.events import Message, Remark
from vsensor_ros.engine.own_isolator import OwnIsolator
from vsensor_ros.engine.stream import is_absent, Stream
from vsensor_ros.reason import Reason

SLOW = 3  # intervals longer than max_age in a row that make a slow sensor of a silent one
MOST_REMARKS = 1000  # kept for people


class Intake:
    """Takes readings; counts what is not used, of commands too, by channel and reason."""

    def __init__(self, bank: Bank, clock: Clock, own: OwnIsolator | None = None) -> None:
        """Begin; own: the engine's own isolator, which takes all readings, too."""
        self.held: dict[str, float] = {}  # by sensor: the last value worth holding
        self._counts: Counter[tuple[str, Reason]] = Counter()
        self._remarks: deque[Remark] = deque(maxlen=MOST_REMARKS)
        self._counted: dict[tuple[str, Reason], None] = {}  # since people were told last
        self._bank, self._clock, self.own = bank, clock, own
        self._last: dict[str, int] = {}  # by sensor: its last stamp
        self._long: dict[str, int] = {}  # by sensor: long intervals in a row
        self._slow: set[str] = set()  # sensors that were said to be

    def count(self, name: str, why: Reason, quietly: bool = False) -> None:
        """Count, and say now and then, what of a channel was not used or not sent, and why."""
        self._counts[name, why] += 1
        if not quietly:
            self._counted[name, why] = None

    def note(self, name: str, why: Reason) -> None:
        """Say now and then what of a channel the bank does not use, which it counts itself."""
        self._counted[name, why] = None

    def say(self, level: str, what: Reason, subject: object = None) -> None:
        """Let people hear something; the subject is itself if not given."""
        self._remarks.append(Remark(level, what, what if subject is None else subject))

    def counts(self) -> Counter[tuple[str, Reason]]:
        """Return how often what was not used or not sent, by channel and reason."""
        return self._counts + self._bank.refused

    def remarks(self) -> list[Remark]:
        """Return what is to be said to people, once; of what was counted the last number."""
        if not self._remarks and not self._counted:
            return []
        counts = self.counts()
        said = [*self._remarks, *(
            Remark('warning', Reason.of('counted', name=key[0], why=key[1], count=counts[key]),
                   key) for key in self._counted)]
        self._remarks.clear()
        self._counted.clear()
        return said

    def readings(self, stream: Stream, message: Message, received: int) -> None:
        """
        Take what a message says of its channels.

        received: when it came, by the system's clock; its time when it has no stamp.
        """
        now = self._clock.now
        if received > now and not self._clock.simulated:
            now = received  # after the clock was looked at, which is a while ago when all is busy
        stamp = message.stamp or self.arrival(received)
        for channel, value in zip(stream.channels, message.values):
            if value.__class__ is float:
                channel.readings += 1
                if stamp:
                    self._feed(channel, stamp, value, now)
            elif not message.foreign and not (
                    is_absent(value) and stream.heard.fresh(channel.name)):
                assert isinstance(value, Reason)  # no other driver sends it, either
                self.count(channel.name, value)

    def forget(self) -> None:
        """Begin anew after the clock jumped."""
        self._last.clear()
        self._long.clear()

    def arrival(self, received: int) -> int:
        """Return when a message came, which counts if it has no stamp; 0: time has not begun."""
        return self._clock.now if self._clock.simulated else received

    def _feed(self, channel: Channel, stamp: int, value: float, now: int) -> None:
        name = channel.name
        reason = self._bank.take(name, stamp, value, now)
        if self.own is not None:
            self.own.take(name, stamp, value, now)
        if reason is None:
            self.held[name] = value
            before, self._last[name] = self._last.get(name, stamp), stamp
            if stamp - before > channel.max_age:
                self._time(channel, stamp - before)
            elif name in self._long:
                del self._long[name]
        elif reason.code != 'isolated':  # what it says then is compared, and not worth a word
            self.note(name, reason)

    def _time(self, channel: Channel, interval: int) -> None:
        """Say once when a sensor is slower than the silence that makes it invalid."""
        name = channel.name
        self._long[name] = self._long.get(name, 0) + 1
        if self._long[name] == SLOW and name not in self._slow:
            self._slow.add(name)
            self.say('warning', Reason.of(
                'slow sensor', name=name, seconds=interval * 1e-9,
                max_age=channel.max_age * 1e-9), ('slow', name))
