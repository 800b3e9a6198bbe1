"""start TEMPLATE -o PLANT: write a plant file to begin with; alone it lists the templates."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
import sys

from vsensor_ros.bad_input import BadInput
from vsensor_ros.first_plant import filled, templates, write_plant
from vsensor_ros.lab.config_folder import config_folder


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return 0, 2 with one line on stderr when the input is bad, or 130."""
    options = _options(arguments)
    try:
        folder = _folder()
        if options.what is None:
            print(_listed(folder))
            return 0
        text = filled(folder, options.what, options.name, _values(options.set))
        plant = write_plant(text, options.output, options.force)
    except BadInput as error:
        print(f'start: {error}', file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print('start: stopped', file=sys.stderr)
        return 130
    print(f'{plant.name}: {len(plant.states)} states, {len(plant.sensors)} sensors, written to '
          f'{options.output}\nEdit what its comments ask for; then: designer {options.output} '
          f'-o {plant.name}.design.json')
    return 0


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog='start', description='Write a plant file to begin with. Without arguments: list what '
        'there is to begin with.')
    parser.add_argument('what', metavar='WHAT', nargs='?', help='a template')
    parser.add_argument('--name', help='of the plant (default: that of the template)')
    parser.add_argument('--set', metavar='PARAMETER=VALUE', action='append', default=[],
                        help='value of a parameter; may be given several times')
    parser.add_argument('-o', '--output', type=Path, metavar='PLANT', default=Path('plant.yaml'),
                        help='plant file to write (default: %(default)s)')
    parser.add_argument('--force', action='store_true', help='overwrite the output')
    return parser.parse_args(arguments)


def _folder() -> Path:
    config = config_folder()
    if config is None or not (config / 'templates').is_dir():
        raise BadInput('', '', 'the templates are not found',
                       'install the package, or run it in its folder')
    return config / 'templates'


def _listed(folder: Path) -> str:
    known = templates(folder)
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
