"""The section of the design file that says which sensor's fault can be told from which."""

from __future__ import annotations

from typing import Any

from vsensor_ros.observers.checked_json import CheckedObject
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.entry import Entry, Refusal
from vsensor_ros.observers.isolability import (
    Distinction,
    Isolability,
    Residual,
    STRENGTHS,
)
from vsensor_ros.observers.kinds import kind_named, kind_names


def isolability_record(isolability: Isolability) -> dict[str, Any]:
    """Return the section."""
    return {
        'residuals': [{
            'name': r.name, 'fault_set': list(r.fault_set), 'channel': r.channel,
            'support': list(r.support), 'gains': list(r.gains), 'noise': r.noise,
            'threshold': r.threshold, 'assumed': r.assumed} for r in isolability.residuals],
        'filters': [{
            'kind': f.kind, 'channel': f.channel, 'fault_set': list(f.fault_set),
            **kind_named(f.kind).write(f)} for f in isolability.filters.values()],
        'plant': [{'sensor': d.sensor, 'others': list(d.others), 'strength': d.strength}
                  for d in isolability.plant],
        'gaps': list(isolability.gaps),
    }


def read_isolability(reader: CheckedObject, design: Contents, version: int) -> Isolability:
    """Read what isolability_record wrote, for a design with its entries; raises BadInput."""
    reader.only(('residuals', 'filters', 'plant', 'gaps'))
    filters: dict[str, Entry] = {}
    for item in reader.objects('filters'):
        read = _read_filter(item, design, version)
        if filters.setdefault(read.channel, read) is not read:
            raise item.fail('channel', f'{read.channel:.80} stands there twice')
    residuals: dict[str, Residual] = {}
    for item in reader.objects('residuals'):
        residual = _read_residual(item, design, filters)
        if residuals.setdefault(residual.name, residual) is not residual:
            raise item.fail('name', f'{residual.name:.80} stands there twice')
    found = Isolability(tuple(residuals.values()), filters, _read_plant(reader, design),
                        reader.texts('gaps'))
    for d in found.plant:
        bank = found.by_residuals(d.sensor, d.others)
        if STRENGTHS.index(bank) > STRENGTHS.index(d.strength):
            raise reader.fail('plant', f'says {d.strength} of {d.sensor} against '
                              f'{", ".join(d.others) or "no fault"}, and a residual {bank}')
    return found


def _read_filter(reader: CheckedObject, design: Contents, version: int) -> Entry:
    channel, fault_set = reader.text('channel'), _read_sensors(reader, 'fault_set', design)
    if channel in design.sensors or channel in design.wanted:
        raise reader.fail('channel', f'{channel:.80} is a sensor, or wanted')
    kind = kind_named(reader.word('kind', kind_names()))
    return kind.read(reader.without(('kind', 'channel', 'fault_set')), channel, fault_set, design,
                     version)


def _read_residual(reader: CheckedObject, design: Contents,
                   filters: dict[str, Entry]) -> Residual:
    reader.only(('name', 'fault_set', 'channel', 'support', 'gains', 'noise', 'threshold',
                 'assumed'))
    fault_set, channel = _read_sensors(reader, 'fault_set', design), reader.text('channel')
    observer = filters.get(channel) or design.entries.get((fault_set, channel))
    if observer is None or isinstance(observer, Refusal) or observer.fault_set != fault_set:
        raise reader.fail('channel', f'{channel:.80} is no virtual sensor of its fault set, and '
                          'no filter')
    if observer.grade == 'bounded':
        raise reader.fail('channel', f'unknown inputs disturb the virtual sensor of {channel:.80}')
    support = _read_sensors(reader, 'support', design)
    made_of = {*observer.reads, *({channel} & set(design.sensors)),
               *(fault_set if observer.grade == 'temporary' else ())}
    if not support or not made_of.issuperset(support):
        raise reader.fail('support', 'is not of its channel and what its observer reads')
    given = reader.get('gains', list, 'a list of numbers')
    if len(given) != len(support):
        raise reader.fail('gains', f'is not {len(support)} numbers')
    gains = CheckedObject(reader.path, reader.place,
                          {f'gains[{i}]': gain for i, gain in enumerate(given)})
    return Residual(
        reader.text('name'), fault_set, channel, support,
        tuple(None if gain is None else gains.number(f'gains[{i}]')
              for i, gain in enumerate(given)),
        reader.size('noise'), reader.size('threshold'), reader.flag('assumed'))


def _read_plant(reader: CheckedObject, design: Contents) -> tuple[Distinction, ...]:
    found: dict[tuple[str, tuple[str, ...]], Distinction] = {}
    for item in reader.objects('plant'):
        item.only(('sensor', 'others', 'strength'))
        sensor, others = item.text('sensor'), _read_sensors(item, 'others', design)
        if sensor not in design.sensors or sensor in others:
            raise item.fail('sensor', f'{sensor:.80} is no sensor, or one of the others')
        read = Distinction(sensor, others, item.word('strength', STRENGTHS))
        if found.setdefault((sensor, others), read) is not read:
            raise item.fail('sensor', f'{sensor:.80} against the same stands there twice')
    return tuple(found.values())


def _read_sensors(reader: CheckedObject, key: str, design: Contents) -> tuple[str, ...]:
    names = reader.names(key)
    if names != tuple(s for s in design.sensors if s in names):
        raise reader.fail(key, 'is not sensors in their order')
    return names
