"""The section of the design file that says how the sizes of faults are estimated."""

from __future__ import annotations

from typing import Any

import numpy as np

from vsensor_ros.observers.checked_json import CheckedObject, or_null
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.entry import Entry, Refusal
from vsensor_ros.observers.fault_size import (
    FaultSize,
    FaultSizes,
    Injection,
    METHODS,
    observer_name,
    SLIDING,
    TWISTING,
    VIRTUAL,
)
from vsensor_ros.observers.kinds import kind_named, kind_names

_KEYS = ('name', 'method', 'response', 'noise', 'deviation', 'assumed', 'disturbed', 'observer',
         'injection', 'others', 'why_not')
BEYOND = 1e30  # with such numbers no injection can be stepped


def fault_sizes_record(sizes: FaultSizes) -> dict[str, Any]:
    """Return the section."""
    return {'found': [_record(size) for size in sizes.found], 'refused': dict(sizes.refused)}


def _record(size: FaultSize) -> dict[str, Any]:
    observer, of = size.observer, size.injection
    return {
        'name': size.name, 'method': size.method, 'response': size.response,
        'noise': size.noise, 'deviation': size.deviation, 'assumed': size.assumed,
        **({'disturbed': or_null(size.disturbed)} if size.disturbed else {}),
        **({} if size.method == VIRTUAL else {'observer': {
            'kind': observer.kind, **kind_named(observer.kind).write(observer)}}),
        **({} if of is None else {'injection': {
            'N': of.N.tolist(), 'f': of.f.tolist(), 'c': of.c.tolist(), 'largest': of.largest,
            'change': of.change}}),
        'others': dict(size.others), 'why_not': dict(size.why_not)}


def read_fault_sizes(reader: CheckedObject, design: Contents, version: int) -> FaultSizes:
    """Read what fault_sizes_record wrote, for a design with its entries; raises BadInput."""
    reader.only(('found', 'refused'))
    found: dict[str, FaultSize] = {}
    for item in reader.objects('found'):
        size = _read(item, design, version)
        if found.setdefault(size.name, size) is not size:
            raise item.fail('name', f'{size.name:.80} stands there twice')
    refused = _texts(reader, 'refused', (*design.sensors, *design.inputs))
    for channel in refused:
        if channel in found:
            raise reader.fail('refused', f'{channel:.80} is found, too')
    return FaultSizes(tuple(found.values()), refused)


def _read(reader: CheckedObject, design: Contents, version: int) -> FaultSize:
    reader.only(_KEYS)
    name, method = reader.text('name'), reader.word('method', METHODS)
    if name not in (*design.sensors, *design.inputs):
        raise reader.fail('name', f'{name:.80} is neither a sensor nor an input')
    others = reader.object('others')
    others.only(METHODS)
    size = FaultSize(
        name, method, _read_observer(reader, name, method, design, version),
        reader.positive('response'), reader.size('noise'), reader.size('deviation'),
        reader.flag('assumed'),
        reader.size('disturbed', infinite=True) if 'disturbed' in reader.record else 0.0,
        _read_injection(reader, method, design),
        {other: others.size(other) for other in others.record},
        _texts(reader, 'why_not', METHODS))
    if method in size.others or method in size.why_not:
        raise reader.fail('method', f'{method} stands among the others, too')
    return size


def _read_observer(reader: CheckedObject, name: str, method: str, design: Contents,
                   version: int) -> Entry:
    if method == VIRTUAL:
        entry = design.entries.get(((name,), name))
        if entry is None or isinstance(entry, Refusal) or entry.grade == 'temporary':
            raise reader.fail('method', f'{name:.80} has no virtual sensor that lasts')
        if 'observer' in reader.record:
            raise reader.fail('observer', 'stands beside a virtual sensor')
        return entry
    channel = observer_name(name)
    if channel in (*design.sensors, *design.wanted):
        raise reader.fail('name', f'{channel:.80} is a sensor, or wanted')
    item = reader.object('observer')
    kind = kind_named(item.word('kind', kind_names()))
    return kind.read(item.without(('kind',)), channel, (), design, version)


def _read_injection(reader: CheckedObject, method: str, design: Contents) -> Injection | None:
    if method not in (SLIDING, TWISTING):
        if 'injection' in reader.record:
            raise reader.fail('injection', f'is none of a {method}')
        return None
    if design.sample_time is not None:
        raise reader.fail('method', 'a sliding mode is of continuous time')
    item = reader.object('injection')
    item.only(('N', 'f', 'c', 'largest', 'change'))
    k = len(item.get('f', list, 'a list of numbers'))
    N, f, c = item.array('N', k, k), item.array('f', k), item.array('c', k)
    if not k or abs(float(c @ f) - 1.0) > 1e-6:
        raise item.fail('c', 'is not 1 times f')
    if np.linalg.eigvals(N).real.max() >= 0.0:
        raise item.fail('N', 'is unstable')
    largest = item.positive('largest')
    change = item.positive('change') if method == TWISTING else item.size('change')
    for key, numbers in (('N', N), ('f', f), ('c', c), ('largest', largest), ('change', change)):
        if np.any(np.abs(numbers) > BEYOND):
            raise item.fail(key, f'has a number beyond {BEYOND:g}')
    if method == TWISTING and change < 1.0 / BEYOND:
        raise item.fail('change', f'is less than {1.0 / BEYOND:g}')
    return Injection(N, f, c, largest, change)


def _texts(reader: CheckedObject, key: str, names: tuple[str, ...]) -> dict[str, str]:
    item = reader.object(key)
    item.only(names)
    return {name: item.text(name) for name in item.record}
