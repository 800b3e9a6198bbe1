"""align PLANT RECORDING ..: find by how much the stamps of sensors are late."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
import math
from pathlib import Path
import sys

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.progress import shown_progress
from vsensor_ros.command.run import check_output, run
from vsensor_ros.fitting import align
from vsensor_ros.fitting.align_file import into_dataset, into_plant
from vsensor_ros.fitting.align_text import align_text, cost_text
from vsensor_ros.fitting.plant_text import open_text
from vsensor_ros.fitting.result_file import write_fitted
from vsensor_ros.fitting.runs import DATASET, read_runs
from vsensor_ros.plant.free import load_free


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 2 when something from outside cannot be used."""
    parser = argparse.ArgumentParser(prog='align', description=__doc__)
    parser.add_argument('plant', type=Path, help='the plant file: what belongs together')
    parser.add_argument('recordings', type=Path, nargs='+', help='dataset files (docs/'
                        'recordings.md), or tables whose columns are called as the channels are')
    parser.add_argument('-o', '--output', type=Path, help='the plant file to write, with the '
                        'stamp_offset of sensors that are late (the same is allowed)')
    parser.add_argument('--into-dataset', action='store_true', help='write them into the dataset '
                        'file instead: of a recording whose stamps are later than live ones')
    parser.add_argument('--from', type=float, default=0.0, dest='first',
                        help='where the part begins that is looked at [s from the start on]')
    parser.add_argument('--to', type=float, default=math.inf, dest='last', help='where it ends')
    parser.add_argument('--most', type=float, help='the longest delay that is looked for [s]; '
                        'without it 1, or 10 readings')
    parser.add_argument('--reference', metavar='SENSOR', help='whose stamps count as right; '
                        'without it a sensor that is late the least')
    parser.add_argument('--rate', type=float, default=100.0, help='of the node that is to wait '
                        'for late readings [Hz] (default: %(default)g)')
    given = parser.parse_args(arguments)
    if given.most is not None and not 0.0 < given.most < math.inf:
        parser.error('--most must be positive')
    if not 0.0 < given.rate < math.inf:
        parser.error('--rate must be positive')
    if not 0.0 <= given.first < given.last:
        parser.error('--from must be before --to, and not negative')
    return run('align', lambda: _act(given), ros=False)


def _act(given: argparse.Namespace) -> int:
    check_output(given.output, '-o', given.recordings)
    dataset = given.recordings[0]
    if given.into_dataset and (len(given.recordings) > 1 or dataset.suffix not in DATASET):
        raise BadInput('--into-dataset', '', 'needs one dataset file', 'name it alone')
    free = load_free(given.plant, every=True)
    if given.output is not None:
        open_text(given.plant)  # what cannot be written is said before the work
    runs = read_runs(given.recordings, given.first, given.last)
    with shown_progress() as progress:
        result = align(free, runs, given.most, given.reference, progress)
    names = ', '.join(path.name for path in given.recordings)
    late = {name: delay for name, delay in result.late().items() if delay > 0.0}
    print('\n'.join([*align_text(result, names), *cost_text(free, runs, late, given.rate)]),
          flush=True)
    for wanted, put, source, path in (
            (given.output, into_plant, given.plant, given.output),
            (given.into_dataset, into_dataset, dataset, dataset)):
        if wanted:
            text, offsets = put(result, source)
            write_fitted(path, text)
            print(f'written to {path}: ' + (', '.join(
                f'{name} {value:g} s' for name, value in offsets.items()) or 'no delay'))
    return 0


if __name__ == '__main__':
    sys.exit(main())
