"""The section of the design file that holds a virtual sensor of the kind nonlinear."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from vsensor_ros.functions.expression import parse
from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.nonlinear.sensor import Condition, names_in, NonlinearSensor

_MOST = 32  # states, and expressions of each sort
_BY_SENSOR = ('noise_of', 'lasts', 'direct', 'pushes')
_TEXTS = ('phi', 'F', 'residuals', 'tracks', 'driven')
_NUMBERS = ('turn', 'decay', 'warm_up', 'followed', 'useful')
_WORDS = ('words', 'why')


def write_section(entry: NonlinearSensor) -> dict[str, Any]:
    """Return what the design file says of one, but for its kind, channel and fault set."""
    return {'reads': list(entry.reads), 'grade': entry.grade, 'proved': entry.proved,
            'z': list(entry.z), **{key: list(getattr(entry, key)) for key in _TEXTS},
            'out': entry.out, 'validity': [c._asdict() for c in entry.validity],
            'region': {name: list(ends) for name, ends in entry.region.items()},
            **{key: getattr(entry, key).tolist() for key in (
                'initial', 'start', 'process_noise', 'ages', 'drift')},
            **{key: dict(getattr(entry, key)) for key in _BY_SENSOR},
            **{key: getattr(entry, key) for key in (*_NUMBERS, *_WORDS)}}


def read_section(reader: CheckedObject, channel: str, fault_set: tuple[str, ...], plant: Contents,
                 version: int) -> NonlinearSensor:
    """Read what write_section wrote; raises BadInput."""
    reader.only(('reads', 'grade', 'proved', 'z', *_TEXTS, 'out', 'validity', 'region', 'initial',
                 'start', 'process_noise', 'ages', 'drift', *_BY_SENSOR, *_NUMBERS, *_WORDS))
    reads, z = reader.names('reads'), reader.names('z')
    if not set(reads) <= set(plant.sensors) - set(fault_set):
        raise reader.fail('reads', 'are not healthy sensors')
    if channel not in fault_set:
        raise reader.fail('channel', f'{channel} is not a sensor of its fault set')
    taken = {*plant.sensors, *plant.inputs} & set(z)
    if taken or len(z) > _MOST:
        raise reader.fail('z', f'holds {min(taken)}, which is a sensor or an input' if taken
                          else f'are {len(z)}, more than {_MOST}')
    grade, known = reader.word('grade', ('exact', 'temporary')), (*z, *reads, *plant.inputs)
    texts = {key: reader.texts(key) for key in _TEXTS}
    for key in ('phi', 'F'):
        if len(texts[key]) != len(z):
            raise reader.fail(key, f'are not {len(z)}, one a state')
    if len(texts['driven']) % max(len(z), 1):
        raise reader.fail('driven', f'are not as many for each of {len(z)} states')
    for key, names in (('phi', plant.states), ('F', known), ('residuals', known),
                       ('tracks', (*known, *fault_set)), ('driven', known)):
        if len(texts[key]) > (most := _MOST * (len(z) if key == 'driven' else 1)):
            raise reader.fail(key, f'are more than {most}')
        _check(reader, key, texts[key], names)
    out, conditions = reader.text('out'), reader.objects('validity')
    _check(reader, 'out', [out], known)
    for item in conditions:
        item.only(('positive', 'words'))
    validity = tuple(Condition(item.text('positive'), item.text('words')) for item in conditions)
    _check(reader, 'validity', [c.positive for c in validity], known)
    if not z and (grade == 'temporary' or texts['tracks'] or texts['residuals']):
        raise reader.fail('z', 'are none, of which nothing is to be tracked')
    if grade == 'temporary' and not texts['tracks']:
        raise reader.fail('tracks', 'are missing: nothing tells a temporary one where to start')
    every = {*reads, *(names_in(texts['tracks']) & set(fault_set))}
    by_sensor = {key: _by_name(reader, key, every if key in ('noise_of', 'lasts') else reads)
                 for key in _BY_SENSOR}
    for name in every - by_sensor['noise_of'].keys():
        raise reader.fail('noise_of', f'tells nothing of {name}')
    k, T = len(z), len(reader.get('ages', list, 'a list of numbers'))
    vectors = {key: reader.array(key, length) for key, length in (
        ('initial', k), ('process_noise', k), ('ages', T), ('drift', T))}
    ages, start = vectors['ages'], reader.array('start', k, k)
    if T < 2 or ages[0] < 0.0 or not (np.diff(ages) > 0.0).all():
        raise reader.fail('ages', 'are not times that rise')
    for key in ('process_noise', 'drift'):
        if (vectors[key] < 0.0).any():
            raise reader.fail(key, 'must not be negative')
    size = float(np.abs(start).max(initial=0.0))
    if not np.allclose(start, start.T, 1e-9, 1e-9 * size) or \
            np.linalg.eigvalsh(start + start.T).min(initial=0.0) < -1e-9 * size:
        raise reader.fail('start', 'is no covariance')
    rest: dict[str, Any] = {**texts, **by_sensor, **vectors,
                            **{key: reader.size(key) for key in _NUMBERS},
                            **{key: reader.text(key) for key in _WORDS}}
    return NonlinearSensor(
        channel, fault_set, reads, plant.inputs, grade, reader.flag('proved'), z, out=out,
        validity=validity, region=_region(reader, known), start=start,
        sample_time=plant.sample_time, **rest)


def _check(reader: CheckedObject, key: str, texts: Sequence[str], known: Sequence[str]) -> None:
    """Raise BadInput unless all are in the language, over known names."""
    for i, text in enumerate(texts):
        parse(text, reader.path, f'{reader.place}{key}[{i}]', known=known)


def _by_name(reader: CheckedObject, key: str, names: Sequence[str] | set[str],
             ) -> dict[str, float]:
    inner = reader.object(key)
    inner.only(names)
    return {name: inner.size(name) for name in inner.record}


def _region(reader: CheckedObject, names: Sequence[str]) -> dict[str, tuple[float, float]]:
    inner, found = reader.object('region'), {}
    inner.only(names)
    for name in inner.record:
        low, high = inner.array(name, 2)
        if not low < high:
            raise inner.fail(name, 'is not [low, high] with low below high')
        found[name] = float(low), float(high)
    return found
