"""
Real recordings through the engine: how good the reserves of lost sensors are.

    VSENSOR_DATA=FOLDER python -m benchmark.recordings [drive] [two_link]

Models were fitted, and noise was chosen, on other parts than are judged here. Takes three minutes.
"""

from __future__ import annotations

from collections.abc import Sequence
import os
from pathlib import Path
import sys

import numpy as np

from vsensor_ros import design, load_plant
from vsensor_ros.engine import Setup
from vsensor_ros.plant import Plant
from vsensor_ros.recordings import Loss, Recording, replay, settings, Track, verdict
from vsensor_ros.simulate.recording import load_columns
from vsensor_ros.simulate.table import read_table

CONFIG = Path(__file__).resolve().parents[1] / 'config'
DRIVE = 'emps/DATA_EMPS.mat'
ARM = 'double_pendulum/trajectory_{:02}.csv'
ARM_PLANT = CONFIG / 'two_link' / 'plant.yaml'
RATE = 100.0  # Hz, of the engine
ELBOW = ('pos2', 'vel2')  # of one encoder
ELBOW_LOST = [Loss(ELBOW, at, at + 2.0) for at in range(1, 8)]


def drive(data: Path) -> tuple[Setup, Recording]:
    """Return an engine for the drive, and its recording."""
    columns = load_columns(data / DRIVE, {'time': 't', 'encoder': 'qm', 'voltage': 'vir'})
    time = columns.pop('time')
    return settings(design(load_plant(CONFIG / 'drive' / 'plant.yaml')), RATE), Recording(
        {name: Track.of(time, values) for name, values in columns.items()})


def two_link(plant: Plant, extended: bool = True) -> Setup:
    """Return an engine for the arm, whose encoders tell position and speed in one message."""
    return settings(design(plant, [ELBOW], extended=extended), RATE, (('pos1', 'vel1'), ELBOW))


def arm_run(data: Path, number: int) -> Recording:
    """Return a run of the arm."""
    columns = {'pos1': 'pos_meas1', 'pos2': 'pos_meas2', 'vel1': 'vel_meas1', 'vel2': 'vel_meas2',
               'torque1': 'tau_meas1', 'torque2': 'tau_meas2'}
    found = read_table(data / ARM.format(number))
    return Recording({name: Track.of(found[column].time, found[column].value)
                      for name, column in columns.items()})


def judge(label: str, setup: Setup, recording: Recording, losses: Sequence[Loss]) -> None:
    """Print what went out in these losses."""
    heard = replay(setup, recording, losses)
    for name in losses[0].names:
        v = verdict([said[name] for _, said in heard], recording.tracks[name])
        begun = np.mean([np.isfinite(said[name].values).any() for _, said in heard])
        print(f'{label} {name}: {v.losses} losses, {100 * begun:.0f} % served, for '
              f'{100 * v.served:.0f} % of the time; rmse {v.rmse:.3g}, held {v.held:.3g} '
              f'({v.held / v.rmse:.1f} times); at the end median {v.median:.2g}, 90 % '
              f'{v.ninetieth:.2g}; stated {v.deviation:.2g}, {100 * v.covered:.1f} % within two',
              flush=True)


def main(chosen: Sequence[str]) -> int:
    """Judge the chosen systems; all by default."""
    folder = os.environ.get('VSENSOR_DATA')
    if not folder:
        print('benchmark.recordings: set VSENSOR_DATA to the folder with the recordings',
              file=sys.stderr)
        return 2
    data = Path(folder)
    if 'drive' in chosen or not chosen:
        setup, recording = drive(data)
        judge('drive', setup, recording, [Loss(('encoder',), at, at + 1.0)
                                          for at in np.linspace(12.42, 23.8, 92)])
    if 'two_link' in chosen or not chosen:
        setup = two_link(load_plant(ARM_PLANT))
        for number in range(5):
            judge(f'arm, run {number}', setup, arm_run(data, number), ELBOW_LOST)
    return 0


if __name__ == '__main__':
    sys.exit(main(sys.argv[1:]))
