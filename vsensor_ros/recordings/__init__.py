"""Recordings at the desk: read, played through the engine that runs on the machine, judged."""

from vsensor_ros.recordings.dataset import (
    Dataset,
    load_dataset,
    read_dataset,
    Windows,
    write_dataset,
)
from vsensor_ros.recordings.judgement import judge_trials, Judgement
from vsensor_ros.recordings.recording import Recording, Track
from vsensor_ros.recordings.through_engine import Loss, replay, Said, settings
from vsensor_ros.recordings.trials import Case, run_trials, Trials
from vsensor_ros.recordings.verdict import Verdict, verdict

__all__ = ['Case', 'Dataset', 'Judgement', 'Loss', 'Recording', 'Said', 'Track', 'Trials',
           'Verdict', 'Windows', 'judge_trials', 'load_dataset', 'read_dataset', 'replay',
           'run_trials', 'settings', 'verdict', 'write_dataset']
