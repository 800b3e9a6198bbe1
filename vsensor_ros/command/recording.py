"""recording PATH ..: say what is in recordings, wire them, and write them as a table."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
import math
from pathlib import Path
import sys

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.progress import shown_progress
from vsensor_ros.command.run import check_output, find_ros, run
from vsensor_ros.recordings import Dataset, read_dataset, Windows, write_dataset
from vsensor_ros.recordings.aligned_table import check_target, write_aligned
from vsensor_ros.recordings.bag import is_bag
from vsensor_ros.recordings.columns import Clock, UNITS
from vsensor_ros.recordings.dataset import read_mapping
from vsensor_ros.recordings.survey_text import survey_text
from vsensor_ros.recordings.surveying import survey

DATASET = ('.yaml', '.yml')


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit status: 2 when something from outside cannot be used."""
    parser = argparse.ArgumentParser(prog='recording', description=__doc__)
    parser.add_argument('paths', type=Path, nargs='+', metavar='PATH', help='a bag (a folder, '
                        '.db3, .mcap, .bag), .csv, .mat, .parquet, or a dataset file (.yaml)')
    parser.add_argument('--wire', type=Path, metavar='FILE', help="a replacer's parameter file, "
                        'for bags; a file that says channel: column, for tables')
    parser.add_argument('--to', type=Path, metavar='TABLE', help='write the channels of one '
                        'recording as a table, .parquet or .csv')
    parser.add_argument('--rate', type=float, help='of the rows of that table [Hz], each with '
                        'what was said last; without it a row for each stamp')
    parser.add_argument('--dataset', type=Path, metavar='FILE', help='write all this as a dataset '
                        'file, which fit and replay take')
    parser.add_argument('--time', default='', metavar='COLUMN', help='with the times of a table')
    parser.add_argument('--time-unit', default='', choices=tuple(UNITS))
    parser.add_argument('--period', type=float, default=0.0, help='between two rows of a table '
                        'that has no times [s]')
    parser.add_argument('--windows', metavar='EVERY,LENGTH[,START]', help='for the dataset file: '
                        'a window of LENGTH every EVERY [s]')
    given = parser.parse_args(arguments)
    if given.rate is not None and not 0.0 < given.rate < math.inf:
        parser.error('--rate must be positive')
    if not 0.0 <= given.period < math.inf:
        parser.error('--period must be positive')
    return run('recording', lambda: _act(given), ros=False)


def _act(given: argparse.Namespace) -> int:
    if given.to is not None:
        check_target(given.to)
    dataset = _dataset(given)
    read = [*dataset.recordings, *([given.wire] if given.wire is not None else [])]
    check_output(given.to, '--to', [*given.paths, *read])
    check_output(given.dataset, '--dataset', read)
    if any(map(is_bag, dataset.recordings)) and not find_ros('recording'):
        return 2
    if given.to is not None and len(dataset.recordings) != 1:
        raise BadInput('--to', '', f'writes one recording, and there are '
                       f'{len(dataset.recordings)}', 'name one')
    if given.to is not None and dataset.wiring is None and is_bag(dataset.recordings[0]):
        raise BadInput('--to', '', 'what is to be in the table is not said', "give --wire, a "
                       "replacer's parameter file")
    with shown_progress() as progress:
        found = [survey(path, dataset, progress) for path in dataset.recordings]
    print('\n\n'.join(map(survey_text, found)), flush=True)
    if given.to is not None:
        with shown_progress() as progress:
            write_aligned(given.to, dataset.load(progress)[0], given.rate)
        print(f'written to {given.to}')
    if given.dataset is not None:
        write_dataset(given.dataset, dataset)
        print(f'dataset written to {given.dataset}')
    return 0


def _dataset(given: argparse.Namespace) -> Dataset:
    """Return what is to be read, and how."""
    named = [path for path in given.paths if path.suffix in DATASET]
    if named:
        if len(given.paths) > 1:
            raise BadInput(named[0], '', 'is a dataset file, which stands alone',
                           'name it, or recordings')
        dataset = read_dataset(named[0])
    else:
        dataset = Dataset(tuple(path.absolute() for path in given.paths), clock=Clock(
            given.time, given.time_unit, given.period))
    if given.windows is not None:
        dataset = replace(dataset, windows=Windows.of(given.windows))
    if given.wire is None:
        return dataset
    if any(map(is_bag, dataset.recordings)):
        dataset = replace(dataset, wiring=given.wire.absolute())
    if not all(map(is_bag, dataset.recordings)):
        dataset = replace(dataset, columns=read_mapping(given.wire))
    return dataset


if __name__ == '__main__':
    sys.exit(main())
