"""
What would not work, of what was heard and seen; pure, no ROS.

Each finding says where, what and the mend. FAIL: something would not work when a sensor fails, or
does not now. WARN: it works, but worse than it should. NOTE: worth knowing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
import math
import re
from typing import Protocol

from vsensor_ros.commissioning.likeness import bracketed, nearest, nearest_topic
from vsensor_ros.reason import Reason

NOTE, WARN, FAIL = range(3)
INPUT, COMMAND, OUTPUT, ISOLATION = 'input', 'command', 'output', 'isolation'
LATE = 0.05  # s between arrival and stamp, or of its spread, from which it is worth a word
AHEAD = 0.1  # s that a stamp may lie ahead of the clock; beyond, a reading is refused
ELSEWHERE = 60.0  # s from which stamps are those of another clock
REPEATED = 0.5  # part of the stamps that may be that of the message before
MOST_NAMED = 6  # names that are listed


@dataclass(frozen=True)
class Finding:
    """Something that is not as it should be."""

    level: int
    topics: tuple[str, ...]  # that it is about; () when about none
    channel: str  # that it is about alone; '' when about none, or all of the topic
    problem: str
    mend: str  # '' when the problem says it

    def __str__(self) -> str:
        return f'{self.problem}; {self.mend}' if self.mend else self.problem


class Party(Protocol):
    """A node at the other end of a topic."""

    @property
    def node(self) -> str:
        """Its full name."""

    @property
    def type(self) -> str:
        """The type that it has there."""

    @property
    def mismatch(self) -> str:
        """How its QoS does not fit; '' when it does."""

    @property
    def mend(self) -> str:
        """What to do about that."""


class Field(Protocol):
    """What a field said; see `FieldHeard`."""

    found: int
    nan: int
    lack: Reason | None


class Sound(Protocol):
    """What was heard on a topic; see `Heard`."""

    count: int
    unreadable: int
    longest: float
    returns: int
    repeated: int
    names: dict[str, None]

    @property
    def rate(self) -> float:
        """Messages a second."""

    @property
    def age(self) -> tuple[float, float]:
        """Arrival - stamp, and its spread [s]."""


@dataclass(frozen=True)
class Use:
    """One topic that the parameters name, and what was found there."""

    topic: str
    type: str
    role: str
    # by sensor or command: the field, and what it said; for an output: its sensors
    channels: Mapping[str, str]
    publishers: tuple[Party, ...] = ()
    listeners: tuple[Party, ...] = ()
    heard: Sound | None = None
    fields: Mapping[str, Field] = field(default_factory=dict)  # by path
    output: str = ''  # of an input: where it goes on
    chosen: Mapping[str, str] = field(default_factory=dict)  # by channel: the node that counts


@dataclass(frozen=True)
class World:
    """What else must be known to judge a topic."""

    node: str  # full name of the replacer
    seconds: float  # that were listened
    topics: Mapping[str, str]  # that anybody publishes on, with their types
    used: frozenset[str]  # topics that the parameters name
    max_age: Mapping[str, float]  # s, by sensor
    isolates: bool  # the replacer: silence is a fault of every sensor, or its isolator acts
    simulated: bool  # use_sim_time
    clock_moves: bool  # /clock was heard, and went on
    clock_publishers: tuple[str, ...]
    now: float = 0.0  # s, of the replacer's clock

    def strangers(self) -> dict[str, str]:
        """Return the topics that the parameters do not name."""
        return {t: kind for t, kind in self.topics.items() if t not in self.used}


def judge(use: Use, uses: Mapping[tuple[str, str], Use], world: World) -> list[Finding]:
    """Return what is wrong with one topic; uses: all, by topic and role."""
    if use.role == OUTPUT:
        return _output(use, uses, world)
    found = _published(use, uses, world)
    if use.role != ISOLATION and use.heard is not None and use.heard.count:
        found += _fields(use) + _stamps(use, world) + _rates(use, world) + _twice(use)
    return found + _chosen(use)


def judge_clock(world: World) -> list[Finding]:
    """Return what is wrong with the time."""
    who = ', '.join(world.clock_publishers)
    if world.simulated and not world.clock_moves:
        return [Finding(FAIL, ('/clock',), '', 'use_sim_time is true, but ' + (
            f'/clock of {who} stands still' if who else 'nobody publishes /clock'),
            'start the simulation or the recording, or set use_sim_time: false')]
    if not world.simulated and who:
        return [Finding(WARN, ('/clock',), '', f'{who} publishes /clock, but use_sim_time is '
                        'false', 'set use_sim_time: true if the drivers stamp by it')]
    return []


def logged(errors: Iterable[str], topics: Iterable[str]) -> list[Finding]:
    """Return what the replacer itself would log as errors, each with the topics that it names."""
    there = list(dict.fromkeys(topics))
    found = []
    for text in errors:
        first, *more = text.strip().splitlines() or ['']
        line = more[-1] if more and first.startswith('Traceback') else first
        found.append(Finding(WARN, tuple(
            topic for topic in there
            if re.search(rf'(?<![\w/]){re.escape(topic)}(?![\w/])', line)), '', line, ''))
    return found


# ------------------------------------------------------------------------ who publishes there


def _published(use: Use, uses: Mapping[tuple[str, str], Use], world: World) -> list[Finding]:
    if not use.publishers:
        return [] if use.heard is not None and use.heard.count else [_nobody(use, uses, world)]
    found = []
    right = [p for p in use.publishers if p.type == use.type]
    for other in use.publishers:
        if other.type != use.type:
            found.append(Finding(
                FAIL, (use.topic,), '', f'{other.node} publishes {other.type} on {use.topic}, the '
                f'file says {use.type}', f'set the type to {other.type}, and the field with it'))
        elif other.mismatch:
            found.append(Finding(
                FAIL, (use.topic,), '', f'the QoS of {other.node} on {use.topic} does not fit '
                f'({other.mismatch}), so nothing is heard', other.mend))
    if right and not found and use.heard is not None and not use.heard.count:
        who = ', '.join(dict.fromkeys(p.node for p in right))
        found.append(Finding(
            FAIL, (use.topic,), '', f'{_never(use)} in {world.seconds:.0f} s: {who} is there, but '
            'says nothing', f'look at it: ros2 topic hz {use.topic}'
            if use.role == INPUT else 'command it once, or have it repeated'))
    return found


def _never(use: Use) -> str:
    have = 'were' if len(use.channels) > 1 else 'was'
    return f'{", ".join(use.channels)} {have} never heard on {use.topic}'


def _nobody(use: Use, uses: Mapping[tuple[str, str], Use], world: World) -> Finding:
    """Say that nobody publishes, and what was meant."""
    output = uses.get((use.output, OUTPUT))
    if use.role == INPUT and output is not None:
        drivers = [p.node for p in output.publishers if p.node != world.node]
        if drivers:
            return Finding(
                FAIL, (use.topic, use.output), '', f'{_never(use)}: {", ".join(drivers)} '
                f'publishes on {use.output} itself',
                f'remap it there: --ros-args -r {use.output}:={use.topic}')
    near = nearest_topic(use.topic, world.strangers(), use.type)
    if use.role == ISOLATION:
        return Finding(
            WARN if world.isolates else FAIL, (use.topic,), '', 'nobody publishes on the '
            f'isolation topic {use.topic}, so no fault would be told',
            f'did you mean {near}?' if near else 'start the fault isolation, set '
            'isolation.topic to where it speaks, or let the replacer find out by itself, with '
            'isolator.mode act')
    mend = 'start its driver' if use.role == INPUT else 'start whoever commands it'
    if near:
        return Finding(FAIL, (use.topic,), '', _never(use), f'did you mean {near}?')
    return Finding(FAIL, (use.topic,), '', f'{_never(use)}: nobody publishes there',
                   f'{mend}, or correct the topic')


# ------------------------------------------------------------------------------ what they say


def _fields(use: Use) -> list[Finding]:
    """Find fields that were never there, or not always."""
    assert use.heard is not None
    found = []
    if use.heard.unreadable:
        found.append(Finding(
            FAIL, (use.topic,), '', f'{use.heard.unreadable} of {use.heard.count} messages on '
            f'{use.topic} are no {use.type}', 'build its publisher with the same messages'))
    for name, path in use.channels.items():
        said = use.fields[path]
        if said.found and said.nan:
            found.append(Finding(
                WARN, (use.topic,), name, f'{name} is NaN in {said.nan} of {use.heard.count} '
                f'messages on {use.topic}', 'see whether its driver means that'))
        elif said.found or use.heard.unreadable == use.heard.count:
            continue
        elif said.nan:
            found.append(Finding(
                FAIL, (use.topic,), name, f'{name}: nothing but NaN in {path} on {use.topic}',
                'name the field that its driver fills in'))
        else:
            found.append(Finding(
                FAIL, (use.topic,), name, f'{name}: {said.lack} on {use.topic}',
                _meant(path, use.heard.names)))
    return found


def _meant(path: str, names: Iterable[str]) -> str:
    """Say which element was meant, of those that messages have."""
    start, bracket, element = path.rpartition('[')
    there = list(names)
    element = element.strip("]'\"")
    if not bracket or not there or element in there:
        return 'name a field that its messages have'
    near = nearest(element, there)
    if near is not None:
        return f'did you mean {start}{bracketed(near)}?'
    more = f' and {len(there) - MOST_NAMED} more' if len(there) > MOST_NAMED else ''
    return f'there are {", ".join(there[:MOST_NAMED])}{more}'


def _stamps(use: Use, world: World) -> list[Finding]:
    assert use.heard is not None
    age, spread = use.heard.age
    if math.isnan(age) or (world.simulated and not world.clock_moves):
        return []  # there is nothing to judge by
    oldest = max((world.max_age.get(name, math.inf) for name in use.channels), default=math.inf)
    serious = FAIL if use.role == INPUT else WARN  # a command counts from its arrival, then

    def say(level: int, what: str, mend: str) -> list[Finding]:
        return [Finding(level, (use.topic,), '', f'the stamps on {use.topic} {what}', mend)]
    own = 'its clock' if not world.simulated else '/clock'
    if abs(age) > ELSEWHERE:
        return [Finding(serious, (use.topic,), '', str(Reason.of(
            'input of another clock', name=use.topic, seconds=-age, clock=world.now)),
            'stamp with the ROS clock, and set use_sim_time alike')]
    if use.heard.repeated > REPEATED * use.heard.count:  # then they say nothing of lateness
        return say(serious if _between_stamps(use.heard) > oldest else WARN,
                   f'repeat: {use.heard.repeated} of {use.heard.count} are that of the message '
                   'before, so these readings are not used', 'stamp each when it is measured')
    if age < -AHEAD:
        return say(serious, f'are {_time(-age)} ahead of {own}',
                   'let both computers keep the same time (chrony), or set use_sim_time alike')
    if age > oldest:
        return say(FAIL, f'are {_time(age)} late, older than max_age ({oldest:g} s)', 'let both '
                   'computers keep the same time (chrony), find what delays it, or raise max_age')
    if age > LATE:
        return say(WARN, f'are {_time(age)} late', 'let both computers keep the same time '
                   '(chrony), or find what delays it')
    if spread > max(LATE, oldest / 2.0 if math.isfinite(oldest) else 0.0):
        return say(WARN, f'are uneven: {_time(age)} +- {_time(spread)} old', 'stamp when it is '
                   'measured, and find what delays it')
    return []


def _between_stamps(heard: Sound) -> float:
    """Return the time [s] between two stamps that differ, in the mean."""
    return heard.count / max(1, heard.count - heard.repeated - 1) / heard.rate


def _time(seconds: float) -> str:
    for size, unit in ((86400.0, 'days'), (3600.0, 'h'), (1.0, 's')):
        if seconds >= size * (1.0 if unit == 's' else 2.0):
            return f'{seconds / size:.3g} {unit}'
    return f'{seconds * 1e3:.0f} ms'


def _rates(use: Use, world: World) -> list[Finding]:
    assert use.heard is not None
    if use.role != INPUT or math.isnan(use.heard.rate):
        return []
    age = min(world.max_age[name] for name in use.channels)
    period = 1.0 / use.heard.rate
    if period > age:
        return [Finding(
            FAIL, (use.topic,), '', f'{use.topic} comes every {_time(period)}, but counts as '
            f'silent after max_age, {_time(age)}', f'raise max_age to {3.0 * period:.2g} or so')]
    if use.heard.longest > age:
        return [Finding(
            WARN, (use.topic,), '', f'{use.topic} stood still for {_time(use.heard.longest)}, '
            f'longer than max_age, {_time(age)}', 'find what holds it up, or raise max_age')]
    return []


def _twice(use: Use) -> list[Finding]:
    """Find several who publish the same fields."""
    assert use.heard is not None
    counted = Counter(p.node for p in use.publishers if p.type == use.type and not p.mismatch)
    if sum(counted.values()) < 2:
        return []
    who = ' and '.join(f'{node} ({n} times)' if n > 1 else node for node, n in counted.items())
    shared = [name for name, path in use.channels.items()
              if use.fields[path].lack is None  # it was in every message, whoever sent it
              and name not in use.chosen]
    if not shared:
        return []
    choose = ' and '.join(f'{_group(use)}.{name}.publisher' for name in shared)
    if use.heard.returns:
        return [Finding(FAIL, (use.topic,), '', f'{who} publish on {use.topic} in turn, both '
                        f'{", ".join(shared)}', 'end one, give it a topic of its own, or choose '
                        f'one with {choose}')]
    return [Finding(WARN, (use.topic,), '', f'{who} publish on {use.topic}, and their fields are '
                    'the same', 'end one, unless only one speaks at a time')]


def _group(use: Use) -> str:
    return 'commands' if use.role == COMMAND else 'sensors'


def _chosen(use: Use) -> list[Finding]:
    """Find nodes that were chosen and do not publish."""
    there = {p.node for p in use.publishers}
    return [Finding(FAIL, (use.topic,), name, f'{name}: {node} was chosen, and does not publish '
                    f'on {use.topic}', f'start it, or correct {_group(use)}.{name}.publisher')
            for name, node in use.chosen.items() if there and node not in there]


# --------------------------------------------------------------------------- where we would speak


def _output(use: Use, uses: Mapping[tuple[str, str], Use], world: World) -> list[Finding]:
    found = []
    others = [p.node for p in use.publishers if p.node != world.node]
    ours = len(use.publishers) - len(others)
    source = next(u for u in uses.values() if u.role == INPUT and u.output == use.topic)
    if others and source.publishers:  # else it is said of the input
        found.append(Finding(
            FAIL, (use.topic,), '', f'{", ".join(dict.fromkeys(others))} publishes on {use.topic} '
            'already, where the replacer is to speak', 'end it, or remap it: --ros-args -r '
            f'{use.topic}:={source.topic}'))
    if ours > 1:
        found.append(Finding(
            FAIL, (use.topic,), '', f'{ours} nodes called {world.node} publish on {use.topic}',
            'end all but one'))
    for other in use.listeners:
        if other.type != use.type:
            found.append(Finding(
                FAIL, (use.topic,), '', f'{other.node} listens for {other.type} on {use.topic}, '
                f'the file says {use.type}', 'correct the type of one'))
        elif other.mismatch:
            found.append(Finding(
                FAIL, (use.topic,), '', f'{other.node} would hear nothing on {use.topic}: its QoS '
                f'does not fit ({other.mismatch})', other.mend))
    return found
