"""fit PLANT RECORDING ..: find the free parameters of a plant file, and how far they are good."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import sys

from vsensor_ros.command.progress import shown_progress
from vsensor_ros.command.run import check_output, run
from vsensor_ros.fitting import fit
from vsensor_ros.fitting.fit_text import fit_text, tried_text
from vsensor_ros.fitting.friction import chosen, tried
from vsensor_ros.fitting.plant_text import open_text, with_structure
from vsensor_ros.fitting.result_file import fitted_text, write_fitted
from vsensor_ros.fitting.runs import also_judged, read_runs
from vsensor_ros.plant.free import load_free


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 2 when something from outside cannot be used."""
    parser = argparse.ArgumentParser(prog='fit', description=__doc__)
    parser.add_argument('plant', type=Path, help='the plant file, in which parameters to be found '
                        'have a range: {value: 0.3, fit: [0.1, 1.0]}')
    parser.add_argument('recordings', type=Path, nargs='+', help='dataset files (docs/'
                        'recordings.md), or tables whose columns are called as the channels are')
    parser.add_argument('-o', '--output', type=Path, help='the plant file to write (the same is '
                        'allowed); without it nothing is written')
    parser.add_argument('--horizon', type=float, help='for how long it is simulated from a start '
                        '[s]; without it as long as the sensors remember, three times')
    parser.add_argument('--from', type=float, default=0.0, dest='first',
                        help='where the part begins that is fitted to [s from the start on]')
    parser.add_argument('--to', type=float, default=math.inf, dest='last', help='where it ends')
    parser.add_argument('--tries', type=int, default=5, help='starts of the search')
    parser.add_argument('--try', choices=('friction',), dest='structure',
                        help='compare structures in the place that the plant file names')
    given = parser.parse_args(arguments)
    if given.horizon is not None and not 0.0 < given.horizon < math.inf:
        parser.error('--horizon must be positive')
    if given.tries < 1:
        parser.error('--tries must be 1 or more')
    if not 0.0 <= given.first < given.last:
        parser.error('--from must be before --to, and not negative')
    return run('fit', lambda: _act(given), ros=False)


def _act(given: argparse.Namespace) -> int:
    check_output(given.output, '-o', given.recordings)
    free = None if given.structure else load_free(given.plant)
    content = None if given.output is None else open_text(given.plant)
    runs = read_runs(given.recordings, given.first, given.last)
    for name in also_judged(given.recordings, given.first, given.last):
        print(f'fit: the windows of {name} are in what is fitted to, so that they judge nothing '
              'new: give --to, and windows a start behind it', file=sys.stderr)
    lines: list[str] = []
    with shown_progress() as progress:
        if free is None:
            structures = tried(given.plant, runs, given.horizon, progress)
            best = chosen(structures)
            lines = [*tried_text(structures, best), '']
            print('\n'.join(lines), flush=True)
            free = best.free
            if content is not None:
                with_structure(content, best.content)
        result = fit(free, runs, given.horizon, given.tries, progress)
    lines += fit_text(result, _of(given))
    print('\n'.join(fit_text(result, _of(given))), flush=True)
    if given.output is not None:
        write_fitted(given.output, fitted_text(result, given.plant, lines, content))
        print(f'written to {given.output}')
    return 0


def _of(given: argparse.Namespace) -> str:
    """Say what it was fitted to."""
    names = ', '.join(path.name for path in given.recordings)
    if given.first == 0.0 and given.last == math.inf:
        return names
    end = 'the end' if given.last == math.inf else f'{given.last:g} s'
    return f'{names}, {given.first:g} s to {end}'


if __name__ == '__main__':
    sys.exit(main())
