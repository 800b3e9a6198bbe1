"""The section of the design file that holds a virtual sensor of the kind takagi_sugeno."""

from __future__ import annotations

from typing import Any

import numpy as np

from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.takagi_sugeno.sensor import ScheduledSensor
from vsensor_ros.observers.memberships import read_memberships

_MOST = 64  # submodels
_ARRAYS = ('ranges', 'from_readings', 'from_inputs', 'N', 'J', 'B', 'a', 'Cv', 'Q', 'S', 'initial')
_NUMBERS = ('start', 'decay', 'half_width', 'direct')


def write_section(entry: ScheduledSensor) -> dict[str, Any]:
    """Return what the design file says of one, but for its kind, channel and fault set."""
    return {'reads': list(entry.reads), 'grade': entry.grade, 'premises': list(entry.premises),
            'memberships': list(entry.memberships), 'order': entry.order,
            **({'why': entry.why} if entry.why else {}),
            **({'turns': entry.turns.tolist()} if entry.turns.any() else {}),
            **{key: getattr(entry, key) for key in _NUMBERS},
            **{key: getattr(entry, key).tolist() for key in _ARRAYS}}


def read_section(reader: CheckedObject, channel: str, fault_set: tuple[str, ...], plant: Contents,
                 version: int) -> ScheduledSensor:
    """Read what write_section wrote; raises BadInput."""
    reader.only(('reads', 'grade', 'premises', 'memberships', 'order', *_NUMBERS, *_ARRAYS, 'why',
                 'turns'))
    reads, premises = reader.names('reads'), reader.names('premises')
    if not set(reads) <= set(plant.sensors) - set(fault_set):
        raise reader.fail('reads', 'are not healthy sensors')
    if channel not in fault_set:
        raise reader.fail('channel', f'{channel} is not a sensor of its fault set')
    if plant.sample_time is not None:
        raise reader.fail('kind', 'is for plants in continuous time')
    V, k, r, m, p = (len(reader.texts('memberships')), reader.whole('order'), len(reads),
                     len(plant.inputs), len(premises))
    if not 0 < V <= _MOST:
        raise reader.fail('memberships', f'are {V}, not 1 to {_MOST}')
    shapes = dict(zip(_ARRAYS, ((p, 2), (p, r), (p, m), (V, k, k), (V, k, r), (V, k, m), (V, k),
                                (1, k), (1, r), (k, k), (k,))))
    arrays = {key: reader.array(key, *shape) for key, shape in shapes.items()}
    memberships = read_memberships(reader, premises, arrays['ranges'])
    if not np.linalg.eigvalsh(arrays['S'] + arrays['S'].T).min(initial=np.inf) > 0.0:
        raise reader.fail('S', 'is not positive definite')
    numbers = {key: reader.size(key) for key in _NUMBERS}
    for key, least in (('start', 1.0), ('half_width', numbers['direct'])):
        if numbers[key] < least:
            raise reader.fail(key, f'must be {least:g} or more')
    if not numbers['decay'] > 0.0:
        raise reader.fail('decay', 'must be positive')
    rest: dict[str, Any] = {
        **arrays, **numbers, 'why': reader.text('why') if 'why' in reader.record else '',
        'turns': reader.array('turns', p) if 'turns' in reader.record else np.zeros(0)}
    if (rest['turns'] < 0.0).any():
        raise reader.fail('turns', 'must not be negative')
    found = ScheduledSensor(channel, fault_set, reads, plant.inputs,
                            reader.word('grade', ('exact', 'bounded')), premises,
                            memberships=memberships, **rest)
    if not _falls(found):
        raise reader.fail('N', "does not let e' S e fall at the rate of decay at all submodels")
    return found


def _falls(entry: ScheduledSensor) -> bool:
    """Tell whether errors beyond the form fall at each submodel, but for rounding."""
    root = np.linalg.cholesky(entry.S).T
    slopes = root @ entry.N @ np.linalg.inv(root)
    fastest = np.linalg.eigvalsh(slopes + slopes.transpose(0, 2, 1))[:, -1]
    return bool((fastest <= -2.0 * entry.decay * (1.0 - 1e-9)).all())
