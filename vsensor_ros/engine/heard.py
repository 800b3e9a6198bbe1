"""What the channels of a stream say: the last of each, when, and why one says nothing."""

from __future__ import annotations

from collections.abc import Mapping
import math

from vsensor_ros.engine.clock import Clock
from vsensor_ros.reason import Reason

ONLY_NAN = Reason('only NaN')


class Heard:
    """What was heard of each channel, by the engine's clock. Times are in ns."""

    def __init__(self, max_age: Mapping[str, int], clock: Clock) -> None:
        """Begin with nothing heard; max_age: by channel, beyond which it is silent."""
        self._max_age, self._clock = max_age, clock
        self._latest: dict[str, float] = {}  # by channel: what it said
        self._at: dict[str, int] = {}  # and when
        self._lacks: dict[str, tuple[Reason, int]] = {}  # why it did not, and when

    def note(self, name: str, value: float, now: int) -> None:
        """Note what a channel says; with NaN it is there, but says nothing."""
        self._latest[name] = value
        if math.isnan(value):
            self._lacks[name] = ONLY_NAN, now
        else:
            self._at[name] = now

    def lack(self, name: str, reason: Reason, now: int) -> None:
        """Note why something that arrived says nothing of a channel."""
        self._lacks[name] = reason, now

    def leap(self, ahead: int) -> None:
        """Take no time for silence that the clock left out."""
        self._at = {name: at + ahead for name, at in self._at.items()}
        self._lacks = {name: (why, at + ahead) for name, (why, at) in self._lacks.items()}

    def forget(self) -> None:
        """Begin anew after the clock went back."""
        self._at.clear()
        self._lacks.clear()

    def ever(self, name: str) -> bool:
        """Tell whether a channel has ever spoken, since the clock went back."""
        return name in self._at or self._lacks.get(name, (None, 0))[0] == ONLY_NAN

    def latest(self, name: str) -> float:
        """Return what a channel said last, NaN before it spoke."""
        return self._latest.get(name, math.nan)

    def fresh(self, name: str) -> bool:
        """Tell whether a channel has spoken within its max_age."""
        at = self._at.get(name)
        return at is not None and self._clock.now - at <= self._max_age[name]

    def silence(self, name: str) -> int | None:
        """Return the time since a channel spoke, whatever its stamp; None before it did."""
        at = self._at.get(name)
        return None if at is None else self._clock.now - at

    def why_nothing(self, name: str, topic: str) -> Reason:
        """Return why a channel that is not fresh says nothing on a topic."""
        reason, at = self._lacks.get(name, (None, 0))
        if reason is None or self._clock.now - at > self._max_age[name]:
            return Reason.of('nothing comes', topic=topic)
        if reason == ONLY_NAN:
            return Reason.of('only NaN on', topic=topic)
        return Reason.of('useless messages', topic=topic, why=reason)
