"""Recordings of real machines, played through the engine; benchmark.recordings has all."""

import os
from pathlib import Path

import numpy as np
import pytest

from benchmark import recordings
from vsensor_ros import Design, load_plant
from vsensor_ros.designer.extended import extended
from vsensor_ros.recordings import Loss, Recording, replay, settings, Track, verdict

ROOT = Path(__file__).resolve().parents[2]
DATA = Path(os.environ.get('VSENSOR_DATA') or 'nowhere')


@pytest.fixture
def drive():
    if not (DATA / recordings.DRIVE).is_file():
        pytest.skip(f'VSENSOR_DATA names no folder with {recordings.DRIVE}')
    return recordings.drive(DATA)


def test_a_drives_position_is_good_for_a_second(drive):
    setup, recording = drive
    heard = replay(setup, recording, [Loss(('encoder',), start, start + 1.0)
                                      for start in (13.0, 14.1, 15.2)])
    found = verdict([said['encoder'] for _, said in heard], recording.tracks['encoder'])
    assert found.served > 0.99 and found.covered >= 0.9
    assert found.median <= 0.002 and found.ninetieth <= 0.004 < found.held / 10


def test_losses_do_not_disturb_each_other(drive):
    setup, recording = drive
    loss = Loss(('encoder',), 3.0, 3.3)
    (_, alone), = replay(setup, recording, [loss])
    both = replay(setup, recording, [loss, Loss(('encoder',), 2.9, 3.2)])
    assert np.isfinite(alone['encoder'].values).all()
    np.testing.assert_array_equal(both[1][1]['encoder'].values, alone['encoder'].values)


@pytest.mark.slow
@pytest.mark.parametrize('run', [3, 4])  # in the other one the elbow turns over
def test_an_elbow_is_as_good_as_is_said(run):
    if not (DATA / recordings.ARM.format(run)).is_file():
        pytest.skip(f'VSENSOR_DATA names no folder with {recordings.ARM.format(run)}')
    plant, elbow = load_plant(recordings.ARM_PLANT), recordings.ELBOW
    made = Design(plant.name, plant.hash(), plant.states, plant.inputs, plant.sensors,
                  dict(plant.units), None, {(elbow, c): extended(plant, elbow, c) for c in elbow},
                  ranges=plant.reading_ranges())
    recording = recordings.arm_run(DATA, run)
    heard = replay(settings(made, recordings.RATE, (('pos1', 'vel1'), elbow)), recording,
                   recordings.ELBOW_LOST)
    for name in elbow:
        found = verdict([said[name] for _, said in heard], recording.tracks[name])
        assert found.covered >= 0.9 and found.held >= 10.0 * found.rmse
        assert found.served >= (0.95 if run == 3 else 0.5)


def test_events_come_in_order_each_stamp_once():
    recording = Recording({'a': Track.of([0.0, 0.2], [1.0, 2.0]),
                           'b': Track.of([0.1, 0.2], [3.0, 4.0])})
    assert [said for _, said in recording.events()] == [
        {'a': 1.0}, {'b': 3.0}, {'a': 2.0, 'b': 4.0}]
    with pytest.raises(ValueError, match='increase'):
        Track.of([0.0, 0.0], [1.0, 2.0])
