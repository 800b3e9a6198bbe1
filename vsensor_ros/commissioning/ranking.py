"""
Which field of which topic is most likely a sensor or a command; pure, no ROS.

Every point has a reason that a person can judge, and the sum of the points is the score. A field
that is in another unit is no candidate at all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
import re

from vsensor_ros.commissioning.likeness import words_of
from vsensor_ros.commissioning.routes import RAW
from vsensor_ros.commissioning.units import one_spelling

SURE = 1.0  # points by which the best must be ahead of all others, to be taken unasked

SAME_UNIT, OTHER_MEANING = 3.0, -1.0  # the likeliest unit of the field; one that is seldom its
CALLED, WORD, MEANING = 2.0, 3.0, 1.0  # the whole name; each word; one that means the same
AXIS = 1.5  # the name says an axis, and it is this one; else it is taken off
MOVED, HEARD_BY, COMMANDED = 1.0, 1.0, 1.0
SILENT, EMPTY, MOVES = -1.0, -3.0, 0.5
BELOW = 4.0  # our namespace
MEASURING = 1.0  # a message of sensor_msgs: for sensors; taken off for commands
COUNTS = -1.0  # a whole number

# words that mean the same, each line
_MEANINGS = (
    ('position', 'angle', 'pos', 'theta', 'positions'),
    ('heading', 'yaw', 'azimuth', 'bearing'),
    ('velocity', 'speed', 'rate', 'omega', 'gyro', 'vel', 'angular', 'twist', 'velocities'),
    ('acceleration', 'accel', 'accelerometer', 'acc'),
    ('effort', 'torque', 'force', 'current', 'load', 'moment'),
    ('range', 'level', 'distance', 'height', 'depth', 'gap'),
    ('temperature', 'temp'),
    ('pressure', 'baro', 'fluid'),
    ('voltage', 'volt', 'volts'),
    ('altitude', 'height', 'elevation'),
)
_COMMANDING = {'cmd', 'cmds', 'command', 'commands', 'setpoint', 'setpoints', 'reference',
               'references', 'target', 'targets', 'desired', 'goal', 'goals', 'ref'}
_OPPOSITES = ({'left', 'right'}, {'front', 'rear', 'back'}, {'upper', 'lower'},
              {'top', 'bottom'})
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
    joint: str = ''  # on the graph, that it names


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
    namespace: str = ''  # of the replacer; '' when it is in none

    @property
    def place(self) -> tuple[str, str]:
        """Topic and field."""
        return self.topic, self.field

    @property
    def below(self) -> bool:
        """Whether the topic is below the namespace of the replacer, when it is in one."""
        return bool(self.namespace) and self.topic.startswith(f'{self.namespace}/')

    @property
    def local(self) -> str:
        """The topic without the namespace of the replacer."""
        return self.topic.removeprefix(self.namespace) if self.below else self.topic

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
    agrees: bool = True  # the unit does, if it is one, or the name
    doubt: str = ''  # why it is never sure

    @property
    def reasons(self) -> str:
        """What speaks for it, in one line."""
        return ', '.join(self.why) or 'nothing speaks for it'


@dataclass(frozen=True)
class Choice:
    """What was chosen for a sensor or a command."""

    wanted: Wanted
    proposal: Proposal | None  # None: nothing was found
    sure: bool
    others: tuple[Proposal, ...]  # what else it may be, the best first


def score(wanted: Wanted, candidate: Candidate) -> Proposal | None:
    """Weigh one candidate; None when it cannot be. A sensor is published, and no command."""
    if not wanted.command and (not candidate.published or _commands(candidate, wanted)):
        return None
    unit = _by_unit(wanted, candidate)
    if unit is None:
        return None
    name = _by_name(wanted, candidate)
    points = [unit, *name.points, *_by_axis(wanted, candidate), *_by_place(wanted, candidate),
              *_by_sound(candidate)]
    agrees = name.agrees or (unit[0] == SAME_UNIT and one_spelling(wanted.unit) != '1')
    return Proposal(wanted, candidate, sum(p for p, _ in points),
                    tuple(why for p, why in points if why), agrees,
                    _doubt(candidate, name) if agrees else
                    'neither its unit nor its name agrees')


def rank(wanted: Wanted, candidates: Iterable[Candidate]) -> list[Proposal]:
    """Return the candidates that can be, the best first; of one topic in the order given."""
    found = [p for c in candidates if (p := score(wanted, c)) is not None]
    return sorted(found, key=lambda p: (-p.score, p.candidate.topic))


def assign(wanted: Sequence[Wanted], candidates: Sequence[Candidate],
           answers: Mapping[str, Proposal | None] | None = None) -> tuple[Choice, ...]:
    """
    Choose for each name, none of them what another has; a topic has sensors or commands.

    answers: what a person chose; it stands. The surest choice is made first; of two that are
    alike, the first name gets the first element. Nothing is chosen that does not agree at all.
    """
    answers, taken = answers or {}, Taken()
    for answer in answers.values():
        if answer is not None:
            taken.take(answer)
    fitting = {w.name: rank(replace(w, joint=_joint(w, candidates)), candidates)
               for w in wanted if w.name not in answers}
    ranked = {name: [p for p in ranks if taken.allows(p)] for name, ranks in fitting.items()}
    best: dict[str, Proposal] = {}
    every = [p for ranks in ranked.values() for p in ranks if p.agrees]
    for p in sorted(every, key=lambda p: (-p.score, -_lead(ranked[p.wanted.name], p))):
        if p.wanted.name not in best and taken.allows(p):
            taken.take(p)
            best[p.wanted.name] = p
    return tuple(
        Choice(w, answers[w.name], True, ()) if w.name in answers else
        Choice(w, best.get(w.name), _sure(best.get(w.name), ranked, fitting[w.name]),
               tuple(p for p in ranked[w.name] if p is not best.get(w.name)))
        for w in wanted)


class Taken:
    """What is taken already: a place has one name, a topic either sensors or commands."""

    def __init__(self) -> None:
        self.places: dict[tuple[str, str], str] = {}  # topic and field: the name
        self._commands: dict[str, bool] = {}  # topic: of commands

    def allows(self, proposal: Proposal) -> bool:
        """Tell whether a proposal goes with what is taken."""
        wanted, candidate = proposal.wanted, proposal.candidate
        return self.places.get(candidate.place, wanted.name) == wanted.name \
            and self._commands.get(candidate.topic, wanted.command) == wanted.command

    def take(self, proposal: Proposal) -> None:
        """Take a place for a name."""
        candidate = proposal.candidate
        self.places[candidate.place] = proposal.wanted.name
        self._commands[candidate.topic] = proposal.wanted.command


def _sure(best: Proposal | None, ranked: Mapping[str, Sequence[Proposal]],
          fitting: Sequence[Proposal]) -> bool:
    """
    Tell whether the best may be taken unasked.

    It is ahead of all others for its name, those that another name has got included; and no other
    name that would as soon have this place fits it as well. fitting: with what answers have taken;
    what is left after a better one is not sure.
    """
    if best is None or best.doubt or fitting[0].score >= best.score + SURE:
        return False
    near = best.score - SURE
    own = ranked[best.wanted.name]
    rivals = [p for ranks in ranked.values() if ranks is not own for p in ranks
              if p.candidate.place == best.candidate.place and not p.doubt
              and p.score > ranks[0].score - SURE]
    return all(p.score <= near for p in (*own, *rivals) if p is not best)


def _lead(ranks: Sequence[Proposal], proposal: Proposal) -> float:
    """Return how far a proposal is ahead of the best other one for the same name."""
    others = ranks[1:2] if proposal is ranks[0] else ranks[:1]
    return proposal.score - (others[0].score if others else 0.0)


Points = tuple[float, str]  # and why


def _by_unit(wanted: Wanted, candidate: Candidate) -> Points | None:
    unit = one_spelling(wanted.unit)
    if not unit or not candidate.units:
        return 0.0, ''
    if unit == candidate.units[0]:
        return SAME_UNIT, f'in {wanted.unit}'
    return (OTHER_MEANING, f'may be in {wanted.unit}') if unit in candidate.units else None


@dataclass(frozen=True)
class _Likeness:
    """How a name is like the names of a candidate."""

    points: tuple[Points, ...] = ()
    agrees: bool = False  # in a word; a number or a letter is none
    doubt: str = ''


def _by_name(wanted: Wanted, candidate: Candidate) -> _Likeness:
    found = [_likeness(name, candidate) for name in (wanted.name, *wanted.hints)]
    best = max(found, key=lambda like: sum(p for p, _ in like.points))
    return replace(best, doubt=next((like.doubt for like in found if like.doubt), ''))


def _doubt(candidate: Candidate, name: _Likeness) -> str:
    if candidate.namespace and not candidate.below:
        return f'it is not below {candidate.namespace}'
    return name.doubt


def _likeness(name: str, candidate: Candidate) -> _Likeness:
    last = candidate.topic.removesuffix(RAW).rpartition('/')[2]
    words = tuple(dict.fromkeys(words_of(name)))
    if name.casefold() in (last.casefold(), candidate.element.casefold()):
        return _Likeness(((CALLED + WORD * len(words), f'called {name}'),), True)
    there = _words_there(candidate)
    points, agrees = [], False
    for word in words:
        if word in there:
            points.append((WORD, f'has {word} in its name'))
            agrees = agrees or (len(word) > 1 and not word.isdecimal())
        elif same := _same(word, there):
            points.append((MEANING, f'{same} for {word}'))
            agrees = True
    if agrees and (doubt := _contradiction(set(words), there)):
        return _Likeness(doubt=doubt)
    return _Likeness(tuple(points), agrees)


def _words_there(candidate: Candidate) -> set[str]:
    """Return the words in the names of a candidate; of the numbers, those that tell it best."""
    places = [_unindexed(candidate.field), candidate.element, *candidate.local.split('/')[::-1]]
    words = [set(words_of(place)) for place in places]
    numbers = [{w for w in there if w.isdecimal()} for there in words]
    return set().union(*words).difference(*numbers) | next(filter(None, numbers), set())


def _contradiction(words: set[str], there: set[str]) -> str:
    """Say which word there is the opposite of one of these: level1, level2; left, right."""
    for group in ({w for w in words | there if w.isdecimal()}, *_OPPOSITES):
        if (ours := words & group) and (theirs := there & group) and not ours & theirs:
            return f'it has {min(theirs)} in its name, not {min(ours)}'
    return ''


def _unindexed(field: str) -> str:
    """Return a field without the places of elements that have no name."""
    return re.sub(r'\[#?[0-9]+\]', '', field)


def _joint(wanted: Wanted, candidates: Iterable[Candidate]) -> str:
    """Return the one joint, with this unit, that a name has most words of; '': there is none."""
    unit = one_spelling(wanted.unit)
    elements = dict.fromkeys(c.element for c in candidates if c.element and (
        not unit or not c.units or c.units[0] == unit))
    best: list[str] = []
    most = 0
    for element in elements:
        there = set(words_of(element))
        for name in (wanted.name, *wanted.hints):
            shared = there & set(words_of(name))
            if all(word.isdecimal() for word in shared):
                continue
            if len(shared) > most:
                best, most = [], len(shared)
            if len(shared) == most and element not in best:
                best.append(element)
    return best[0] if len(best) == 1 else ''


def _same(word: str, there: Iterable[str]) -> str:
    """Return a word among these that means the same, '' when there is none."""
    meant = {other for line in _MEANINGS if word in line for other in line}
    return next((other for other in sorted(there) if other in meant), '')


def _commands(candidate: Candidate, wanted: Wanted) -> bool:
    """Tell whether these are commands by their names; a name may have such a word itself."""
    return bool(_COMMANDING & set(words_of(f'{candidate.local} {candidate.field}'))
                - set(words_of(' '.join((wanted.name, *wanted.hints)))))


def _by_axis(wanted: Wanted, candidate: Candidate) -> list[Points]:
    angle, of, _ = candidate.field.partition('(')  # yaw(orientation)
    last = _AXES[angle] if of else candidate.field.rpartition('.')[2]
    if last not in ('x', 'y', 'z') or not (of or '.' in candidate.field):
        return []
    for name in (wanted.name, *wanted.hints):
        for word in words_of(name):
            axis = _AXES.get(word) or (word[-1] if re.fullmatch('[vwa][xyz]', word) else None)
            if axis is not None:
                return [(AXIS, f'{last} axis') if axis == last else (-AXIS, '')]
    usual = '' if wanted.joint else _USUAL_AXIS.get(one_spelling(wanted.unit))
    return [(AXIS, f'{last} is the usual axis')] if last == usual else []


def _by_place(wanted: Wanted, candidate: Candidate) -> list[Points]:
    points = [(BELOW, f'below {candidate.namespace}')] if candidate.below else []
    measuring = candidate.type.startswith('sensor_msgs/')
    if wanted.command:
        if _COMMANDING & set(words_of(candidate.local)):
            points.append((COMMANDED, 'a topic of commands'))
        if candidate.listened and candidate.published:
            points.append((HEARD_BY, 'somebody acts on it'))
        if measuring:
            points.append((-MEASURING, ''))
    else:
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
    elif candidate.moves and _unindexed(candidate.field) == candidate.field:
        points.append((MOVES, 'moves'))
    return points
