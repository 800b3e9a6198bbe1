"""The parameter file that is written: what was chosen, and in comments why."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
import math
from pathlib import Path

import yaml

from vsensor_ros.commissioning.candidates import Surroundings
from vsensor_ros.commissioning.likeness import clean
from vsensor_ros.commissioning.ranking import Proposal, Wanted
from vsensor_ros.node.known import GENERAL

RAW = '_raw'  # what drivers' topics end in
OTHERS = 3  # candidates that are named beside one that is not sure


@dataclass(frozen=True)
class Choice:
    """What was chosen for a sensor or a command."""

    wanted: Wanted
    proposal: Proposal | None  # None: nothing was found
    sure: bool
    others: tuple[Proposal, ...]  # what else it may be, the best first


@dataclass(frozen=True)
class Wired:
    """All that goes into the file."""

    plant: str
    source: str  # plant or design file that it was made from
    design: Path
    output: Path
    choices: tuple[Choice, ...]
    around: Surroundings

    @property
    def remappings(self) -> list[tuple[str, str]]:
        """The drivers that must move, with the topic that they are to leave."""
        topics = dict.fromkeys(c.proposal.candidate.topic for c in self.choices
                               if c.proposal is not None and not c.wanted.command)
        return [(p, topic) for topic in topics if not self.is_raw(topic)
                for p in dict.fromkeys(n.node for n in self.around.topics[topic].publishers)]

    def is_raw(self, topic: str) -> bool:
        """Tell whether a driver publishes on the input already, and only a replacer before it."""
        served = self.around.topics.get(topic.removesuffix(RAW))
        return topic.endswith(RAW) and (served is None or all(
            p.node in self.around.replacers for p in served.publishers))


def wired_text(wired: Wired) -> str:
    """Return the text of the file."""
    return '\n'.join(clean(line) for line in _lines(wired)) + '\n'


def _lines(wired: Wired) -> Iterator[str]:
    yield (f'# The replacer of {wired.plant}, wired by `ros2 run vsensor_ros wire` to what was on '
           'the graph.')
    yield '# Read the comments; every parameter is in docs/parameters.md. Then try it:'
    yield f'#   ros2 run vsensor_ros check --params-file {wired.output}'
    if wired.remappings:
        yield '#'
        yield '# Start these drivers with a remapping, so that the replacer speaks in their place:'
        for node, topic in wired.remappings:
            yield f'#   {node}: --ros-args -r {topic}:={topic}{RAW}'
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
        yield '    # isolation: nobody says yet which sensors are faulty; see docs/replacer.md'
        return
    topic, kind = wired.around.isolations[0]
    more = ', '.join(t for t, _ in wired.around.isolations[1:])
    yield '    isolation:' + (f'    # or is it {more}?' if more else '')
    yield f'      topic: {_quoted(topic)}'
    yield f'      type: {kind}'


def _entry(wired: Wired, choice: Choice) -> Iterator[str]:
    wanted, proposal = choice.wanted, choice.proposal
    unit = f' [{wanted.unit}]' if wanted.unit else ''
    if proposal is None:
        yield f'      # NOT FOUND: fill it in, without the #{unit}'
        yield f"      # {wanted.name}: {{topic: '', type: '', field: ''}}"
        return
    candidate = proposal.candidate
    yield f'      {_key(wanted.name)}:    #{unit} {", ".join(proposal.why) or "nothing better"}'
    if not choice.sure:
        others = ' or '.join(f'{p.candidate.topic} {p.candidate.field}'
                             for p in choice.others[:OTHERS])
        yield '        # NOT SURE' + (f': may be {others}' if others else '')
    raw = not wanted.command and wired.is_raw(candidate.topic)
    topic = candidate.topic.removesuffix(RAW) if raw else candidate.topic
    yield f'        topic: {_quoted(topic)}'
    yield f'        type: {candidate.type}'
    yield f'        field: {_quoted(candidate.field)}    # {_sound(proposal)}'
    if wanted.command:
        return
    yield f'        input: {_quoted(candidate.topic if raw else candidate.topic + RAW)}'
    if candidate.rate and 3.0 / candidate.rate > GENERAL['max_age'].default:
        yield (f'        max_age: {math.ceil(4.0 / candidate.rate)}.0    # [s] it comes '
               f'every {1.0 / candidate.rate:.2g} s')
    for listener in wired.around.topics[candidate.topic].listeners:
        if listener.mismatch:
            yield (f'        # {listener.node} would not hear it there ({listener.mismatch}): '
                   f'{listener.mend}')


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
