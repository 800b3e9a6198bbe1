"""The demo of a machine that falls: what a person sees on the way, and the verdict."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer import design
from vsensor_ros.lab.balance_picture import draw_balance, fate
from vsensor_ros.lab.balance_run import balance, Moment, Watched
from vsensor_ros.lab.demo_table import Result, Row
from vsensor_ros.observers import Design, Entry, horizon, Refusal, VirtualSensor
from vsensor_ros.plant import load_plant, Plant
from vsensor_ros.simulate.balance import Balance, load_balance

RAIL = 41   # characters


@dataclass(frozen=True)
class BalanceRow(Row):
    """A sensor that failed twice: seconds after its fault, None where that did not happen."""

    fell_after: float | None    # when nobody replaced it
    stood: float | None         # until the end or a fall, when it was replaced


def show_balance(folder: Path, output: Path, say: Callable[[str], None],
                 update: Callable[[str], None]) -> list[Result]:
    """
    Let each sensor of the story fail, not replaced and replaced; write design, logs and picture.

    `say` gets lines that stay, `update` the one that changes. Raise BadInput or Failed.
    """
    update('designing the virtual sensors')
    plant = load_plant(folder / 'plant.yaml')
    story = load_balance(folder / 'demo.yaml', plant)
    designed = design(plant)
    design_file = output / f'{folder.name}.design.json'
    designed.save(design_file)
    say(story.title)
    pairs, results = [], []
    for failed in story.bar:
        virtual = designed[(failed,), failed]
        if isinstance(virtual, Refusal):
            raise BadInput(folder / 'demo.yaml', f'bar.{failed}', f'{failed} cannot be replaced: '
                           f'{virtual.reason}', 'let another sensor fail')

        def progress(moment: Moment, failed: str = failed) -> None:
            update(_line(story, plant, failed, moment))
        update('starting the machine and its controller')
        alone = balance(story, plant, failed, False, folder, design_file, output, progress)
        update('starting the machine, its controller and the replacer')
        replaced = balance(story, plant, failed, True, folder, design_file, output, progress)
        how = _how(designed, virtual)
        pairs.append((alone, replaced, how))
        say(f'  {failed} freezes at {story.failed_at:g} s, and nobody replaces it: '
            f'{fate(story, plant, alone)}')
        say(f'  {failed} freezes at {story.failed_at:g} s, and is {how}, out of '
            f'{", ".join(virtual.reads + virtual.commands)}: {fate(story, plant, replaced)}')
        results.append(judge_balance(story, plant, alone, replaced, folder.name, virtual.order))
        say(f'  {told_of(story, plant, replaced)}')
    update('drawing the picture')
    draw_balance(story, plant, pairs, output / f'{folder.name}.png')
    return results


def _how(designed: Design, entry: Entry) -> str:
    """Say whether a sensor is replaced for good, else until when it is good for what."""
    if not (isinstance(entry, VirtualSensor) and entry.grade == 'temporary'):
        return 'replaced'
    tolerance = designed.tolerance(entry.channel)
    if tolerance is None:
        return 'replaced for a time'
    return (f'replaced for a time (stated: {horizon(entry, tolerance):.0f} s to {tolerance:g} '
            f'{designed.units.get(entry.channel, "")})')


def judge_balance(story: Balance, plant: Plant, alone: Watched, replaced: Watched, system: str,
                  order: int) -> Result:
    """Return the outcome: it is to fall alone, and to stand when replaced, as well as told."""
    failed = replaced.failed_sensor
    column = plant.sensors.index(failed)
    late = replaced.time > story.isolated_at - 0.5 * story.period
    truth, told = replaced.truth[late, column], replaced.told[late]
    held = replaced.said[story.step(story.failed_at), column]
    rmse = float(np.sqrt(np.mean((told - truth) ** 2)))
    row = BalanceRow(
        system, failed, order, None if replaced.latency_ms is None else
        1e3 * (story.isolated_at - story.failed_at) + replaced.latency_ms,
        replaced.latency_ms, rmse,
        float(np.sqrt(np.mean((held - truth) ** 2))), plant.units.get(failed, ''),
        None if alone.fell_at is None else alone.fell_at - story.failed_at,
        (story.end if replaced.fell_at is None else replaced.fell_at) - story.failed_at)
    bar, stands = story.bar[failed], story.end - story.failed_at
    return Result(
        row, bar, f'it is to fall when nobody replaces {failed}; when it is replaced, to stand '
        f'{stands:g} s with an RMSE of at most {bar:g} {row.unit}'.rstrip(),
        alone.fell_at is not None and replaced.fell_at is None and rmse <= bar)


def told_of(story: Balance, plant: Plant, run: Watched) -> str:
    """Set what the replacer said of its error against the truth."""
    column = plant.sensors.index(run.failed_sensor)
    known = np.isfinite(run.deviation) & (run.time > story.isolated_at - 0.5 * story.period)
    if not known.any():
        return 'no standard deviation was given'
    error = np.abs(run.told - run.truth[:, column])[known]
    deviation, unit = run.deviation[known], plant.units.get(run.failed_sensor, '')
    return (f'standard deviation given: {deviation[0]:.2g} {unit} at first, {deviation[-1]:.2g} '
            f'{unit} at the end; {100.0 * np.mean(error <= 2.0 * deviation):.0f} % of the '
            'estimates are within two of it')


def _line(story: Balance, plant: Plant, failed: str, moment: Moment) -> str:
    """Draw the cart on its rail in one line."""
    end = story.fallen.get(story.travels, 1.0)
    place = round((moment.truth[story.travels] / end + 1.0) / 2.0 * (RAIL - 1))
    lean = moment.truth[story.leans]
    pole = '|' if abs(lean) < 0.03 else '/' if lean > 0.0 else '\\'
    rail = list('.' * RAIL)
    rail[min(max(place, 0), RAIL - 1)] = '_' if abs(lean) > 1.0 else pole
    frozen = 'measured' if moment.time < story.failed_at else 'frozen'
    return (f'{moment.time:8.1f} s  [{"".join(rail)}]  {failed} '
            f'{"REPLACED" if moment.isolated else frozen} {moment.told:7.3f}, truth '
            f'{moment.truth[failed]:7.3f} {plant.units.get(failed, "")}')
