"""replay DESIGN DATASET: lose sensors in recordings, and judge what a replacer would say then."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
import math
from pathlib import Path
import sys

import numpy as np

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.command.progress import Progress, shown_progress
from vsensor_ros.command.run import check_output, find_ros, run
from vsensor_ros.designer.processes import Processes
from vsensor_ros.engine import Setup
from vsensor_ros.isolator import Settings as IsolatorSettings
from vsensor_ros.observers import Design
from vsensor_ros.recordings import Dataset, read_dataset, Recording, settings, Windows
from vsensor_ros.recordings.bag import is_bag
from vsensor_ros.recordings.fault import KINDS
from vsensor_ros.recordings.judgement import judge_trials
from vsensor_ros.recordings.replay_page import need_libraries, write_page
from vsensor_ros.recordings.replay_text import replay_json, replay_text
from vsensor_ros.recordings.requirement import check, read_requirements
from vsensor_ros.recordings.trials import Case, run_trials, Trials
from vsensor_ros.whole_file import write_whole

USUAL = 30  # windows of a recording, where nothing is said of them
MOST = 10_000  # windows of a recording
PATIENCE = 3.0  # usual intervals of a sensor, before it is silent where nobody says when
STEPS = 10.0  # of the virtual sensors, at most, from a reading to the next where nobody says
SIZE = 3.0  # of a fault, in standard deviations of what its sensor says


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 1 when a requirement is not met, 2 when the input is bad."""
    parser = argparse.ArgumentParser(prog='replay', description=__doc__)
    parser.add_argument('design', type=Path, help='the design file')
    parser.add_argument('dataset', type=Path, help='a dataset file (see `recording`), or a table '
                        'whose columns are called as the channels')
    parser.add_argument('--params-file', type=Path, help="the replacer's parameter file: the "
                        "engine's settings; by default the one that wires the dataset")
    parser.add_argument('--rate', type=float, help='of the virtual sensors [Hz]; if no '
                        'parameter file says another 100, or less where sensors are slow')
    parser.add_argument('--windows', metavar='EVERY,LENGTH[,START]', help='a loss of LENGTH every '
                        f'EVERY [s]; by default as the dataset says, else {USUAL} in each '
                        'recording')
    parser.add_argument('--lose', action='append', metavar='NAMES', help='sensors that fail '
                        'together, with commas between; may be given again. Default: all fault '
                        'sets of the design')
    parser.add_argument('--faults', default='drop_out', metavar='KINDS',
                        help=f'with commas between, of {", ".join(KINDS)}; or all')
    parser.add_argument('--size', action='append', default=[], metavar='NAME=SIZE', help='of a '
                        "bias, or of a drift at its end, in the sensor's unit; noise has a third "
                        f'of it. Default: {SIZE:g} standard deviations of what it says')
    parser.add_argument('--told', type=float, default=0.0, metavar='S', help='after a loss, when '
                        'isolation says so')
    parser.add_argument('--isolator', action='store_true', help='nobody tells: the own isolator '
                        'finds out (the design is one of designer --isolate)')
    parser.add_argument('--require', action='append', default=[], metavar='TEXT',
                        help="such as 'T1: rmse < 0.8, coverage > 0.9'; exit status 1 if not met")
    parser.add_argument('--jobs', type=int, default=1, help='processes')
    parser.add_argument('--json', type=Path, metavar='FILE', help='write all numbers')
    parser.add_argument('--report', type=Path, metavar='FILE', help='write an HTML page')
    given = parser.parse_args(arguments)
    if not 1 <= given.jobs <= 1000:
        parser.error('--jobs must be 1 to 1000')
    if given.rate is not None and not 0.001 <= given.rate <= 1000.0:
        parser.error('--rate must be 0.001 to 1000')
    if not 0.0 <= given.told < math.inf:
        parser.error('--told must not be negative')
    return run('replay', lambda: _act(given), ros=False)


def _act(given: argparse.Namespace) -> int:
    for option, path in (('--json', given.json), ('--report', given.report)):
        check_output(path, option, [p for p in (
            given.design, given.dataset, given.params_file) if p is not None])
    if given.report is not None:
        need_libraries(given.report)
    design = Design.load(given.design)
    dataset = _dataset(given)
    parameters = given.params_file or dataset.wiring
    if (parameters is not None or any(map(is_bag, dataset.recordings))) and not find_ros('replay'):
        return 2
    setup = _setup(design, parameters, given)
    kinds, sets = _kinds(given.faults), _sets(given.lose, design)
    lost = [s for s in design.sensors if any(s in names for names in sets)]
    requirements = [r for text in given.require for r in read_requirements(text, lost)]
    with shown_progress() as progress:
        recordings = dataset.load(progress)
        _check_channels(recordings, design, given.dataset)
        usual = _usual_intervals(setup.design, recordings)
        if parameters is None:
            setup = _paced(setup, usual, given.rate)
        for line in _slow(setup, usual):
            print(f'replay: {line}', file=sys.stderr)
        windows = dataset.windows or _usual(recordings)
        trials = _run(given, setup, recordings,
                      [Case(names, kind) for names in sets for kind in kinds], windows, progress)
        judgements = judge_trials(setup, trials)
    outcomes = check(requirements, judgements)
    print(replay_text(judgements, outcomes, trials), flush=True)
    if given.json is not None:
        try:
            write_whole(given.json, replay_json(judgements, outcomes, trials) + '\n')
        except (OSError, ValueError) as error:
            raise BadInput(given.json, '--json', f'cannot be written ({reason(error)})',
                           'name a file in a folder that exists') from error
    if given.report is not None:
        write_page(given.report, f'{design.plant_name}: {given.dataset.name}', judgements,
                   outcomes, trials)
        print(f'the report is {given.report}')
    return 0 if all(o.passed for o in outcomes) else 1


def _run(given: argparse.Namespace, setup: Setup, recordings: Sequence[Recording],
         cases: Sequence[Case], windows: Windows, progress: Progress | None) -> Trials:
    if windows.length * setup.rate < 1.0:
        raise BadInput(given.dataset, 'windows', f'{windows.length:.3g} s are shorter than a step '
                       f'of the rate, {1.0 / setup.rate:g} s', 'give longer ones, or more of the '
                       'recording')
    if max(r.seconds for r in recordings) / windows.every > MOST:
        raise BadInput(given.dataset, 'windows', f'one every {windows.every:g} s is more than '
                       f'{MOST} in a recording', 'give fewer')
    if not any(len(windows.starts(r.seconds)) for r in recordings):
        raise BadInput(given.dataset, 'windows', f'none of {windows.length:g} s fits into '
                       f'{max(r.seconds for r in recordings):g} s', 'give shorter ones')
    told = None if given.isolator else given.told
    sizes = _sizes(given.size, recordings, setup.design)
    with nullcontext() if given.jobs == 1 else Processes(given.jobs) as executor:
        return run_trials(setup, recordings, cases, windows, sizes, told, given.jobs, executor,
                          progress)


def _dataset(given: argparse.Namespace) -> Dataset:
    if given.dataset.suffix in ('.yaml', '.yml'):
        dataset = read_dataset(given.dataset)
    else:
        dataset = Dataset((given.dataset,), given.params_file)
    return dataset if given.windows is None else replace(
        dataset, windows=Windows.of(given.windows))


def _setup(design: Design, parameters: Path | None, given: argparse.Namespace) -> Setup:
    """Return the settings of the engine: of a parameter file, else those of a node by default."""
    if parameters is None:
        setup = settings(design, given.rate or 100.0)
    else:
        from vsensor_ros.lab.parameter_file import read_parameters
        from vsensor_ros.node.parameters import setup_of

        setup = setup_of(design, read_parameters(parameters).given, parameters)
        setup = setup if given.rate is None else replace(setup, rate=given.rate)
    if not given.isolator:
        return replace(setup, isolator=None)
    if design.isolability is None or not design.isolability.residuals:
        raise BadInput(given.design, '--isolator', 'no residual of the design tells of a fault',
                       'make it with designer --isolate')
    return replace(setup, isolator=replace(setup.isolator or IsolatorSettings(), mode='act'))


def _kinds(text: str) -> list[str]:
    kinds = list(KINDS) if text == 'all' else [kind.strip() for kind in text.split(',')]
    for kind in kinds:
        if kind not in KINDS:
            raise BadInput('--faults', kind, 'is no kind of fault',
                           f'choose from {", ".join(KINDS)}')
    return kinds


def _sets(texts: Sequence[str] | None, design: Design) -> list[tuple[str, ...]]:
    if texts is None:
        return list(design.fault_sets)
    found = []
    for text in texts:
        names = {name.strip() for name in text.split(',')}
        if unknown := names - set(design.sensors):
            raise BadInput('--lose', min(unknown), 'is no sensor of the design',
                           f'choose from {", ".join(design.sensors)}')
        found.append(tuple(s for s in design.sensors if s in names))
    return found


def _sizes(texts: Sequence[str], recordings: Sequence[Recording],
           design: Design) -> dict[str, float]:
    said = {s: np.concatenate([r.tracks[s].values for r in recordings]) for s in design.sensors}
    sizes = {s: SIZE * float(np.std(there)) if len(there := values[np.isfinite(values)]) else 0.0
             for s, values in said.items()}
    for text in texts:
        name, _, number = text.partition('=')
        try:
            size = float(number)
        except ValueError:
            size = math.nan
        if name not in sizes or not math.isfinite(size):
            raise BadInput('--size', text, 'is not NAME=SIZE of a sensor', 'write it like y1=0.5')
        sizes[name] = size
    return sizes


def _check_channels(recordings: Sequence[Recording], design: Design, where: Path) -> None:
    for recording in recordings:
        lacking = [n for n in (*design.sensors, *design.inputs) if n not in recording.tracks]
        if lacking:
            raise BadInput(where, recording.name, f'lacks {", ".join(lacking)}', 'wire all sensors'
                           f' and commands; it has {", ".join(recording.tracks)}')


def _usual_intervals(design: Design, recordings: Sequence[Recording]) -> dict[str, float]:
    """Return s between readings of each sensor that speaks more than once, half of the time."""
    between = {name: np.concatenate([np.diff(r.tracks[name].stamps) for r in recordings]) * 1e-9
               for name in design.sensors}
    return {name: float(np.median(there)) for name, there in between.items() if len(there)}


def _paced(setup: Setup, usual: Mapping[str, float], rate: float | None) -> Setup:
    """Return settings for sensors as slow as these: a node's own are for quick ones."""
    slow = {name: PATIENCE * s for name, s in usual.items()
            if PATIENCE * s > setup.max_age[name]}
    fastest = min((s for s in usual.values() if s > 0.0), default=0.0)
    if rate is None and fastest and STEPS / fastest < setup.rate:
        setup = replace(setup, rate=STEPS / fastest)
        print(f'replay: at {setup.rate:.3g} Hz, as the sensors are slow: give --rate for another',
              file=sys.stderr)
    if slow:
        print('replay: slow sensors are waited for: a node needs '
              + ', '.join(f'sensors.{name}.max_age: {s:.3g}' for name, s in slow.items()),
              file=sys.stderr)
    return replace(setup, max_age={**setup.max_age, **slow})


def _slow(setup: Setup, usual: Mapping[str, float]) -> list[str]:
    """Say which sensors are taken for silent, because they speak less often than is allowed."""
    said = []
    for name, s in usual.items():
        allowed = max(setup.max_age[name], 3.0 / setup.rate)
        if s > allowed:
            said.append(f'{name} speaks every {s:.3g} s, and is taken for silent after '
                        f'{allowed:.3g} s: its sensors.{name}.max_age should be '
                        f'{PATIENCE * s:.3g}')
    return said


def _usual(recordings: Sequence[Recording]) -> Windows:
    every = max(r.seconds for r in recordings) / (USUAL + 1)
    return Windows(every, every / 2.0, every)


if __name__ == '__main__':
    sys.exit(main())
