"""What was found of delays, as text for the terminal, with what they cost a live node."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.fitting.align import Aligned
from vsensor_ros.plant.free import FreePlant
from vsensor_ros.recordings import Recording

STEPS = 1000  # that a node can go back at most, see bank/grid.py


def align_text(result: Aligned, of: str) -> list[str]:
    """Return the table of delays; of: what they were found in."""
    lines = [f'delays in {of}: {result.count} windows of {result.seconds:.3g} s; the stamps of '
             f'{result.reference} count as right', '',
             f'{"channel":<14} {"delay [s]":>10} {"+-":>8}']
    for name, delay in result.delays.items():
        error, note = result.errors[name], ''
        if name == result.reference:
            note = 'reference'
        elif not np.isfinite(error):
            note = 'not seen: it does not move enough, or nothing in the plant goes with it'
        elif name in result.commands and abs(delay) > 2.0 * error:
            note = 'acts later than it is said: delay of the input' if delay > 0.0 \
                else 'acts before it is said: its stamps are late'
        elif name in result.late():
            note = 'its stamps are late' if delay > 0.0 else 'less late than the reference'
        shown = f'{delay:>10.4f} {error:>8.2g}' if np.isfinite(error) else f'{"-":>10} {"-":>8}'
        lines.append(f'{name:<14} {shown}  {note}'.rstrip())
    return lines


def cost_text(given: FreePlant, runs: Sequence[Recording], delays: dict[str, float],
              rate: float) -> list[str]:
    """
    Return what sensors that are so late [s] cost a node that runs at a rate [Hz].

    Of a late sensor the last reading is held until the next tells what was.
    """
    lines = []
    for name, delay in delays.items():
        unit = given.plant.units[name]
        lines.append(f'{name} is {delay:.4g} s late: live, its readings are held for so long, '
                     f'and then all is computed anew. It moves by {_moved(runs, name, delay):.3g} '
                     f'{unit}'.rstrip() + ' (rms) meanwhile, which estimates that read it may be '
                     'off by')
        if delay * rate >= STEPS:
            lines.append(f'{name}: a node at {rate:g} Hz cannot wait for that: it goes back by '
                         f'{STEPS} steps; run it below {STEPS / delay:.3g} Hz')
    return lines


def _moved(runs: Sequence[Recording], name: str, delay: float) -> float:
    """Return by how much a sensor changes in a time, rms."""
    changes = [track.at(track.times[track.times >= track.times[0] + delay])
               - track.at(track.times[track.times >= track.times[0] + delay] - delay)
               for run in runs if (track := run.tracks.get(name)) is not None]
    return float(np.sqrt(np.mean(np.concatenate(changes)**2)))
