"""designer PLANT -o DESIGN: say for each sensor whether it can be replaced, and write the file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import BrokenExecutor
from contextlib import nullcontext
import io
import os
import sys
import traceback
from typing import Any

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.command.progress import shown_progress
from vsensor_ros.control import check_loop, closed_loop, load_controller
from vsensor_ros.designer import design
from vsensor_ros.designer.advice import advice
from vsensor_ros.designer.design import chosen_sets, METHODS
from vsensor_ros.designer.filter_trial import with_trials
from vsensor_ros.designer.location import locations
from vsensor_ros.designer.processes import Processes
from vsensor_ros.designer.unfinished import Unfinished
from vsensor_ros.plant import load_plant, Plant
from vsensor_ros.report.design_answer import answer, closing
from vsensor_ros.report.page import check_target, write_report

MOST_BLOCKS = 10  # printed unasked
MOST_JOBS = 1000
WORK = '.work'  # behind the name of the design file: what is designed so far


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command.

    Return 0; 2 with one line on stderr when the input is bad; 1 when some channels met an error;
    130 when it was stopped.
    """
    options = _options(arguments)
    work = f'{options.output}{WORK}'
    try:
        _check_files(options)
        said = _design(options, None if _is_special(options.output) else work)
        _say(said)
    except BadInput as error:
        print(f'designer: {error}', file=sys.stderr)
        return 2
    except Unfinished as error:
        if not isinstance(error.__cause__, BrokenExecutor):  # ours to mend
            traceback.print_exception(error.__cause__)
        print(f'designer: {error}{_kept(work)}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f'designer: stopped{_kept(work)}', file=sys.stderr)
        return 130
    return 0


def _design(options: argparse.Namespace, work: str | None) -> str:
    """Design, write all that is asked for, and return what is to be said."""
    plant = load_plant(options.plant)
    controller = load_controller(options.controller, plant) if options.controller else None
    if controller is not None:
        check_loop(plant, controller, options.uncertainty)
    details = _fault_sets('--details', options.details)
    sets = _fault_sets('--fault-set', options.fault_set)
    asked = _asked(plant, chosen_sets(plant, sets, options.up_to, False), details)
    if work is not None and not options.resume:
        _remove(work)
    with shown_progress() as progress:
        with nullcontext() if options.jobs == 1 else Processes(options.jobs) as executor:
            result = design(plant, sets, progress=progress, executor=executor, work_file=work,
                            **_choices(options))
        result = with_trials(plant, result)
        result.save(options.output)
        if work is not None:
            _remove(work)
        if progress is not None and options.locate:
            progress(0, 1, 'places for one more sensor')
        places = (locations(plant, up_to=max(map(len, result.fault_sets)),
                            isolate=options.isolate)
                  if options.locate else None)
        if progress is not None and controller is not None:
            progress(0, 1, 'closing the loop')
        loop = None if controller is None else closed_loop(
            plant, result, controller, options.uncertainty)
        minded = advice(plant, result, lambda other, lost: design(
            other, [lost], **{**_choices(options), 'up_to': None, 'isolate': False}))
        written = f'written to {options.output}'
        if options.report:
            path = write_report(options.report, plant, result, places, progress, minded, loop)
            written += f', the report to {path}'
    return (f'{answer(result, asked, places, plant, minded, loop)}\n{closing(result)}; '
            f'{written}')


def _is_special(path: str) -> bool:
    """Tell whether an output is there and no file: a pipe, a device, a folder."""
    return os.path.exists(path) and not os.path.isfile(path)


def _remove(work: str) -> None:
    try:
        if os.path.isfile(work):
            os.remove(work)
    except OSError as error:
        raise BadInput(work, '', f'cannot be removed ({reason(error)})',
                       'it holds what an earlier run has designed: remove it') from error


def _kept(work: str) -> str:
    """Say what a run has left to go on from."""
    if not os.path.isfile(work):
        return ''
    return f'; what is designed is kept in {work}: --resume goes on from it'


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='designer', description='Design a virtual sensor for every sensor of a plant.')
    parser.add_argument('plant', metavar='PLANT', help='plant file (YAML)')
    parser.add_argument('-o', '--output', metavar='DESIGN', required=True,
                        help='design file to write (JSON)')
    which = parser.add_mutually_exclusive_group()
    which.add_argument('--fault-set', metavar='SENSORS', action='append',
                       help='sensors that fail together, with commas between; may be given '
                       'several times (default: every single sensor)')
    which.add_argument('--up-to', metavar='N', type=int,
                       help='every set of up to N sensors')
    parser.add_argument('--prefer', metavar='WHAT',
                        help='quiet: the least order whose noise is within a factor of two of the '
                        'best (default); least: the least order there is')
    parser.add_argument('--decay', metavar='RATE', type=float,
                        help='rate [1/s] at which errors are to die out (default: as fast as '
                        'noise allows)')
    parser.add_argument('--bounded', action='store_true',
                        help='where unknown inputs cannot be kept out, hand out virtual sensors '
                        'that they disturb, with the gain stated')
    parser.add_argument('--no-temporary', dest='temporary', action='store_false', default=None,
                        help='refuse where a virtual sensor would serve for a time only, because '
                        'a mode stays that no healthy sensor sees')
    parser.add_argument('--isolate', action='store_true',
                        help='say whose fault can be told from whose, and design what tells it: '
                        'pairs, and filters that read all sensors but one')
    parser.add_argument('--no-scheduled', dest='scheduled', action='store_false', default=None,
                        help='no virtual sensors whose injection follows the readings, where '
                        'constant gains are not proved over the declared ranges')
    parser.add_argument('--no-extended', dest='extended', action='store_false', default=None,
                        help='no Kalman filters on the equations, of which nothing is proved, '
                        'where the plant says how far off its parameters may be')
    parser.add_argument('--spread', metavar='SHARE', type=float,
                        help='how far off those parameters may be of which the plant file says '
                        'nothing, as a share of their values (one standard deviation), such as '
                        '0.05: for Kalman filters on the equations')
    parser.add_argument('--method', metavar='NAME',
                        help=f"one of the papers' methods instead of the whole search: "
                        f'{", ".join(METHODS)}')
    parser.add_argument('--jobs', metavar='N', type=_jobs, default=1,
                        help='processes that share the work (default: %(default)s)')
    parser.add_argument('--resume', action='store_true',
                        help='go on from what a run that was stopped has kept in DESIGN.work')
    parser.add_argument('--report', metavar='PATH',
                        help='write a report, too: one HTML file, or a folder that will hold it')
    parser.add_argument('--locate', action='store_true',
                        help='say which one more sensor would let you lose the most others')
    parser.add_argument('--controller', metavar='FILE',
                        help='close the loop with a controller file (YAML), with all sensors '
                        'healthy and with each fault set replaced: poles, sensitivity, noise')
    parser.add_argument('--uncertainty', metavar='SHARE',
                        help='look at that loop where the parameters are off, too: 10%% (all of '
                        'the plant file), or mass=10%%,length=5%%')
    parser.add_argument('--details', metavar='SENSORS', action='append',
                        help='print what was found for this fault set (with commas between), or '
                        f"'all'; needed where there are more than {MOST_BLOCKS}")
    return parser.parse_args(arguments)


def _jobs(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= MOST_JOBS:
        raise argparse.ArgumentTypeError(f'{text!r} is not a number from 1 to {MOST_JOBS}')
    return int(text)


def _choices(options: argparse.Namespace) -> dict[str, Any]:
    """Return what was chosen for the design; what was not said is left to it."""
    names = ('up_to', 'prefer', 'decay', 'method', 'temporary', 'scheduled', 'extended',
             'spread')
    chosen = {name: value for name in names if (value := getattr(options, name)) is not None}
    flags = ('bounded', 'isolate')
    return {**chosen, **{name: True for name in flags if getattr(options, name)}}


def _check_files(options: argparse.Namespace) -> None:
    given = {'PLANT': options.plant, '-o': options.output}
    read = {'PLANT': 'the plant file'}
    if options.controller is not None:
        given['--controller'], read['--controller'] = options.controller, 'the controller file'
    elif options.uncertainty is not None:
        raise BadInput('--uncertainty', '', 'stands there without a controller',
                       'name its file: --controller FILE')
    if options.report is not None:
        given['--report'] = options.report
    for what, path in given.items():
        if not path:
            raise BadInput(what, '', 'is empty', 'name a file')
    outputs = [what for what in given if what not in read]
    for what, other, whose in [(o, r, read[r]) for o in outputs for r in read] + [
            (o, '-o', 'the design file') for o in outputs[1:]]:
        if _same(given[what], given[other]):
            raise BadInput(what, '', f'{given[what]} is {whose} itself', 'name another file')
    if options.report is not None:
        check_target(options.report)


def _same(path: str, other: str) -> bool:
    try:
        return os.path.samefile(path, other)
    except (OSError, ValueError):  # not both are there; what is missing is said when it is opened
        return os.path.abspath(path) == os.path.abspath(other)


def _fault_sets(option: str, texts: list[str] | None) -> list[list[str]] | None:
    if texts is None:
        return None
    sets = [[name.strip() for name in text.split(',')] for text in texts]
    if not all(name for names in sets for name in names):
        raise BadInput(option, '', 'a name is empty', f'write it as {option} y1,y2')
    return sets


def _asked(plant: Plant, sets: list[tuple[str, ...]],
           details: list[list[str]] | None) -> set[tuple[str, ...]]:
    """Return the fault sets whose blocks are to be printed."""
    if details is None:
        return set(sets) if sum(map(len, sets)) <= MOST_BLOCKS else set()
    if ['all'] in details:
        return set(sets)
    for names in details:
        if set(names) not in map(set, sets):
            raise BadInput('--details', '', f'{",".join(names)} is no fault set of this design',
                           "give one, or 'all'")
    return {tuple(s for s in plant.sensors if s in names) for names in details}


def _say(text: str) -> None:
    """Print to a stdout that may be full, closed or ASCII only; BadInput when it cannot."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors='backslashreplace')  # a unit may be °C
    try:
        print(text, flush=True)
    except OSError as error:
        # what is left in the buffer must not fail once more when Python ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise BadInput('stdout', '', f'cannot be written ({reason(error)})',
                       'the design file is complete') from error


if __name__ == '__main__':
    sys.exit(main())
