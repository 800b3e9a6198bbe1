"""Recordings at the desk: played through the engine that runs on the machine, and judged."""

from vsensor_ros.recordings.recording import Recording, Track
from vsensor_ros.recordings.replay import Loss, replay, Said
from vsensor_ros.recordings.verdict import Verdict, verdict

__all__ = ['Loss', 'Recording', 'Said', 'Track', 'Verdict', 'replay', 'verdict']
