"""The parameter file that is written: what was chosen, and in comments why."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from pathlib import Path

import yaml

from vsensor_ros.commissioning.candidates import Surroundings
from vsensor_ros.commissioning.likeness import clean
from vsensor_ros.commissioning.ranking import Choice, Proposal
from vsensor_ros.commissioning.routes import RAW, Route, routes
from vsensor_ros.node.known import GENERAL

OTHERS = 3  # candidates that are named beside one that is not sure


@dataclass(frozen=True)
class Wired:
    """All that goes into the file."""

    plant: str
    source: str  # plant or design file that it was made from
    design: Path
    output: Path
    choices: tuple[Choice, ...]
    around: Surroundings

    @cached_property
    def routes(self) -> dict[str, Route]:
        """Where drivers publish and the replacer speaks, by the topic that was chosen."""
        chosen = [(c.proposal.candidate, c.wanted.command) for c in self.choices if c.proposal]
        sensors = [candidate for candidate, command in chosen if not command]
        return routes([c.topic for c in sensors], [c.topic for c in sensors if c.moved],
                      {*self.around.published, *(c.topic for c, command in chosen if command)})

    def written(self, topic: str) -> str:
        """Return a topic as it stands in the file: relative when it is below the namespace."""
        namespace = self.around.namespace
        return topic.removeprefix(f'{namespace}/') if namespace else topic

    @property
    def remapped(self) -> str:
        """With what the replacer is to be started, so that its topics are these."""
        return f' --ros-args -r __ns:={self.around.namespace}' if self.around.namespace else ''

    @property
    def remappings(self) -> list[str]:
        """The drivers that must move, each with how."""
        return [f'{driver}: --ros-args -r {topic}:={route.input}' + (
                    '' if route.plain else f'    # {topic}{RAW} is taken')
                for topic, route in self.routes.items() if topic != route.input
                for driver in dict.fromkeys(
                    n.node for n in self.around.topics[topic].publishers)]


def wired_text(wired: Wired) -> str:
    """Return the text of the file."""
    return '\n'.join(clean(line) for line in _lines(wired)) + '\n'


def _lines(wired: Wired) -> Iterator[str]:
    yield (f'# The replacer of {wired.plant}, wired by `ros2 run vsensor_ros wire` to what was on '
           'the graph.')
    yield '# Read the comments; every parameter is in docs/parameters.md. Then try it:'
    yield f'#   ros2 run vsensor_ros check --params-file {wired.output}{wired.remapped}'
    if wired.remappings:
        yield '#'
        yield '# Start these drivers with a remapping, so that the replacer speaks in their place:'
        for remapping in wired.remappings:
            yield f'#   {remapping}'
    yield '/**:'
    yield '  ros__parameters:'
    if not wired.design.exists():
        yield f'    # make it: ros2 run vsensor_ros designer {wired.source} -o {wired.design}'
    yield f'    design_file: {_quoted(str(wired.design))}'
    if wired.around.clock:
        yield '    use_sim_time: true    # somebody publishes /clock'
    yield from _isolation(wired)
    for group, command in (('sensors', False), ('commands', True)):
        choices = [c for c in wired.choices if c.wanted.command == command]
        if choices and any(c.proposal for c in choices):
            yield f'    {group}:'
        elif choices:
            yield f'    # {group}:'
        for choice in choices:
            yield from _entry(wired, choice)


def _isolation(wired: Wired) -> Iterator[str]:
    if not wired.around.isolations:
        yield '    # isolation: nobody says yet which sensors are faulty; see docs/isolator.md'
        return
    (topic, kind), *others = sorted(wired.around.isolations,
                                    key=lambda found: wired.written(found[0]).startswith('/'))
    more = ', '.join(other for other, _ in others)
    yield '    isolation:' + (f'    # or is it {more}?' if more else '')
    yield f'      topic: {_quoted(wired.written(topic))}'
    yield f'      type: {kind}'


def _entry(wired: Wired, choice: Choice) -> Iterator[str]:
    wanted, proposal = choice.wanted, choice.proposal
    unit = f' [{wanted.unit}]' if wanted.unit else ''
    if proposal is None:
        yield f'      # NOT FOUND: fill it in, without the #{unit}'
        if choice.others:
            yield f'      # it may be {_places(choice.others)}'
        yield f"      # {wanted.name}: {{topic: '', type: '', field: ''}}"
        return
    candidate = proposal.candidate
    yield f'      {_key(wanted.name)}:    #{unit} {proposal.reasons}'
    if not choice.sure:
        others = f'it may be {_places(choice.others)}' if choice.others else ''
        yield '        # ' + '; '.join(filter(None, ('NOT SURE', proposal.doubt, others)))
    route = None if wanted.command else wired.routes[candidate.topic]
    topic = candidate.topic if route is None else route.output
    yield f'        topic: {_quoted(wired.written(topic))}'
    yield f'        type: {candidate.type}'
    yield f'        field: {_quoted(candidate.field)}    # {_sound(proposal)}'
    if route is None:
        return
    yield f'        input: {_quoted(wired.written(route.input))}'
    if candidate.rate and 3.0 / candidate.rate > GENERAL['max_age'].default:
        yield (f'        max_age: {math.ceil(4.0 / candidate.rate)}.0    # [s] it comes '
               f'every {1.0 / candidate.rate:.2g} s')
    for listener in wired.around.topics[candidate.topic].listeners:
        if listener.mismatch:
            yield (f'        # {listener.node} would not hear it there ({listener.mismatch}): '
                   f'{listener.mend}')


def _places(proposals: Sequence[Proposal]) -> str:
    return ' or '.join(' '.join(p.candidate.place) for p in proposals[:OTHERS])


def _sound(proposal: Proposal) -> str:
    candidate = proposal.candidate
    if not candidate.heard:
        return 'not heard while it was wired'
    if not candidate.found:
        return f'{candidate.rate:.3g} Hz, but no number in it'
    return f'{candidate.rate:.3g} Hz, {candidate.low:.4g} .. {candidate.high:.4g}'


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _key(name: str) -> str:
    """Return a name as YAML takes it for a text: `on` would be true."""
    return str(yaml.safe_dump(name, allow_unicode=True)).splitlines()[0]
