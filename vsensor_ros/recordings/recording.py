"""What sensors and commands said, with stamps."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

BEGIN = 1_000_000_000  # ns, added to times from 0: a clock at 0 has not begun


@dataclass(frozen=True, eq=False)
class Track:
    """What one channel said: `values` (T,) at `stamps` (T,) [ns], which increase."""

    stamps: np.ndarray
    values: np.ndarray
    origin: int = BEGIN  # ns, the stamp of the time 0

    @classmethod
    def of(cls, times: ArrayLike, values: ArrayLike) -> Track:
        """Make one of times [s] from 0 on; raises ValueError unless they increase."""
        stamps = BEGIN + np.rint(np.asarray(times, float) * 1e9).astype(np.int64)
        found = np.asarray(values, float)
        if stamps.shape != found.shape or stamps.ndim != 1 or not (
                np.diff(stamps) > 0).all() or (stamps < BEGIN).any():
            raise ValueError('give as many values as times, which increase from 0 on')
        return cls(stamps, found)

    @classmethod
    def in_order(cls, stamps: np.ndarray, values: np.ndarray, origin: int) -> Track:
        """Make one of stamps [ns] as they came: in order, of those that are the same the first."""
        found, first = np.unique(stamps, return_index=True)
        return cls(found, values[first], origin)

    @property
    def times(self) -> np.ndarray:
        """Times (T,) [s] from the origin on."""
        return (self.stamps - self.origin) * 1e-9

    def at(self, times: ArrayLike) -> np.ndarray:
        """Return the values at times [s], on straight lines between the numbers there are."""
        there = np.isfinite(self.values)
        return np.interp(np.asarray(times, float) * 1e9, self.stamps[there] - self.origin,
                         self.values[there])

    def held(self, stamps: np.ndarray) -> np.ndarray:
        """Return what was said last at stamps [ns], NaN before anything was."""
        i = np.searchsorted(self.stamps, stamps, side='right') - 1
        return np.where(i >= 0, self.values[i], np.nan)


@dataclass(frozen=True, eq=False)
class Recording:
    """The tracks of sensors and commands, by channel; all have the same origin."""

    tracks: Mapping[str, Track]
    name: str = ''  # where it is from
    units: Mapping[str, str] = field(default_factory=dict)  # where they are known

    @property
    def origin(self) -> int:
        """The stamp of the time 0 [ns]."""
        return next((track.origin for track in self.tracks.values()), BEGIN)

    @property
    def seconds(self) -> float:
        """Until when something was said, from the origin on."""
        return max((float(track.times[-1]) for track in self.tracks.values() if len(track.stamps)),
                   default=0.0)

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
