"""How a replacer is now, in numbers and short words."""

from __future__ import annotations

from collections.abc import Sequence
import math
from typing import TYPE_CHECKING

from vsensor_ros.engine import Source
from vsensor_ros.engine.channel import NONE, VIRTUAL
from vsensor_ros.engine.state import ChannelState, Health, stands_still
from vsensor_ros.node.topics import Stream
from vsensor_ros.observers import VirtualSensor

if TYPE_CHECKING:
    from vsensor_ros.node.replacer import Replacer

WINDOW = 1_000_000_000  # ns that rates are taken over, at least


class Rates:
    """How many readings come in a second, over the last whole window between two looks."""

    def __init__(self) -> None:
        self._since = 0
        self._before: dict[str, int] = {}
        self._rates: dict[str, float] = {}

    def look(self, readings: dict[str, int], now: int) -> dict[str, float]:
        """Return the rates [Hz] by channel, given what has come in up to a steady time [ns]."""
        passed = now - self._since
        if passed >= WINDOW:
            if self._before:
                self._rates = {name: (count - self._before[name]) / (passed * 1e-9)
                               for name, count in readings.items()}
            self._since, self._before = now, readings
        return self._rates


def source(replacer: Replacer, stream: Stream, name: str) -> str:
    """Return where a channel's values come from: 'real', 'silent', 'virtual' or 'none'."""
    decided = replacer.switch.decisions[name].source
    if decided is not Source.REAL:
        return NONE if name in replacer.why or decided is Source.NONE else VIRTUAL
    if stream.why_silent(name, replacer.clock.now) is not None:
        return 'silent'
    return NONE if stream.drivers.of(name).problem else 'real'


def channel_states(replacer: Replacer, rates: dict[str, float]) -> list[ChannelState]:
    """Return how each channel is."""
    return [_state(replacer, stream, i, rates)
            for stream in replacer.streams for i in range(len(stream.sensors))]


def _state(replacer: Replacer, stream: Stream, i: int, rates: dict[str, float]) -> ChannelState:
    sensor, channel = stream.sensors[i], stream.channels[i]
    name, switch, lasting = sensor.name, replacer.switch, replacer.clock.lasting()
    decision, now = switch.decisions[name], source(replacer, stream, name)
    fault_set: Sequence[str] = tuple(s for s in switch.sensors if s in switch.faulty)
    serves, deviation, reason, value = None, math.inf, decision.reason, channel.value
    stopped = stands_still(replacer.clock_age())  # and so do the virtual sensors
    if now == VIRTUAL and stopped:
        now, reason, value = NONE, f'{stopped}; nothing goes out', math.nan
    elif now == VIRTUAL:
        fault_set = decision.fault_set
        entry = replacer.settings.design.entries.get((decision.fault_set, name))
        serves = entry if isinstance(entry, VirtualSensor) else None
        deviation = replacer.bank.deviation(decision.fault_set, name)
    elif now == NONE:
        reason = replacer.why.get(name) or stream.drivers.of(name).problem or reason
        value = math.nan
    else:
        deviation = 0.0
        reason = stream.why_silent(name, replacer.clock.now) or reason
        if stream.plain:
            value = stream.latest(name)
    if decision.source is not Source.REAL and (silence := stream.driver_silence(name)):
        reason = f'{reason}; {silence}' if reason else silence
    recovering = switch.recovering.get(name)
    return ChannelState(
        name, sensor.output, replacer.settings.design.units.get(name, ''), now, reason,
        tuple(fault_set), '' if serves is None else serves.grade, value, deviation,
        channel.blend.left(lasting), channel.switches, channel.blend.step,
        math.nan if channel.since is None else (lasting - channel.since) * 1e-9,
        channel.virtual_time(lasting) * 1e-9, name in switch.forced,
        math.nan if recovering is None else (lasting - recovering) * 1e-9, serves,
        {why: count for (of, why), count in replacer.counts.items() if of == name},
        rates.get(name, math.nan))


def health(replacer: Replacer) -> Health:
    """Return how the loop keeps up."""
    pace, switch = replacer.pace, replacer.switch
    return Health(
        replacer.settings.rate, pace.achieved(), *pace.step(), pace.jitter(replacer.bank.period),
        pace.overruns, dict(replacer.clock.jumps),
        tuple(s for s in switch.sensors if s in switch.faulty), pace.ticks,
        replacer.estimates.count, replacer.reports.not_used, replacer.reports.thrown_away,
        replacer.clock_age())
