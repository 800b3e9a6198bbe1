"""What sensors and commands said, with stamps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

BEGIN = 1_000_000_000  # ns, added to all stamps: a clock at 0 has not begun


@dataclass(frozen=True, eq=False)
class Track:
    """What one channel said: `values` (T,) at `stamps` (T,) [ns], which increase."""

    stamps: np.ndarray
    values: np.ndarray

    @classmethod
    def of(cls, times: ArrayLike, values: ArrayLike) -> Track:
        """Make one of times [s] from 0 on; raises ValueError unless they increase."""
        stamps = BEGIN + np.rint(np.asarray(times, float) * 1e9).astype(np.int64)
        found = np.asarray(values, float)
        if stamps.shape != found.shape or stamps.ndim != 1 or not (
                np.diff(stamps) > 0).all() or (stamps < BEGIN).any():
            raise ValueError('give as many values as times, which increase from 0 on')
        return cls(stamps, found)

    def at(self, times: ArrayLike) -> np.ndarray:
        """Return the values at times [s], on straight lines between the stamps."""
        there = BEGIN + np.asarray(times, float) * 1e9
        return np.interp(there, self.stamps, self.values)


@dataclass(frozen=True, eq=False)
class Recording:
    """The tracks of sensors and commands, by channel."""

    tracks: Mapping[str, Track]

    def events(self) -> Iterator[tuple[int, dict[str, float]]]:
        """Yield each stamp [ns] once, in order, with what was said then by channel."""
        names = list(self.tracks)
        stamps = np.concatenate([self.tracks[name].stamps for name in names])
        values = np.concatenate([self.tracks[name].values for name in names])
        owner = np.repeat(np.arange(len(names)), [len(self.tracks[n].stamps) for n in names])
        order = np.argsort(stamps, kind='stable')
        now, said = 0, dict[str, float]()
        for stamp, value, i in zip(stamps[order].tolist(), values[order].tolist(),
                                   owner[order].tolist()):
            if stamp != now:
                if said:
                    yield now, said
                now, said = stamp, {}
            said[names[i]] = value
        if said:
            yield now, said
