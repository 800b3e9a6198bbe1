"""What a sweep ends with when some of its tasks met an error, or a worker that died."""

from __future__ import annotations

from collections.abc import Mapping

from vsensor_ros.observers import Design, Key


class Unfinished(RuntimeError):
    """
    Some channels met an error or a worker that died; all others were designed.

    design: what was designed; failed: the error by fault set and channel. str() is one line that
    names the first of them.
    """

    def __init__(self, design: Design, failed: Mapping[Key, BaseException], total: int) -> None:
        self.design = design
        self.failed = dict(failed)
        key, error = next(iter(self.failed.items()))
        said = ' '.join(f'{type(error).__name__}: {error}'.split())
        super().__init__(f'{name_of(key)}: {said:.200}; {len(failed)} of {total} channels failed, '
                         'the others are designed')


def name_of(key: Key) -> str:
    """Return a channel and its fault set in words."""
    fault_set, channel = key
    return f'{channel} without {", ".join(fault_set) or "a fault"}'
