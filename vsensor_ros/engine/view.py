"""
What can be seen of an engine: what each channel is, and what its reserve would be good for.

It only looks: nothing here changes what goes out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
import math
from types import MappingProxyType
from typing import Any

from vsensor_ros.bank import Bank
from vsensor_ros.engine.channel import Channel, NONE, REAL, VIRTUAL
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.decision import Decision, Source
from vsensor_ros.engine.events import Functional, Reserve
from vsensor_ros.engine.stand_in import StandIn
from vsensor_ros.engine.state import ChannelState
from vsensor_ros.engine.stream import Stream
from vsensor_ros.engine.switch import Switch
from vsensor_ros.observers import Design, FAULT, Refusal
from vsensor_ros.reason import Reason

Counts = Mapping[str, Mapping[Reason, int]]  # by channel


class View:
    """Looks at the channels of an engine, given its switch as it is now."""

    def __init__(self, design: Design, bank: Bank, clock: Clock, streams: Sequence[Stream],
                 stand_in: StandIn) -> None:
        self._design, self._bank, self._clock = design, bank, clock
        self._streams, self._stand_in = streams, stand_in
        # by what is wanted: the fault sets that it is designed for, the smallest first
        self._wanted = {name: sorted((fault_set for (fault_set, channel), entry
                                      in design.entries.items() if channel == name
                                      and not isinstance(entry, Refusal)), key=len)
                        for name in design.wanted}

    def sources(self, switch: Switch) -> list[tuple[str, int]]:
        """Return what the channels are, with the number of their switches."""
        return [(self._is(switch, stream, channel)[0], channel.switches)
                for stream in self._streams for channel in stream.channels]

    def _is(self, switch: Switch, stream: Stream,
            channel: Channel) -> tuple[str, Reason | None]:
        return channel.state(switch.decisions[channel.name],
                             stream.why_silent(channel.name), stream.why_odd(channel.name))

    def would(self, switch: Switch, name: str) -> Decision:
        """Return what would be decided for a sensor if it failed now."""
        return switch.reserve(name, self._clock.lasting(), self._stand_in)

    def _who_would(self, switch: Switch, name: str,
                   would: Decision) -> tuple[str, ...] | None:
        """Return whose virtual sensor would serve, or comes nearest to that; None: nobody's."""
        if would.source is Source.VIRTUAL:
            return would.fault_set
        return next(iter(switch.choice.candidates(switch.faulty | {name}, name)), None)

    def reserves(self, switch: Switch) -> list[Reserve]:
        """Return what could be said in place of each healthy sensor, at the bank's time."""
        found, time = [], self._bank.time
        for name, channel in ((c.name, c) for stream in self._streams if stream.active
                              for c in stream.channels):
            if name in switch.faulty:
                continue
            would = self.would(switch, name)
            key = self._who_would(switch, name, would)
            said = None if key is None or time is None else self._bank.recall(key, name, time)
            if said is not None:
                reading = self._bank.beside(name)
                reading = math.nan if reading is None else channel.as_said(reading)
                found.append(Reserve(name, reading, channel.as_said(said[0], near=reading),
                                     said[1], would.source is Source.VIRTUAL))
        return found

    def functionals(self, switch: Switch) -> list[Functional]:
        """Return what is wanted besides sensors, at the bank's time; faults, too."""
        found = []
        for name, sets in self._wanted.items():
            channel = name.removeprefix(FAULT)
            of_sensor = name != channel and channel in self._design.sensors
            keys = switch.choice.candidates(switch.faulty | {channel}, channel) if of_sensor \
                else [key for key in sets if switch.faulty <= frozenset(key)]
            said = self._said(name, channel if of_sensor else name, keys, of_sensor)
            found += [] if said is None else [said]
        return found

    def _said(self, name: str, channel: str, keys: Sequence[tuple[str, ...]],
              fault: bool) -> Functional | None:
        """
        Return what the first of these who is ready says, else who runs; None: nobody does.

        fault: not the channel, but by how much its last reading is off, believed or not.
        """
        running = [key for key in keys if self._bank.estimate(key, channel) is not None]
        ready = next((key for key in running if self._bank.ready(key, channel)), None)
        key = ready or next(iter(running), None)
        value = None if key is None else self._bank.estimate(key, channel)
        if key is None or value is None:
            return None
        interval = self._bank.interval(key, channel)
        if fault:
            size = self._bank.residual(key, channel)
            if size is None:
                return None
            if interval is not None:
                interval = size + value - interval[1], size + value - interval[0]
            value = size
        return Functional(name, value, self._bank.deviation(key, channel), interval,
                          ready is not None)

    def channels(self, switch: Switch, isolated: Mapping[str, int],
                 blamed: Mapping[str, tuple[str, ...]], counts: Counts,
                 standstill: Reason | None) -> tuple[ChannelState, ...]:
        """
        Return how each channel is, stream by stream.

        isolated: since when, as time lasts. blamed: by whom they are. counts: what was not used
        or sent. standstill: why time does not go on.
        """
        outside = by_channel(((name, key), n) for (key, name), n in
                             self._bank.outside_domain.items())
        restarts = by_channel(((name, key), n) for (key, name), n in
                              self._bank.restarts.items())
        return tuple(
            replace(self._state(switch, stream, channel, isolated.get(channel.name), standstill),
                    outside_domain=sum(outside.get(channel.name, {}).values()),
                    restarts=sum(restarts.get(channel.name, {}).values()),
                    isolated_by=blamed.get(channel.name, ()),
                    counts=MappingProxyType(dict(counts.get(channel.name, {}))))
            for stream in self._streams for channel in stream.channels)

    def _residual(self, switch: Switch, name: str, fault_set: tuple[str, ...]) -> float:
        """Return the last reading of a faulty sensor - its estimate; NaN when not known."""
        known = self._bank.residual(fault_set, name) if name in switch.faulty else None
        return math.nan if known is None else known

    def _state(self, switch: Switch, stream: Stream, channel: Channel, isolated: int | None,
               standstill: Reason | None) -> ChannelState:
        name, lasting = channel.name, self._clock.lasting()
        faulty = tuple(s for s in self._design.sensors if s in switch.faulty)
        decision = switch.decisions[name]
        source, reason = self._is(switch, stream, channel)
        fault_set, serves, value, deviation, interval = faulty, None, channel.value, math.inf, None
        if standstill is not None and (
                source == VIRTUAL or source == REAL and stream.composer.composes(name)):
            source, value = NONE, math.nan  # for nothing is composed meanwhile
            reason = Reason.of('instead', why=standstill, instead=Reason('stop'))
        elif source == VIRTUAL:
            fault_set = decision.fault_set
            entry = self._bank.entry(fault_set, name)
            serves = None if isinstance(entry, Refusal) else entry
            deviation = self._bank.deviation(fault_set, name)
            interval = channel.beside(self._bank.interval(fault_set, name),
                                      self._bank.estimate(fault_set, name), lasting)
        elif source == NONE:
            value = math.nan
        else:
            deviation, fault_set = 0.0, ()
            if stream.plain:
                value = stream.heard.latest(name)
        if decision.source is not Source.REAL:
            silence = stream.composer.driver_silence(name)
            if silence is not None:
                reason = silence if reason is None else \
                    Reason.of('both', first=reason, second=silence)
        recovering, would = switch.recovering.get(name), self.would(switch, name)
        reserve = fault_set if serves is not None else self._who_would(switch, name, would)
        key = reserve or (name,)
        return ChannelState(
            name, stream.plan.output, self._design.units.get(name, ''), source, reason, fault_set,
            '' if serves is None else serves.grade, value, deviation, interval,
            channel.blend.left(lasting), channel.switches, channel.blend.step,
            _seconds(channel.since, lasting), channel.virtual_time(lasting) * 1e-9,
            name in switch.forced, _seconds(isolated, lasting),
            _seconds(recovering, lasting), self._residual(switch, name, key), serves,
            self._bank.outside_region(key, name), 0, 0, {}, channel.readings,
            stream.never_seen or (None if would.source is Source.VIRTUAL else would.reason),
            self._bank.deviation(key, name), self._bank.measured(key, name),
            self._stand_in.remaining(key, name) if source != NONE else math.inf)


def by_channel(counts: Iterable[tuple[tuple[str, Any], int]]) -> dict[str, dict[Any, int]]:
    """Return what was counted of what, by channel."""
    found: dict[str, dict[Any, int]] = {}
    for (name, what), count in counts:
        found.setdefault(name, {})[what] = count
    return found


def _seconds(since: int | None, now: int) -> float:
    """Return what has passed since a time [ns] in s; NaN since none."""
    return math.nan if since is None else (now - since) * 1e-9
