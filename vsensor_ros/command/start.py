"""start TEMPLATE -o PLANT: write a plant file to begin with; alone it lists the templates."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
from shlex import quote
import sys

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.progress import shown_progress
from vsensor_ros.command.run import check_output
from vsensor_ros.first_plant import (
    Arm,
    arm_plant,
    black_box,
    box_lines,
    box_text,
    checked_name,
    filled,
    number,
    templates,
    urdf_plant,
    write_plant,
)
from vsensor_ros.first_plant.arm import GRAVITY
from vsensor_ros.fitting.runs import read_runs
from vsensor_ros.lab.config_folder import config_folder

ARM = 'arm'


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0, 2 with one line on stderr when the input is bad, or 130."""
    options = _options(arguments)
    try:
        folder = _folder()
        if not options.what and options.black_box is None:
            print(_listed(folder))
            return 0
        text = _text(folder, options) if options.black_box is None else _black_box(options)
        plant = write_plant(text, options.output, options.force)
    except BadInput as error:
        print(f'start: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('start: stopped', file=sys.stderr)
        return 130
    print(f'{plant.name}: {len(plant.states)} states, {len(plant.sensors)} sensors, written to '
          f'{options.output}\nEdit what its comments ask for; then: designer '
          f'{quote(str(options.output))} -o {plant.name}.design.json')
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='start', description='Write a plant file to begin with. Without arguments: list what '
        'there is to begin with.')
    parser.add_argument('what', metavar='WHAT', nargs='*',
                        help=f"a template, '{ARM}', a URDF file, or with --black-box recordings")
    parser.add_argument('--name', help='of the plant (default: that of the template)')
    parser.add_argument('--set', metavar='PARAMETER=VALUE', action='append', default=[],
                        help='value of a parameter of a template; may be given several times')
    arm = parser.add_argument_group(ARM, 'a planar arm; numbers with commas between, one a link')
    arm.add_argument('--masses', metavar='KG', type=_numbers, default=[])
    arm.add_argument('--lengths', metavar='M', type=_numbers, default=[])
    arm.add_argument('--centres', metavar='M', type=_numbers, default=[],
                     help='of mass from the joints (default: the middle)')
    arm.add_argument('--inertias', metavar='KG_M2', type=_numbers, default=[],
                     help='about these centres (default: of slender rods)')
    arm.add_argument('--gravity', metavar='M_S2', type=_gravity, default=GRAVITY,
                     help='0 where the axes are vertical (default: %(default)s)')
    urdf = parser.add_argument_group('URDF')
    urdf.add_argument('--base', metavar='LINK', help='first link (default: the root)')
    urdf.add_argument('--tip', metavar='LINK', help='last link (default: the only end there is)')
    box = parser.add_argument_group('black box', 'a linear model of recordings alone: dataset '
                                    'files (docs/recordings.md), or tables')
    box.add_argument('--black-box', metavar='STATES', type=_order,
                     help="how many states, or 'auto': what predicts best what is held out")
    box.add_argument('--commands', metavar='A,B', default='', type=_names,
                     help='the channels that are commands; all others are sensors')
    box.add_argument('--direct', action='store_true', help='sensors may show commands at once')
    box.add_argument('--step', metavar='S', type=_positive, help='of the model (default: a '
                     'twentieth of what the sensors remember)')
    box.add_argument('--from', metavar='S', type=float, default=0.0, dest='first',
                     help='where the part of each recording begins that it is of')
    box.add_argument('--to', metavar='S', type=float, default=math.inf, dest='last',
                     help='where it ends')
    parser.add_argument('-o', '--output', type=Path, metavar='PLANT', default=Path('plant.yaml'),
                        help='plant file to write (default: %(default)s)')
    parser.add_argument('--force', action='store_true', help='overwrite the output')
    return parser.parse_args(arguments)


def _text(folder: Path, options: argparse.Namespace) -> str:
    """Return the plant file that is asked for."""
    if len(options.what) > 1:
        raise BadInput('', options.what[1], 'is one too many', 'name one thing to begin with')
    options.what, = options.what
    of_arm = [options.masses, options.lengths, options.centres, options.inertias]
    is_urdf = Path(options.what).suffix in ('.urdf', '.xml', '.xacro')
    for given, belongs, options_ in ((any(of_arm), options.what == ARM, '--masses ..'),
                                     (options.base or options.tip, is_urdf, '--base and --tip'),
                                     (options.commands or options.direct or options.step, False,
                                      '--commands, --direct and --step without --black-box'),
                                     (options.set, options.what in templates(folder), '--set')):
        if given and not belongs:
            raise BadInput('', options_, f'does not go with {options.what}', 'leave it out')
    if options.what == ARM:
        return arm_plant(Arm(options.masses, options.lengths, options.centres,
                             options.inertias, options.gravity),
                         checked_name(options.name or ARM))
    if is_urdf:
        return urdf_plant(Path(options.what), options.base, options.tip,
                          options.name and checked_name(options.name))
    return filled(folder, options.what, options.name, _values(options.set))


def _black_box(options: argparse.Namespace) -> str:
    """Return the plant file of recordings, and print how good it is."""
    paths = [Path(path) for path in options.what]
    if not paths:
        raise BadInput('--black-box', '', 'is of no recording', 'name one, or more')
    check_output(options.output, '-o', paths)
    checked_name(options.name or 'black_box')
    runs = read_runs(paths, options.first, options.last)
    with shown_progress() as progress:
        box = black_box(runs, options.commands, options.black_box or None, options.step,
                        options.direct, progress)
    of = ', '.join(path.name for path in paths)
    if (options.first, options.last) != (0.0, math.inf):
        of += f', {options.first:g} s to ' + (
            'the end' if options.last == math.inf else f'{options.last:g} s')
    print('\n'.join([*box_lines(box, of), '']))
    return box_text(box, checked_name(options.name or 'black_box'), of)


def _order(text: str) -> int:
    """Return how many states; 0: auto."""
    if text != 'auto' and not (text.isdigit() and int(text) > 0):
        raise argparse.ArgumentTypeError(f'{text!r} is no number of states, and not auto')
    return 0 if text == 'auto' else int(text)


def _names(text: str) -> tuple[str, ...]:
    return tuple(name.strip() for name in text.split(',') if name.strip())


def _positive(text: str) -> float:
    value, *more = _numbers(text)
    if more or value <= 0.0:
        raise argparse.ArgumentTypeError(f'{text!r} is not a positive number')
    return value


def _numbers(text: str) -> list[float]:
    try:
        return [number(part, 'the list') for part in text.split(',')]
    except BadInput:
        raise argparse.ArgumentTypeError(
            f'{text!r} is not numbers with commas between') from None


def _gravity(text: str) -> float:
    value, *more = _numbers(text)
    if more:
        raise argparse.ArgumentTypeError(f'{text!r} is more than one number')
    return value


def _folder() -> Path:
    config = config_folder()
    if config is None or not (config / 'templates').is_dir():
        raise BadInput('', '', 'the templates are not found',
                       'install the package, or run it in its folder')
    return config / 'templates'


def _listed(folder: Path) -> str:
    known = {**templates(folder),
             ARM: 'Planar arm of n joints: --masses 1.2,0.8 --lengths 0.3,0.25',
             'FILE.urdf': 'Chain of joints of a URDF: --base LINK --tip LINK',
             'DATASET.yaml': 'Black box of recordings: --black-box auto --commands u1,u2'}
    width = max(map(len, known))
    return '\n'.join(['start WHAT [--name NAME] [--set PARAMETER=VALUE] -o plant.yaml', '',
                      *(f'{name:{width}}  {sentence}' for name, sentence in known.items())])


def _values(texts: Sequence[str]) -> dict[str, str]:
    values: dict[str, str] = {}
    for text in texts:
        name, sign, value = text.partition('=')
        if not sign or not name or name in values:
            problem = 'is there twice' if name in values else 'sets nothing'
            raise BadInput('', '--set', f'{text} {problem}',
                           'write it as --set inertia=0.02, each parameter once')
        values[name] = value
    return values


if __name__ == '__main__':
    sys.exit(main())
