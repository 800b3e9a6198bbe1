"""The section of the design file that holds a virtual sensor of the kind extended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import Apply, function_of, parse, walk
from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.extended.sensor import (
    ExtendedSensor,
    immersed_states,
    Model,
    Tried,
)

_LARGEST = 1e75  # so that its square is a number
_VECTORS = ('process_noise', 'input_noise', 'unknown_noise', 'noise', 'lasts', 'initial', 'start')


def write_section(entry: ExtendedSensor) -> dict[str, Any]:
    """Return what the design file says of one, but for its kind, channel and fault set."""
    m = entry.model
    return {
        'reads': list(entry.reads), 'decay': entry.decay, 'warm_up': entry.warm_up,
        'ages': entry.ages.tolist(), 'drift': entry.drift.tolist(),
        'equations': list(m.equations), 'unknown': list(m.unknown),
        **({'definitions': [{'name': name, 'text': text} for name, text in m.definitions]}
           if m.definitions else {}),
        **({'why': entry.why} if entry.why else {}),
        **({'tried': vars(entry.tried)} if entry.tried else {}),
        **({'angle': {'state': m.angle, 'factors': m.factors.tolist()}} if m.angle else {}),
        'parameters': [{'name': name, 'value': value, 'spread': spread} for name, value, spread
                       in zip(m.parameters, m.values.tolist(), m.spreads.tolist())],
        **{key: getattr(m, key).tolist() for key in (*_VECTORS, 'C', 'Cu')}}


def read_section(reader: CheckedObject, channel: str, fault_set: tuple[str, ...], plant: Contents,
                 version: int) -> ExtendedSensor:
    """Read what write_section wrote; raises BadInput."""
    reader.only(('reads', 'decay', 'warm_up', 'ages', 'drift', 'equations', 'unknown',
                 'parameters', *_VECTORS, 'C', 'Cu', 'why', 'angle',
                 'tried', 'definitions'))
    reads = reader.names('reads')
    if not set(reads) <= set(plant.sensors) - set(fault_set):
        raise reader.fail('reads', 'are not healthy sensors')
    if channel not in fault_set:
        raise reader.fail('channel', f'{channel} is not a sensor of its fault set')
    angle, factors = _angle(reader, plant)
    states = immersed_states(plant.states, angle) if angle else plant.states
    n, m, L = len(states), len(plant.inputs), len(plant.sensors)
    unknown, items = reader.names('unknown'), reader.objects('parameters')
    for item in items:
        item.only(('name', 'value', 'spread'))
    parameters = CheckedObject(reader.path, f'{reader.place}parameters.', {
        'name': [item.text('name') for item in items]}).names('name')
    known = (*states, *plant.inputs, *unknown, *parameters)
    if len(set(known)) < len(known):
        raise reader.fail('parameters', 'have a name that stands for something else')
    equations = reader.texts('equations')
    if len(equations) != n:
        raise reader.fail('equations', f'are not {n}, one a state')
    definitions = _definitions(reader, known)
    known = (*known, *(name for name, _ in definitions))
    for i, text in enumerate(equations):
        check_equation(text, known, reader.path, f'{reader.place}equations[{i}]')
    lengths = dict(zip(_VECTORS, (n, m, len(unknown), L, L, n, n)))
    vectors = {key: reader.array(key, length) for key, length in lengths.items()}
    for key in _VECTORS:
        if key != 'initial' and (vectors[key] < 0.0).any():
            raise reader.fail(key, 'must not be negative')
    if not (vectors['noise'] > 1.0 / _LARGEST).all():
        raise reader.fail('noise', 'must be positive')
    for key, found in vectors.items():
        if (np.abs(found) > _LARGEST).any():
            raise reader.fail(key, f'has a number above {_LARGEST:g}')
    ages = reader.array('ages', len(reader.get('ages', list, 'a list of numbers')))
    if len(ages) < 2 or ages[0] < 0.0 or not (np.diff(ages) > 0.0).all():
        raise reader.fail('ages', 'are not times that rise')
    drift = reader.array('drift', len(ages))
    if (drift < 0.0).any():
        raise reader.fail('drift', 'must not be negative')
    model = Model(states, plant.inputs, equations, unknown, parameters,
                  np.array([item.number('value') for item in items]),
                  np.array([item.size('spread') for item in items]),
                  C=reader.array('C', L, n), Cu=reader.array('Cu', L, m),
                  sample_time=plant.sample_time, angle=angle, factors=factors,
                  definitions=definitions, **vectors)
    own = plant.sensors.index(channel)
    if angle:
        if not factors[own]:
            raise reader.fail('angle', f'is not what {channel} reads')
        turning = [name for name, factor in zip(plant.sensors, factors) if factor]
        if model.C[factors != 0.0].any() or model.Cu[factors != 0.0].any():
            raise reader.fail('angle', 'is read by sensors together with something else')
        if not set(reads).isdisjoint(turning):
            raise reader.fail('reads', f'names a sensor of the angle {angle}')
    elif not model.C[own].any():
        raise reader.fail('C', f'tells nothing of {channel}')
    return ExtendedSensor(channel, fault_set, reads, model, reader.size('decay'),
                          reader.size('warm_up'), ages, drift,
                          reader.text('why') if 'why' in reader.record else '',
                          _tried(reader) if 'tried' in reader.record else None)


def _definitions(reader: CheckedObject, known: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Read what equations use by name; each may use what is known, and those before it."""
    if 'definitions' not in reader.record:
        return ()
    items = reader.objects('definitions')
    for item in items:
        item.only(('name', 'text'))
    found = CheckedObject(reader.path, f'{reader.place}definitions.', {
        'name': [item.text('name') for item in items]}).names('name')
    if len({*known, *found}) < len(known) + len(found):
        raise reader.fail('definitions', 'have a name that stands for something else')
    texts = [item.text('text') for item in items]
    for i, text in enumerate(texts):
        check_equation(text, (*known, *found[:i]), reader.path,
                       f'{reader.place}definitions[{i}]')
    return tuple(zip(found, texts))


def _tried(reader: CheckedObject) -> Tried:
    found = reader.object('tried')
    found.only(tuple(field.name for field in fields(Tried)))
    for share in ('within', 'lost', 'served'):
        if not found.size(share) <= 1.0:
            raise found.fail(share, 'is no share')
    return Tried(found.whole('runs'), *(found.size(key) for key in (
        'seconds', 'rmse', 'within', 'lost', 'served')))


def _angle(reader: CheckedObject, plant: Contents) -> tuple[str, np.ndarray]:
    """Read which state is an angle that the model has as cosine and sine; '' if there is none."""
    if 'angle' not in reader.record:
        return '', np.zeros(0)
    inner = reader.object('angle')
    inner.only(('state', 'factors'))
    angle = inner.text('state')
    if angle not in plant.states:
        raise inner.fail('state', 'is not a state')
    factors = inner.array('factors', len(plant.sensors))
    if not ((factors == 0.0) | (np.abs(factors) > 1.0 / _LARGEST)).all() or \
            (np.abs(factors) > _LARGEST).any():
        raise inner.fail('factors', 'has a number that is too small or too large')
    return angle, factors


def check_equation(text: str, known: Sequence[str], where: object, key: str) -> None:
    """Raise BadInput for a text outside of the language, or with a jump that is held at rest."""
    for part in walk(parse(text, where, key, known=known)):
        if isinstance(part, Apply) and function_of(part).set_valued:
            raise BadInput(where, key, f'{part.function} jumps: it has no slope there',
                           'write dry friction with tanh')
