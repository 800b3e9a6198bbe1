"""Recordings at the desk: read, played through the engine that runs on the machine, judged."""

from vsensor_ros.recordings.dataset import (
    Dataset,
    load_dataset,
    read_dataset,
    Windows,
    write_dataset,
)
from vsensor_ros.recordings.recording import Recording, Track
from vsensor_ros.recordings.through_engine import Loss, replay, Said, settings
from vsensor_ros.recordings.verdict import Verdict, verdict

__all__ = ['Dataset', 'Loss', 'Recording', 'Said', 'Track', 'Verdict', 'Windows', 'load_dataset',
           'read_dataset', 'replay', 'settings', 'verdict', 'write_dataset']
