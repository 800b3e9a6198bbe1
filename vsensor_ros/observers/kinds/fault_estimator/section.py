"""The section of the design file that holds an observer of the kind fault_estimator."""

from __future__ import annotations

from typing import Any

import numpy as np

from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.fault_estimator.sensor import FaultObserver
from vsensor_ros.observers.memberships import read_memberships

_ARRAYS = ('ranges', 'from_readings', 'from_inputs', 'N', 'K', 'M', 'T2', 'Cv', 'P', 'initial',
           'from_first', 'deviations')
_MOST = 64  # submodels
_ROUNDING = 1e-14  # of the largest eigenvalue: a smaller one is none


def write_section(entry: FaultObserver) -> dict[str, Any]:
    """Return what the design file says of one, but for its kind, channel and fault set."""
    return {**{key: list(getattr(entry, key)) for key in (
                'outputs', 'reads', 'premises', 'memberships')},
            'order': entry.order, 'start': entry.start, 'alpha': entry.alpha,
            **{key: getattr(entry, key).tolist() for key in _ARRAYS}}


def read_section(reader: CheckedObject, channel: str, fault_set: tuple[str, ...], plant: Contents,
                 version: int) -> FaultObserver:
    """Read what write_section wrote; raises BadInput."""
    reader.only(('outputs', 'reads', 'premises', 'memberships', 'order', 'start', 'alpha',
                 *_ARRAYS))
    outputs, reads, premises = reader.texts('outputs'), reader.names('reads'), \
        reader.names('premises')
    if not set(reads) <= set(plant.sensors) - set(fault_set):
        raise reader.fail('reads', 'are not healthy sensors')
    if channel not in fault_set or len(set(outputs)) < len(outputs):
        raise reader.fail('channel', f'{channel} is not a sensor of its fault set, or an output '
                          'stands there twice')
    if plant.sample_time is None:
        raise reader.fail('kind', 'is for plants in discrete time')
    V, k, r, m, p, o = (len(reader.texts('memberships')), reader.whole('order'), len(reads),
                        len(plant.inputs), len(premises), len(outputs))
    if not 0 < V <= _MOST:
        raise reader.fail('memberships', f'are {V}, not 1 to {_MOST}')
    shapes = dict(zip(_ARRAYS, ((p, 2), (p, r), (p, m), (V, k, k), (V, k, r), (V, k, m), (k, r),
                                (o, k), (k, k), (k,), (k, r), (o,))))
    arrays = {key: reader.array(key, *shape) for key, shape in shapes.items()}
    memberships = read_memberships(reader, premises, arrays['ranges'])
    sizes = np.linalg.eigvalsh(arrays['P'])
    if not (arrays['P'] == arrays['P'].T).all() or \
            not sizes.min(initial=np.inf) > _ROUNDING * sizes.max(initial=0.0):
        raise reader.fail('P', 'is not symmetric and positive definite')
    if not (arrays['deviations'] >= 0.0).all():
        raise reader.fail('deviations', 'must not be negative')
    start, alpha = reader.number('start'), reader.positive('alpha')
    if start < 1.0:
        raise reader.fail('start', 'must be 1 or more')
    if alpha >= 1.0:
        raise reader.fail('alpha', 'must be below 1')
    rest: dict[str, Any] = arrays
    found = FaultObserver(channel, fault_set, outputs, reads, plant.inputs, plant.sample_time,
                          premises, memberships=memberships, start=start, alpha=alpha, **rest)
    if not _falls(found):
        raise reader.fail('N', "does not let e' P e fall by alpha at all submodels")
    return found


def _falls(entry: FaultObserver) -> bool:
    """Tell whether errors beyond the form fall at each submodel, but for rounding."""
    root = np.linalg.cholesky(entry.P).T
    norms = np.linalg.norm(root @ entry.N @ np.linalg.inv(root), 2, axis=(1, 2))
    return bool((norms**2 <= (1.0 - entry.alpha) * (1.0 + 1e-9)).all())
