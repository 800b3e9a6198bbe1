"""A design: all virtual sensors of one plant, to be looked up, saved and loaded."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.entry import Entry, Refusal
from vsensor_ros.observers.file import read, write


class Design(Contents):
    """All virtual sensors of one plant, by fault set and channel."""

    def __getitem__(self, key: tuple[Iterable[str], str]) -> Entry | Refusal:
        """
        Look up ``design[fault_set, channel]``; raise KeyError when it was not designed.

        ``design[(), 'v']`` is the wanted functional v with all sensors healthy.
        """
        try:
            fault_set, channel = key if isinstance(key, tuple) else ()
            names = {fault_set} if isinstance(fault_set, str) else set(fault_set)
            unknown = sorted(map(str, (names | ({channel} - set(self.wanted)))
                                 - set(self.sensors)))
        except (TypeError, ValueError):
            raise KeyError(f'{key!r:.80}: is not a fault set and a channel; write '
                           "design[('y1', 'y2'), 'y1']") from None
        if unknown:
            wanted = f' and, wanted, {", ".join(self.wanted)}' if self.wanted else ''
            raise KeyError(f'{", ".join(unknown)}: no such sensor; there are '
                           f'{", ".join(self.sensors)}{wanted}')
        ordered = tuple(name for name in self.sensors if name in names)
        if channel in self.sensors and channel not in names:
            raise KeyError(f'channel {channel} of fault set {{{", ".join(ordered)}}}: has not '
                           'failed there; name it in the fault set, too')
        try:
            return self.entries[ordered, channel]
        except KeyError:
            designed = ', '.join('{' + ', '.join(s) + '}' for s in self.fault_sets)
            raise KeyError(f'channel {channel} of fault set {{{", ".join(ordered)}}} was not '
                           f'designed; the fault sets are {designed}') from None

    @property
    def fault_sets(self) -> tuple[tuple[str, ...], ...]:
        """The sets of failed sensors that were designed for; () when something is wanted."""
        return tuple(dict.fromkeys(fault_set for fault_set, _ in self.entries))

    @property
    def virtual_sensors(self) -> tuple[Entry, ...]:
        """All virtual sensors, those of wanted functionals too, without the refusals."""
        return tuple(e for e in self.each_once() if not isinstance(e, Refusal))

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """All refusals."""
        return tuple(e for e in self.entries.values() if isinstance(e, Refusal))

    def isolating(self) -> Design:
        """
        Return the observers of residuals and fault sizes as a design, to be run for isolation.

        Dedicated filters, and what is there for a size only, are wanted functionals there: what
        they estimate is their residual, or the size.
        """
        filters = {} if self.isolability is None else dict(self.isolability.filters)
        residuals = () if self.isolability is None else self.isolability.residuals
        sizes = () if self.fault_sizes is None else self.fault_sizes.found
        entries = {(r.fault_set, r.channel): filters.get(r.channel)
                   or self.entries[r.fault_set, r.channel] for r in residuals}
        entries |= {(size.fault_set, size.channel): size.observer for size in sizes}
        wanted = (*filters, *(s.channel for s in sizes if s.channel not in self.sensors))
        return Design(**{**vars(self), 'entries': entries, 'wanted': wanted,
                         'isolability': None, 'fault_sizes': None})

    def save(self, path: str | Path) -> None:
        """
        Write the design file; the old file stays whole until the new one is complete.

        A link stays a link, a pipe or a device is written into. Raises BadInput when the file
        cannot be written, or when it would not be loaded.
        """
        write(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """
        Read a design file without executing anything in it.

        Raises BadInput, one line, when the file is missing, malformed, of another version, not
        finite, inconsistent in itself or unstable.
        """
        return cls(**vars(read(path)))
