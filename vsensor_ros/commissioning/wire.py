"""
Propose the wiring of a plant from what is on the graph, ask where unsure, write it down.

The driver of a sensor goes on publishing, on the topic + _raw; the replacer speaks on the topic.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import os
from pathlib import Path
import sys

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.commissioning.candidates import look_around
from vsensor_ros.commissioning.likeness import clean
from vsensor_ros.commissioning.ranking import assign, Candidate, Choice, Proposal, Wanted
from vsensor_ros.commissioning.silent_node import open_context, open_silent, own_name
from vsensor_ros.commissioning.wired_file import Wired, wired_text
from vsensor_ros.observers import Design
from vsensor_ros.plant import load_plant, Plant
from vsensor_ros.whole_file import write_whole

OFFERED = 9  # candidates that are asked about, and all beyond that agree


@dataclass(frozen=True)
class Task:
    """What is to be wired."""

    plant: str  # name of the plant
    wanted: tuple[Wanted, ...]
    design: Path  # the design file, which may not be there yet
    source: Path  # the file that was named


def wire(source: Path, design: Path | None, output: Path, yes: bool, force: bool,
         seconds: float, ros_args: Sequence[str]) -> int:
    """
    Write the parameter file; return the exit status.

    0: all is in it; 1: something was not found and is left to be filled in. Raises BadInput.
    """
    task = task_of(source, design, output)
    _may_write(output, yes, force)
    with open_context(ros_args) as context, open_silent(context, own_name('wire')) as node:
        around = look_around(node, seconds)
    candidates = around.candidates()
    if not candidates:
        raise BadInput('graph', '', 'there is no topic with numbers', 'start the drivers, and '
                       'look whether ROS_DOMAIN_ID is theirs')
    choices = choose(task.wanted, candidates, None if yes else ask)
    wired = Wired(task.plant, str(task.source), task.design, output, choices, around)
    try:
        write_whole(output, wired_text(wired))
    except (OSError, ValueError) as error:
        raise BadInput(output, 'parameter file', f'cannot be written ({reason(error)})',
                       'name a file in a folder that exists and is writable') from error
    _tell(wired)
    return 1 if any(c.proposal is None for c in choices) else 0


def task_of(source: Path, design: Path | None, output: Path) -> Task:
    """Return what the sensors and commands of a plant or a design are. Raises BadInput."""
    if _is_design(source):
        loaded = Design.load(source)
        wanted = [Wanted(s, False, loaded.units.get(s, '')) for s in loaded.sensors]
        wanted += [Wanted(u, True, loaded.units.get(u, '')) for u in loaded.inputs]
        return Task(loaded.plant_name, tuple(wanted), (design or source).absolute(), source)
    plant = load_plant(source)
    wanted = [Wanted(s, False, plant.units[s], _measured(plant, i))
              for i, s in enumerate(plant.sensors)]
    wanted += [Wanted(u, True, plant.units[u]) for u in plant.inputs]
    file = design or output.parent / f'{plant.name}.design.json'
    if design is not None or file.exists():
        loaded = Design.load(file)
        if (loaded.sensors, loaded.inputs) != (plant.sensors, plant.inputs):
            raise BadInput(file, 'plant', f'has other sensors or inputs than {source}',
                           'design it anew, or name the design of this plant with --design')
    return Task(plant.name, tuple(wanted), file.absolute(), source)


def _is_design(path: Path) -> bool:
    try:
        with open(path, 'rb') as file:
            return file.read(100).lstrip()[:1] == b'{'
    except (OSError, ValueError):
        return False  # told by whoever reads it


def _measured(plant: Plant, sensor: int) -> tuple[str, ...]:
    """Return the state that a sensor measures, when it is one."""
    states = np.flatnonzero(plant.C[sensor])
    return (plant.states[states[0]],) if len(states) == 1 else ()


def _may_write(output: Path, yes: bool, force: bool) -> None:
    if not output.exists() or force:
        return
    if yes or not sys.stdin.isatty():
        raise BadInput(output, '', 'is there already', 'name another with --output, or --force')
    try:
        answer = input(f'{output} is there already. Overwrite it? [y/N] ')
    except EOFError:
        answer = ''
    if answer.strip().casefold() not in ('y', 'yes'):
        raise BadInput(output, '', 'was left as it is', 'name another with --output')


Ask = Callable[[Choice], Proposal | None]


def choose(wanted: Sequence[Wanted], candidates: Sequence[Candidate], ask: Ask | None,
           ) -> tuple[Choice, ...]:
    """
    Choose for each sensor and command; ask: is asked where it is not sure; None: take the best.

    What an answer leaves to the others is chosen anew.
    """
    answers: dict[str, Proposal | None] = {}
    while True:
        choices = assign(wanted, candidates, answers)
        open_ = [c for c in choices if not c.sure and (c.proposal or c.others)]
        if ask is None or not open_:
            return choices
        answers[open_[0].wanted.name] = ask(open_[0])


def ask(choice: Choice) -> Proposal | None:
    """Ask which it is; None: none of them. Raises BadInput when the answers are at their end."""
    wanted, best = choice.wanted, choice.proposal
    what = 'command' if wanted.command else 'sensor'
    unit = f' [{wanted.unit}]' if wanted.unit else ''
    hints = f' ({", ".join(wanted.hints)})' if wanted.hints else ''
    offered = [*([best] if best else []), *choice.others]
    offered = [p for i, p in enumerate(offered) if i < OFFERED or p.agrees]
    print(f'\nWhich is the {what} {wanted.name}{hints}{unit}?')
    for i, p in enumerate(offered, 1):
        print(f'  {i}  {clean(p.candidate.topic)}  {clean(p.candidate.field)}'
              f'  {heard_of(p.candidate)}  ({clean(p.reasons)})')
    print('  0  none of these')
    usual = '1' if best else '0'
    while True:
        try:
            answer = input(f'[{usual}] ').strip() or usual
        except EOFError:
            raise BadInput('', wanted.name, f'it is not sure which {what} it is, and nobody can '
                           'be asked', 'run it in a terminal, or with --yes') from None
        if answer.isdecimal() and int(answer) <= len(offered):
            return offered[int(answer) - 1] if int(answer) else None
        print(f'a number from 0 to {len(offered)}, please')


def heard_of(candidate: Candidate) -> str:
    """Say in short what was heard of a candidate."""
    if not candidate.heard:
        return 'not heard'
    if not candidate.found:
        return 'no number'
    values = f'{candidate.low:.4g} .. {candidate.high:.4g}' if candidate.moves \
        else f'{candidate.low:.4g}'
    return f'{candidate.rate:.3g} Hz, {values}'


def _tell(wired: Wired) -> None:
    """Say what was written, and what is to be done with it."""
    for choice in wired.choices:
        p = choice.proposal
        name = f'{choice.wanted.name}:'
        if p is None:
            print(f'{name} NOT FOUND; fill it in')
        else:
            doubt = '' if choice.sure else '  NOT SURE, look at it'
            print(clean(f'{name} {p.candidate.topic} {p.candidate.field}'
                        f'  ({p.reasons}){doubt}'))
    print(f'written to {wired.output}')
    if wired.remappings:
        print('start these drivers with:')
        for remapping in wired.remappings:
            print(clean(f'  {remapping}'))
    path = os.path.relpath(wired.output)
    if not wired.design.exists():
        print(f'then: ros2 run vsensor_ros designer {wired.source} -o {wired.design}')
    print(f'then: ros2 run vsensor_ros check --params-file {path}{wired.remapped}', flush=True)
