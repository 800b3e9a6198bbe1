"""How the tracking of a virtual sensor stands in the design file."""

from __future__ import annotations

from typing import Any

import numpy as np

from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.observers.kinds.functional.virtual_sensor import is_stable, Tracking, worst_of
from vsensor_ros.observers.knowledge_section import read_covariance

_LARGEST = 1e100  # so that their products are numbers
_ARRAYS = ('L', 'C', 'Q', 'Qu', 'P', 'W')


def tracking_record(t: Tracking) -> dict[str, Any]:
    """Write it."""
    return {
        'channels': list(t.channels),
        **{key: getattr(t, key).tolist() for key in _ARRAYS},
        'direct': t.direct,
        'assumed': t.assumed,
        'noise': None if t.noise is None else t.noise.tolist(),
        'slopes': None if t.slopes is None else t.slopes.tolist(),
    }


def read_tracking(v: CheckedObject, fault_set: tuple[str, ...], channel: str, N: np.ndarray,
                  l0: int, m: int, sample_time: float | None) -> Tracking | None:
    """Read that of a virtual sensor with N (k, k), l0 readings and m commands; raises BadInput."""
    if 'tracking' not in v.record:
        return None
    reader = v.object('tracking')
    reader.only(('channels', *_ARRAYS, 'direct', 'assumed', 'noise', 'slopes'))
    channels = reader.names('channels')
    if not channels or not set(channels) <= set(fault_set):
        raise reader.fail('channels', 'are not some of the fault set')
    if channels[0] != channel:
        raise reader.fail('channels', 'do not begin with its own')
    k, f = len(N), len(channels)
    if not k:
        raise v.fail('tracking', 'stands there, but of order 0 there is nothing to track')
    L, C = reader.array('L', k, f), reader.array('C', f, k)
    Q, Qu = reader.array('Q', f, l0), reader.array('Qu', f, m)
    for key, found in (('L', L), ('C', C), ('Q', Q), ('Qu', Qu)):
        if (np.abs(found) > _LARGEST).any():
            raise reader.fail(key, f'has a number above {_LARGEST:g}')
    slopes = None if reader.record.get('slopes', 0) is None else reader.array('slopes', k, k)
    noise = None if reader.record.get('noise', 0) is None else reader.array('noise', f)
    if noise is not None and (noise < 0.0).any():
        raise reader.fail('noise', 'must not be negative')
    modes = np.linalg.eigvals((N if slopes is None else slopes) - L @ C).astype(complex)
    if not is_stable(modes, sample_time):
        raise reader.fail('L', 'leaves N - L C unstable (eigenvalue '
                          f'{worst_of(modes, sample_time):.6g})')
    return Tracking(channels, L, C, Q, Qu,
                    read_covariance(reader, 'P', k), read_covariance(reader, 'W', k),
                    reader.size('direct'), reader.flag('assumed'), noise, slopes)
