"""designer PLANT -o DESIGN: say for each sensor whether it can be replaced, and write the file."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
import io
import os
import sys
from typing import Any

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.designer import design
from vsensor_ros.designer.advice import advice
from vsensor_ros.designer.design import METHODS
from vsensor_ros.designer.location import locations
from vsensor_ros.observers import Design
from vsensor_ros.plant import load_plant
from vsensor_ros.report.design_answer import answer, closing
from vsensor_ros.report.page import check_target, write_report

MOST_BLOCKS = 10  # printed unasked

Progress = Callable[[int, int, str], None]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0, or 2 with one line on stderr when the input is bad."""
    options = _options(arguments)
    progress = _progress()
    try:
        _check_files(options)
        plant = load_plant(options.plant)
        asked = _fault_sets('--details', options.details)
        result = design(plant, _fault_sets('--fault-set', options.fault_set),
                        progress=progress, **_choices(options))
        blocks = _asked(result, asked)
        result.save(options.output)
        if progress is not None and options.locate:
            progress(0, 1, 'places for one more sensor')
        places = (locations(plant, up_to=max(map(len, result.fault_sets)),
                            isolate=options.isolate)
                  if options.locate else None)
        written = f'written to {options.output}'
        if options.report:
            path = write_report(options.report, plant, result, places, progress)
            written += f', the report to {path}'
        _clear(progress)
        minded = advice(plant, result, lambda other, lost: design(
            other, [lost], **{**_choices(options), 'up_to': None, 'isolate': False}))
        _say(f'{answer(result, blocks, places, plant, minded)}\n{closing(result)}; {written}')
    except BadInput as error:
        _clear(progress)
        print(f'designer: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        _clear(progress)
        print('designer: stopped', file=sys.stderr)
        return 130
    return 0


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
    parser.add_argument('--method', metavar='NAME',
                        help=f"one of the papers' methods instead of the whole search: "
                        f'{", ".join(METHODS)}')
    parser.add_argument('--report', metavar='PATH',
                        help='write a report, too: one HTML file, or a folder that will hold it')
    parser.add_argument('--locate', action='store_true',
                        help='say which one more sensor would let you lose the most others')
    parser.add_argument('--details', metavar='SENSORS', action='append',
                        help='print what was found for this fault set (with commas between), or '
                        f"'all'; needed where there are more than {MOST_BLOCKS}")
    return parser.parse_args(arguments)


def _choices(options: argparse.Namespace) -> dict[str, Any]:
    """Return what was chosen for the design; what was not said is left to it."""
    names = ('up_to', 'prefer', 'decay', 'method', 'temporary')
    chosen = {name: value for name in names if (value := getattr(options, name)) is not None}
    flags = ('bounded', 'isolate')
    return {**chosen, **{name: True for name in flags if getattr(options, name)}}


def _check_files(options: argparse.Namespace) -> None:
    given = {'PLANT': options.plant, '-o': options.output}
    if options.report is not None:
        given['--report'] = options.report
    for what, path in given.items():
        if not path:
            raise BadInput(what, '', 'is empty', 'name a file')
    outputs = [what for what in given if what != 'PLANT']
    for what, other, whose in [(o, 'PLANT', 'the plant file') for o in outputs] + [
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


def _asked(result: Design, details: list[list[str]] | None) -> set[tuple[str, ...]]:
    """Return the fault sets whose blocks are to be printed."""
    if details is None:
        return set(result.fault_sets) if len(result.entries) <= MOST_BLOCKS else set()
    if ['all'] in details:
        return set(result.fault_sets)
    sets = {tuple(s for s in result.sensors if s in names) for names in details}
    for names, chosen in zip(details, (set(n) for n in details)):
        if not any(set(s) == chosen for s in result.fault_sets):
            raise BadInput('--details', '', f'{",".join(names)} is no fault set of this design',
                           "give one, or 'all'")
    return sets


def _progress() -> Progress | None:
    """Return what keeps one line on the terminal up to date; None where nobody watches."""
    if sys.stderr is None or not sys.stderr.isatty():
        return None

    def show(done: int, total: int, text: str) -> None:
        sys.stderr.write(f'\r\x1b[K{done}/{total} {text:.60}')
        sys.stderr.flush()
    return show


def _clear(progress: Progress | None) -> None:
    if progress is not None:
        sys.stderr.write('\r\x1b[K')
        sys.stderr.flush()


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
