"""Recordings at the desk: played through the engine that runs on the machine, and judged."""

from vsensor_ros.recordings.recording import Recording, Track
from vsensor_ros.recordings.through_engine import Loss, replay, Said, settings
from vsensor_ros.recordings.verdict import Verdict, verdict

__all__ = ['Loss', 'Recording', 'Said', 'Track', 'Verdict', 'replay', 'settings', 'verdict']
