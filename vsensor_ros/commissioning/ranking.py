"""
Which field of which topic is most likely a sensor or a command; pure, no ROS.

Every point has a reason that a person can judge, and the sum of the points is the score. A field
that is in another unit is no candidate at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import re

from vsensor_ros.commissioning.likeness import words_of
from vsensor_ros.commissioning.routes import RAW
from vsensor_ros.commissioning.units import one_spelling

SURE = 1.0  # points by which the best must be ahead of the next, to be taken unasked

SAME_UNIT, OTHER_MEANING = 3.0, 1.0  # the likeliest unit of the field; one that it may be in, too
NAMED, WORD, MEANING = 4.0, 2.0, 1.0  # the whole name; a word of it; a word that means the same
AXIS = 1.5  # the name says an axis, and it is this one; else it is taken off
MOVED, HEARD_BY, COMMANDED = 1.0, 1.0, 1.0
SILENT, EMPTY, MOVES = -1.0, -3.0, 0.5
MEASURING = 1.0  # a message of sensor_msgs: for sensors; taken off for commands
COUNTS = -1.0  # a whole number

# words that mean the same, each line
_MEANINGS = (
    ('position', 'angle', 'pos', 'theta', 'positions'),
    ('velocity', 'speed', 'rate', 'omega', 'gyro', 'vel', 'angular', 'twist', 'velocities'),
    ('acceleration', 'accel', 'accelerometer', 'acc'),
    ('effort', 'torque', 'force', 'current', 'load', 'moment'),
    ('range', 'level', 'distance', 'height', 'depth', 'gap'),
    ('temperature', 'temp'),
    ('pressure', 'baro', 'fluid'),
    ('voltage', 'volt', 'volts'),
    ('altitude', 'height', 'elevation'),
)
_COMMANDING = {'cmd', 'command', 'commands', 'setpoint', 'reference', 'target', 'desired', 'goal',
               'ref'}
_AXES = {'x': 'x', 'y': 'y', 'z': 'z', 'roll': 'x', 'pitch': 'y', 'yaw': 'z', 'heading': 'z',
         'forward': 'x', 'surge': 'x', 'sway': 'y', 'lateral': 'y', 'heave': 'z', 'climb': 'z'}
_USUAL_AXIS = {'rad/s': 'z', 'm/s': 'x', 'm/s^2': 'x', 'm': 'x', 'rad': 'z'}  # of a base


@dataclass(frozen=True)
class Wanted:
    """A sensor or a command of the plant."""

    name: str
    command: bool
    unit: str  # '' when not known
    hints: tuple[str, ...] = ()  # other names of it: of the state that it measures


@dataclass(frozen=True)
class Candidate:
    """One number in the messages of one topic, and what was heard of it."""

    topic: str
    type: str  # package/msg/Name
    field: str
    units: tuple[str, ...] = ()  # that it may be in, the likeliest first; () when not known
    element: str = ''  # name of its joint or the like
    whole: bool = False  # an integer
    heard: int = 0  # messages
    found: int = 0  # numbers among them
    low: float = 0.0
    high: float = 0.0
    rate: float = 0.0  # Hz
    published: bool = True
    listened: bool = False  # somebody hears the topic
    moved: bool = False  # the driver is on the topic + _raw already

    @property
    def moves(self) -> bool:
        """Whether it changed while it was heard."""
        return self.found > 1 and self.low < self.high


@dataclass(frozen=True)
class Proposal:
    """A candidate for a sensor or a command, and what speaks for it."""

    wanted: Wanted
    candidate: Candidate
    score: float
    why: tuple[str, ...]


def score(wanted: Wanted, candidate: Candidate) -> Proposal | None:
    """Weigh one candidate; None when it cannot be. A sensor must be published."""
    if not (wanted.command or candidate.published):
        return None
    unit = _by_unit(wanted, candidate)
    if unit is None:
        return None
    points = [unit, *_by_name(wanted, candidate), *_by_axis(wanted, candidate),
              *_by_place(wanted, candidate), *_by_sound(candidate)]
    return Proposal(wanted, candidate, sum(p for p, _ in points),
                    tuple(why for p, why in points if why))


def rank(wanted: Wanted, candidates: Iterable[Candidate]) -> list[Proposal]:
    """Return the candidates that can be, the best first."""
    found = [p for c in candidates if (p := score(wanted, c)) is not None]
    return sorted(found, key=lambda p: (-p.score, p.candidate.topic, p.candidate.field))


def assign(wanted: Sequence[Wanted], candidates: Sequence[Candidate],
           ) -> dict[str, list[Proposal]]:
    """
    Return for each name its candidates, the best first, none of them the best of another.

    The surest choice is made first: what is taken is not offered to the others. A topic has
    sensors or commands.
    """
    ranked = {w.name: rank(w, candidates) for w in wanted}
    every = sorted((p for ranks in ranked.values() for p in ranks),
                   key=lambda p: (-p.score, -_lead(ranked[p.wanted.name], p), p.wanted.name,
                                  p.candidate.topic, p.candidate.field))
    taken = Taken()
    for proposal in every:
        if taken.allows(proposal) and proposal.wanted.name not in taken.places.values():
            taken.take(proposal)
    return {name: [p for p in ranks if taken.allows(p)] for name, ranks in ranked.items()}


class Taken:
    """What is taken already: a place has one name, a topic either sensors or commands."""

    def __init__(self) -> None:
        self.places: dict[tuple[str, str], str] = {}  # topic and field: the name
        self._commands: dict[str, bool] = {}  # topic: of commands

    def allows(self, proposal: Proposal) -> bool:
        """Tell whether a proposal goes with what is taken."""
        wanted, candidate = proposal.wanted, proposal.candidate
        return self.places.get((candidate.topic, candidate.field), wanted.name) == wanted.name \
            and self._commands.get(candidate.topic, wanted.command) == wanted.command

    def take(self, proposal: Proposal) -> None:
        """Take a place for a name."""
        candidate = proposal.candidate
        self.places[candidate.topic, candidate.field] = proposal.wanted.name
        self._commands[candidate.topic] = proposal.wanted.command


def sure(ranks: Sequence[Proposal]) -> bool:
    """Tell whether the best may be taken unasked."""
    return bool(ranks) and ranks[0].score > MEANING and (
        len(ranks) == 1 or ranks[0].score - ranks[1].score >= SURE)


def _lead(ranks: Sequence[Proposal], proposal: Proposal) -> float:
    """Return how far a proposal is ahead of the best other one for the same name."""
    return proposal.score - max((p.score for p in ranks if p is not proposal), default=0.0)


Points = tuple[float, str]  # and why


def _by_unit(wanted: Wanted, candidate: Candidate) -> Points | None:
    unit = one_spelling(wanted.unit)
    if not unit or not candidate.units:
        return 0.0, ''
    if unit == candidate.units[0]:
        return SAME_UNIT, f'in {wanted.unit}'
    return (OTHER_MEANING, f'may be in {wanted.unit}') if unit in candidate.units else None


def _by_name(wanted: Wanted, candidate: Candidate) -> list[Points]:
    last = candidate.topic.removesuffix(RAW).rpartition('/')[2]
    for name in (wanted.name, *wanted.hints):
        if name.casefold() in (last.casefold(), candidate.element.casefold()):
            return [(NAMED, f'called {name}')]
    there = {*words_of(candidate.topic), *words_of(candidate.element), *words_of(candidate.field)}
    best: list[Points] = []
    for name in (wanted.name, *wanted.hints):
        points: list[Points] = []
        for word in dict.fromkeys(words_of(name)):
            if word in there:
                points.append((WORD, f'has {word} in its name'))
            elif same := _same(word, there):
                points.append((MEANING, f'{same} for {word}'))
        best = max(best, points, key=lambda found: sum(p for p, _ in found))
    return best


def _same(word: str, there: Iterable[str]) -> str:
    """Return a word among these that means the same, '' when there is none."""
    meant = {other for line in _MEANINGS if word in line for other in line}
    return next((other for other in sorted(there) if other in meant), '')


def _by_axis(wanted: Wanted, candidate: Candidate) -> list[Points]:
    last = candidate.field.rpartition('.')[2]
    if last not in ('x', 'y', 'z') or '.' not in candidate.field:
        return []
    for name in (wanted.name, *wanted.hints):
        for word in words_of(name):
            axis = _AXES.get(word) or (word[-1] if re.fullmatch('[vwa][xyz]', word) else None)
            if axis is not None:
                return [(AXIS, f'{last} axis') if axis == last else (-AXIS, '')]
    usual = _USUAL_AXIS.get(one_spelling(wanted.unit))
    return [(AXIS, f'{last} is the usual axis')] if last == usual else []


def _by_place(wanted: Wanted, candidate: Candidate) -> list[Points]:
    points: list[Points] = []
    commanding = bool(_COMMANDING & set(words_of(candidate.topic)))
    measuring = candidate.type.startswith('sensor_msgs/')
    if wanted.command:
        if commanding:
            points.append((COMMANDED, 'a topic of commands'))
        if candidate.listened and candidate.published:
            points.append((HEARD_BY, 'somebody acts on it'))
        if measuring:
            points.append((-MEASURING, ''))
    else:
        if commanding:
            points.append((-COMMANDED, ''))
        if candidate.moved:
            points.append((MOVED, 'raw'))
        if measuring:
            points.append((MEASURING, 'measured'))
    return points


def _by_sound(candidate: Candidate) -> list[Points]:
    points: list[Points] = [(COUNTS, '')] if candidate.whole else []
    if not candidate.heard:
        points.append((SILENT, 'not heard yet'))
    elif not candidate.found:
        points.append((EMPTY, 'no number in it'))
    elif candidate.moves:
        points.append((MOVES, 'moves'))
    return points
