"""
What the replacer says on ``/diagnostics``: one status a channel, with a remedy in words.

Each sentence says what is, why, and what to do about it. They are made of snapshots, in the
executor's thread; nothing here touches the loop.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
import math

from diagnostic_msgs.msg import DiagnosticStatus

from vsensor_ros.engine import ChannelState, EngineState, Policy
from vsensor_ros.node.reserve import Chance, chance, Origin, without_reserve
from vsensor_ros.observers import Design
from vsensor_ros.reason import Reason

LEVELS = {
    'real': DiagnosticStatus.OK,
    'silent': DiagnosticStatus.STALE,
    'virtual': DiagnosticStatus.WARN,
    'none': DiagnosticStatus.ERROR,
}
WINDOW = 60.0  # s that count as lately
MANY = 6  # switches of a channel lately that are a whipsaw: three faults
STATES = {
    'inactive': 'inactive; nothing goes out',
    'starting': 'starting; nothing goes out before it is known what isolation said',
    'active': 'active',
}
FAULTY = 'faulty sensors'  # key of each channel's status
# keys by which one knows what a replacer says of a channel and of itself
MARKS = frozenset({FAULTY, 'spoken_of'})
LOOP = 'the loop'  # name of the status that is about no channel; no sensor can be called so


@dataclass
class Lately:
    """How much counters have grown within the last WINDOW."""

    _seen: dict[str, deque[tuple[float, int]]] = field(default_factory=dict)

    def grown(self, name: str, count: int, now: float) -> int:
        """Note what a counter has come to at a time [s]; return by how much it grew lately."""
        seen = self._seen.setdefault(name, deque([(now, count)]))
        if seen[-1][1] != count:
            seen.append((now, count))
        while len(seen) > 1 and now - seen[1][0] > WINDOW:
            seen.popleft()
        # the first is from before the window, the last before it or in it
        return count - seen[0][1]


@dataclass(frozen=True)
class Report:
    """What is told of one channel, or of the node."""

    name: str
    level: bytes
    message: str  # what is, why, what to do
    topic: str
    source: str


@dataclass(frozen=True)
class Scene:
    """What is the same for all channels of one report."""

    node: str  # its full name, below which its services are
    design: Design
    policies: Mapping[str, Policy]
    faulty: tuple[str, ...]  # the effective set, in the design's order
    complaints: Mapping[str, Sequence[str]]  # by channel: what others do on its topics
    switches: Mapping[str, int]  # by channel: lately
    # channels whose reserve has been lacking for long, though it could be mended
    lacking: Collection[str] = ()
    origins: Mapping[str, Origin] = field(default_factory=dict)  # by sensor and command


def describe(channel: ChannelState, scene: Scene, sharing: Collection[str]) -> Report:
    """Say what a channel does and why; `sharing` are the channels in the same message."""
    name, source = channel.name, channel.source
    if source == 'real':
        parts = ['real', *([str(channel.reason)] if channel.reason else [])]  # a force waits
        if channel.reason is not None and channel.reason.code == 'input of another clock':
            parts.append(f'no virtual sensor can use it: stamp {name} with the clock of this '
                         'node, or set use_sim_time alike')
    elif source == 'silent':
        parts = [str(channel.reason), f'check the driver of {name}']
    elif source == 'virtual':
        why, *more = _taken_apart(channel.reason)
        parts = [_virtual(channel, why), *map(str, more), *_remedies(channel, scene)]
    elif name in scene.faulty:
        parts = [f'no valid source ({channel.reason})', *_remedies(channel, scene)]
        if (scene.faulty, name) not in scene.design.entries:
            parts[-1] += f', or make a design for {{{", ".join(scene.faulty)}}}'
    else:
        failed = [s for s in scene.faulty if s in sharing]
        parts = [f'healthy, but nothing goes out with it ({channel.reason})',
                 f'repair {", ".join(failed)}' if failed else f'check the driver of {name}']
    parts += scene.complaints.get(name, ())
    lately = scene.switches.get(name, 0)
    if lately >= MANY:
        parts.append(f'switched {lately} times in {WINDOW:g} s: lengthen sensors.{name}.dwell, or '
                     f'set sensors.{name}.recovery to hold')
    level = LEVELS[source]
    if level == DiagnosticStatus.OK and len(parts) > 1:
        level = DiagnosticStatus.WARN
    if source == 'real' and chance(channel.reserve) in (Chance.PASSES, Chance.MEND):
        assert channel.reserve is not None
        parts += without_reserve(name, channel.reserve, scene.origins)
        level = DiagnosticStatus.WARN if name in scene.lacking else level
    return Report(name, level, '; '.join(parts), channel.topic, source)


def _taken_apart(reason: Reason | None) -> list[Reason | None]:
    """Return why a sensor is not believed, then what else there is to say of its estimate."""
    if reason is not None and reason.code == 'both':
        return [*_taken_apart(reason.fact('first')), reason.fact('second')]
    if reason is not None and reason.code == 'served by a superset':
        return [reason.fact('why'), reason.fact('exact')]
    return [reason]


def _virtual(channel: ChannelState, why: Reason | None) -> str:
    serves = channel.serves
    text = 'virtual'
    # of a force and of a recovery the remedy says it
    if why is not None and not channel.forced and math.isnan(channel.recovering_s):
        text += f' ({why})'
    if serves is None:
        return text
    text += f', from {", ".join((*serves.reads, *serves.commands)) or "nothing"}'
    if math.isfinite(channel.deviation):
        text += f', good to {channel.deviation:.2g} {channel.unit}'.rstrip()
    if math.isfinite(channel.remaining_s):
        text += f', for {channel.remaining_s:.2g} s more'
    return text + (', but unknown inputs still disturb it' if channel.grade == 'bounded' else '')


def _remedies(channel: ChannelState, scene: Scene) -> list[str]:
    """Return what brings a failed channel back to its sensor, by way of what holds it."""
    name = channel.name
    policy = scene.policies.get(name, Policy())
    since = channel.recovering_s
    remedies = []
    if channel.forced:
        remedies.append(f'forced; {scene.node}/{name}/force with false releases it')
    if not math.isnan(since):
        if policy.recovery == 'latched':
            remedies.append(f'{name} is healthy again, but latched; {scene.node}/reset gives it '
                            'back')
        elif policy.recovery == 'automatic':
            remedies.append(f'{name} is healthy again since {since:.1f} s, returns after '
                            f'{policy.dwell:g} s')
        else:
            remedies.append(f'{name} is healthy again; call {scene.node}/{name}/clear to give it '
                            'back')
    return remedies or [f'repair {name}']


def describe_loop(engine: EngineState, state: str, left_out: int, complaints: Collection[str],
                  thrown_away: int = 0) -> Report:
    """Say how the node keeps up, in a state of STATES; left_out and thrown_away: lately."""
    parts = [STATES[state]]
    if state == 'active' and engine.ticks == 0:
        parts.append('no tick yet; with use_sim_time, check that /clock is published')
    elif state == 'active' and engine.stopped is not None:
        parts.append(f'{engine.stopped}; nothing virtual goes out until it moves on')
    if left_out:
        parts.append(f'{left_out} ticks left out in {WINDOW:g} s: this computer is too busy; '
                     'lower the rate, or give the node more of it')
    if thrown_away:
        parts.append(f'{thrown_away} messages of isolation thrown away in {WINDOW:g} s, too many '
                     'or too large, so a fault may be missed; find who sends them')
    parts += [str(command.trouble) for command in engine.commands if command.trouble is not None]
    parts += complaints
    level = DiagnosticStatus.OK if parts == ['active'] else DiagnosticStatus.WARN
    return Report(LOOP, level, '; '.join(parts), '', state)


def channel_facts(channel: ChannelState, scene: Scene, rate: float) -> dict[str, object]:
    """Return what somebody who looks closer at a channel wants to know; rate [Hz] of readings."""
    facts: dict[str, object] = {
        'source': channel.source,
        FAULTY: ', '.join(scene.faulty) or 'none',
        'switches': channel.switches,
        'last step': number(channel.last_step),
        'reserve': channel.reserve or 'ready',
    }
    if not math.isnan(channel.since_s):
        facts['since [s]'] = f'{channel.since_s:.1f}'
    if channel.source == 'virtual':
        facts.update({'deviation': number(channel.deviation), 'offset': number(channel.offset)})
        if math.isfinite(channel.remaining_s):
            facts['remaining [s]'] = f'{channel.remaining_s:.1f}'
    elif channel.reserve is None:
        facts['reserve deviation'] = number(channel.reserve_deviation)
    if channel.rehearsed is not None:
        facts['residual of the last minute, rms'] = number(channel.rehearsed.rms)
        facts['within two deviations'] = f'{100.0 * channel.rehearsed.within:.0f} %'
    if channel.serves is not None:
        facts.update({'fault set': ', '.join(channel.fault_set), 'grade': channel.grade,
                      'order': channel.serves.order, 'method': channel.serves.method})
    if channel.outside_region:
        facts['outside its region'] = 'yes: its convergence is not proved there'
    if channel.outside_domain:
        facts['steps outside a domain'] = channel.outside_domain
    if channel.restarts:
        facts['restarts, infinite'] = channel.restarts
    return {**facts, 'readings [Hz]': number(rate), **{
        str(why): count for why, count in channel.counts.items()}}


def number(value: float) -> str:
    """Write a number so that people and programs can read it."""
    return f'{value:.6g}'


def encode(statuses: Iterable[tuple[str, Report, Mapping[str, object]]], stamp: int) -> bytes:
    """
    Serialize a DiagnosticArray of (name, report, facts), stamped in ns.

    rclpy would hold the interpreter's lock while it converts a thousand strings (2 ms at fifty
    channels), and with it the loop; this can be interrupted. Source: CDR, as in DDS-RTPS 10.2.
    """
    out = bytearray(b'\x00\x01\x00\x00')  # little endian

    def put(*parts: bytes) -> None:
        for part in parts:
            out.extend(_PADS[-len(out) % 4])
            out.extend(part)

    told = list(statuses)
    put(*(_count(part) for part in divmod(stamp, 10**9)), _text(''),  # frame_id
        _count(len(told)))
    for name, report, facts in told:
        out.extend(report.level)
        put(_text(name), _text(report.message), _text(report.topic), _count(len(facts)))
        for key, fact in facts.items():
            put(_text(key), _text(str(fact)))
    return bytes(out)


def _count(number: int) -> bytes:
    return number.to_bytes(4, 'little')


@lru_cache(maxsize=4096)  # most of what is told is told every time
def _text(value: str) -> bytes:
    raw = value.encode('utf-8', 'replace') + b'\0'
    return _count(len(raw)) + raw


_PADS = tuple(bytes(n) for n in range(4))
