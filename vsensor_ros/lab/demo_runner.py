"""The demo: system after system, what a person sees on the way, and the summary."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext, suppress
import math
from pathlib import Path
import sys
import time

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer import design
from vsensor_ros.lab.balance_demo import show_balance
from vsensor_ros.lab.config_folder import config_folder
from vsensor_ros.lab.demo_failover import fail_over, Moment, Run
from vsensor_ros.lab.demo_picture import draw
from vsensor_ros.lab.demo_table import Result, Row, table, write_summary
from vsensor_ros.lab.process import Failed
from vsensor_ros.observers import Refusal
from vsensor_ros.plant import load_plant
from vsensor_ros.simulate.balance import is_balance
from vsensor_ros.simulate.judge import judge, replaced
from vsensor_ros.simulate.mujoco_machine import NoMujoco
from vsensor_ros.simulate.recording import NoRecording
from vsensor_ros.simulate.scenario import load_scenario, Scenario


def show(story: Path, output: Path, say: Callable[[str], None],
         update: Callable[[str], None]) -> Result:
    """
    Run a story of the system in its folder; write its design, log and picture to `output`.

    `say` gets lines that stay, `update` the one that changes. Raise BadInput or Failed.
    """
    folder = story.parent
    system = f'{folder.name}{story.stem.removeprefix("demo")}'
    plant = load_plant(folder / 'plant.yaml')
    update('computing the truth')
    scenario = load_scenario(story, plant)
    update('designing the virtual sensors')
    result = design(plant, isolate=scenario.alone)
    design_file = output / f'{system}.design.json'
    result.save(design_file)
    failed = scenario.failed_sensor
    virtual = result[(failed,), failed]
    if isinstance(virtual, Refusal):
        raise BadInput(story, 'failed_sensor', f'{failed} cannot be replaced: '
                       f'{virtual.reason}', 'let another sensor fail')
    say(f'{scenario.title}: {failed} out of {", ".join(virtual.reads + virtual.commands)}, '
        f'order {virtual.order}'
        + (f', {scenario.speed:g} times real time' if scenario.speed != 1.0 else ''))

    phase = ''

    def progress(moment: Moment) -> None:
        nonlocal phase
        now = _phase(scenario, moment.time, moment.isolated)
        if now != phase:
            phase = now
            say(f'  {moment.time:8.1f} s  {phase}')
        update(_line(scenario, moment.time, moment.value, moment.isolated))

    for last in (False, True):
        update('starting the replacer and the machine')
        run = fail_over(scenario, folder, design_file, output, progress)
        verdict = judge(scenario, run.heard)
        if verdict.passed or run.in_time or last:
            break
        say('  this computer was too busy to play the machine in time: once more')
    if not (verdict.passed or run.in_time):
        say('  it was too busy again, so what follows says nothing of the replacer')
    for line in told_of(scenario, run):
        say(f'  {line}')
    update('drawing the picture')
    draw(scenario, run.heard, run.deviation, verdict, output / f'{system}.png')
    waited = 1e3 * (scenario.isolated_at - scenario.failed_at) / scenario.speed
    row = Row(system, failed, virtual.order,
              None if verdict.latency_ms is None else waited + verdict.latency_ms,
              None if scenario.alone else verdict.latency_ms,
              verdict.rmse, verdict.rmse_hold, scenario.unit)
    return Result(row, scenario.bar, f'the RMSE allowed is {scenario.bar_text}', verdict.passed)


def told_of(scenario: Scenario, run: Run) -> list[str]:
    """Set what the replacer said of its switch and of its error against the truth."""
    lines, unit, truth = [], scenario.unit, scenario.truth
    if math.isfinite(run.step):
        raw = scenario.channels[scenario.failed_sensor]
        said = raw.sent & (raw.time <= scenario.isolated_at) & np.isfinite(raw.value)
        off = abs(raw.value[said][-1] - np.interp(scenario.isolated_at, truth.time, truth.value))
        lines.append(f'step at the switch {abs(run.step):.2g} {unit}; the sensor was {off:.2g} '
                     f'{unit} off the truth by then')
    new = replaced(scenario, run.heard)
    if new.any() and len(run.deviation):
        time, value = run.heard.time[new], run.heard.value[new]
        error = np.abs(value - np.interp(time, truth.time, truth.value))
        deviation = np.interp(time, *run.deviation.T)
        within = f'{100.0 * np.mean(error <= 2.0 * deviation):.0f} %'
        lines.append(f'standard deviation given: {np.median(deviation):.2g} {unit}; {within} '
                     'of the estimates are within two of it')
    return lines


_WORDS = {'freeze': 'frozen', 'drop_out': 'silent', 'not_a_number': 'NaN', 'infinity': 'infinite',
          'bias': 'biased', 'drift': 'drifting', 'spikes': 'spiking', 'noise': 'noisy'}


def _phase(scenario: Scenario, now: float, isolated: bool) -> str:
    begun = [_WORDS[kind] for start, kind in scenario.marks if start <= now]
    sensor = f'{scenario.failed_sensor} is {begun[-1] if begun else "alive"}'
    if isolated:
        return f'{sensor}, the replacer speaks for it'
    return f'{sensor}, and nobody has noticed' if begun else f'{sensor}, its messages pass through'


def _line(scenario: Scenario, now: float, value: float, isolated: bool) -> str:
    done = (now - scenario.start) / (scenario.end - scenario.start)
    at = min(int(20 * done), 19)
    fault = min(int(20 * (scenario.isolated_at - scenario.start)
                    / (scenario.end - scenario.start)), 19)
    bar = ''.join('#' if i <= at and i >= fault else '=' if i <= at else '.' for i in range(20))
    truth = np.interp(now, scenario.truth.time, scenario.truth.value)
    return (f'{now:8.1f} s  [{bar}]  {scenario.failed_sensor} '
            f'{"REPLACED" if isolated else "measured"} {value:9.4f}, truth {truth:9.4f} '
            f'{scenario.unit}')


class _Screen:
    """Lines that stay, and on a terminal a last one that changes."""

    def __init__(self) -> None:
        self.status = None
        if sys.stdout.isatty():
            with suppress(ImportError):
                from rich.console import Console
                self.status = Console(highlight=False, markup=False).status('')

    def say(self, text: str) -> None:
        if self.status:
            self.status.console.print(text)
        else:
            print(text, flush=True)

    def update(self, text: str) -> None:
        if self.status:
            self.status.update(text)


def show_all(systems: Sequence[str], output: Path) -> int:
    """
    Show the systems named, or all; write summary.json; return the command's exit code.

    Raise BadInput for a name that is no system and a folder that cannot be made.
    """
    began = time.monotonic()
    config = config_folder()
    if config is None:
        raise BadInput('', 'config', 'is not found',
                       'run in the repository or install the package')
    known = sorted(path.parent.name for path in config.glob('*/demo.yaml'))
    for name in systems:
        if name not in known:
            raise BadInput(config, name, 'is not a system with a demo.yaml',
                           f'choose from {", ".join(known)}')
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise BadInput(output, '', problem.strerror or '', 'give another --output') from None

    results: list[Result] = []
    not_shown: list[str] = []
    broken = False
    screen = _Screen()
    with screen.status or nullcontext():
        for number, name in enumerate(systems or known, 1):
            screen.say(f'[{number}/{len(systems or known)}] {name}')
            try:
                folder = config / name
                if is_balance(folder / 'demo.yaml'):
                    results += show_balance(folder, output, screen.say, screen.update)
                else:
                    results += [show(story, output, screen.say, screen.update)
                                for story in sorted(folder.glob('demo*.yaml'))]
            except (BadInput, Failed) as problem:
                not_shown.append(f'{name} is not shown: {problem}')
                screen.say(f'  {not_shown[-1]}')
                broken = broken or not isinstance(problem, (NoRecording, NoMujoco))
    write_summary(output / 'summary.json', [result.row for result in results])
    print('', *([table(results)] if results else []), *not_shown, sep='\n')
    for result in results:
        if not result.passed:
            print(f'{result.row.system} FAILED: {result.bar_text}')
    print(f'Pictures and summary.json are in {output}/ ({time.monotonic() - began:.0f} s).')
    return int(broken or not results or not all(result.passed for result in results))

