"""
Kinds of virtual sensors. This is the seam: nothing outside a kind's own file knows more of it.

A kind has frozen data (an `Entry`), a section of the design file and a batch for the bank. Its
file makes a `Kind` of them and registers it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.entry import Entry
from vsensor_ros.observers.kinds.batch import Batch, Bent, StepOfSome, Told, Tracked

__all__ = ['Batch', 'Bent', 'Kind', 'StepOfSome', 'Told', 'Tracked', 'kind_named', 'kind_names',
           'register']


@dataclass(frozen=True)
class Kind:
    """One kind of virtual sensors, under the name that its entries have as `kind`."""

    name: str
    # returns the keys and values of an entry's section of the design file, but for kind, channel
    # and fault_set
    write: Callable[[Any], dict[str, Any]]
    # makes an entry of such a section, a channel and a fault set, the design (without its
    # entries) and the version of the file; raises BadInput
    read: Callable[[CheckedObject, str, tuple[str, ...], Contents, int], Entry]
    # makes a batch of all entries of this kind, their design, the period of the steps [s], and
    # the gains (L, m) of the commands that the bank takes out of each reading; None: none
    batch: Callable[[Sequence[Any], Contents, float, np.ndarray | None], Batch]
    # returns in what entries are alike that are put into one batch
    alike: Callable[[Any], Hashable] = lambda entry: None


_KINDS: dict[str, Kind] = {}


def register(kind: Kind) -> None:
    """Make a kind known; raises ValueError when its name is taken."""
    if _KINDS.setdefault(kind.name, kind) != kind:
        raise ValueError(f'{kind.name}: there is a kind of this name already')


def kind_named(name: str) -> Kind:
    """Return a kind that is known; raises KeyError."""
    return _KINDS[name]


def kind_names() -> tuple[str, ...]:
    """Return the names of all kinds that are known."""
    return tuple(_KINDS)
