"""
The design file: JSON text that holds a design, and nothing else can be read from it.

This is its frame: the plant, what is wanted, the refusals. How a virtual sensor stands in it is
the business of its kind. The format is described in ``docs/design_file.md``.
"""

from __future__ import annotations

from dataclasses import asdict, replace
import json
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, check_text, reason
from vsensor_ros.functions.curve import Curve
from vsensor_ros.observers.checked_json import CheckedObject, MEND, read_json
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.entry import Entry, FAULT, Key, Refusal
from vsensor_ros.observers.fault_size_section import fault_sizes_record, read_fault_sizes
from vsensor_ros.observers.isolability_section import isolability_record, read_isolability
from vsensor_ros.observers.kinds import kind_named, kind_names
from vsensor_ros.text_file import looked_in
from vsensor_ros.whole_file import write_whole

FORMAT = 'vsensor_ros design'
VERSION = 4
OLDEST = 2  # has neither the optional key start nor Cu
FIRST_WITH_KINDS = 4  # before it all were functional


def write(design: Contents, path: str | Path) -> None:
    """Write a design; raises BadInput. See ``Design.save``."""
    for entry in design.each_once():
        _check_place(entry, design, path)
    try:
        text = json.dumps(_to_record(design), indent=1, default=np.generic.item) + '\n'
    except (TypeError, ValueError) as error:
        raise BadInput(path, 'design', f'cannot be written as JSON ({error})',
                       'make it of numbers and texts') from error
    _from_record(json.loads(text), path)
    try:
        write_whole(path, text)
    except (OSError, ValueError) as error:
        raise BadInput(path, 'design file',
                       f'cannot be written ({reason(error)}){looked_in(path)}',
                       'name a file in a folder that exists and is writable') from error


def _check_place(entry: Entry | Refusal, design: Contents, path: str | Path) -> None:
    """Raise BadInput unless an entry stands under its outputs, all of them, and can be written."""
    outputs = (entry.channel,) if isinstance(entry, Refusal) else entry.outputs
    own = {key for key, found in design.entries.items()
           if (found.fault_set, found.channel) == (entry.fault_set, entry.channel)}
    if own != {(entry.fault_set, output) for output in outputs}:
        raise BadInput(path, 'entries', f'{entry.channel} of {{{", ".join(entry.fault_set)}}} '
                       'does not stand under just its fault set and outputs',
                       'give it its own place')
    if not isinstance(entry, Refusal) and entry.kind not in kind_names():
        raise BadInput(path, 'kind', f'{entry.kind:.80} is not one of {", ".join(kind_names())}',
                       'register the kind')


def read(path: str | Path) -> Contents:
    """Read a design; raises BadInput. See ``Design.load``."""
    return _from_record(read_json(path), path)


def _to_record(design: Contents) -> dict[str, Any]:
    return {
        'format': FORMAT,
        'version': VERSION,
        'plant': {
            'name': design.plant_name,
            'hash': design.plant_hash,
            'sample_time': design.sample_time,
            'states': list(design.states),
            'inputs': list(design.inputs),
            'sensors': list(design.sensors),
            'units': dict(design.units),
            **({} if design.Cu is None else {'Cu': design.Cu.tolist()}),
            **({'tolerances': dict(design.tolerances)} if design.tolerances else {}),
            **({'ranges': {name: list(limits) for name, limits in design.ranges.items()}}
               if design.ranges else {}),
            **({'wrap': [dict(turns) for turns in design.wrap]} if design.wrap else {}),
            **({'curves': {name: _curve_record(curve) for name, curve in design.curves.items()}}
               if design.curves else {}),
            **({'delays': dict(design.delays)} if design.delays else {}),
            **({'noise': dict(design.noise)} if design.noise else {}),
        },
        'wanted': list(design.wanted),
        'entries': [entry_record(entry) for entry in design.each_once()],
        **({} if design.isolability is None
           else {'isolability': isolability_record(design.isolability)}),
        **({} if design.fault_sizes is None
           else {'fault_sizes': fault_sizes_record(design.fault_sizes)}),
    }


def entry_record(entry: Entry | Refusal) -> dict[str, Any]:
    """Write an entry as it stands in the design file."""
    if isinstance(entry, Refusal):
        return asdict(entry)
    return {'kind': entry.kind, 'channel': entry.channel, 'fault_set': list(entry.fault_set),
            **kind_named(entry.kind).write(entry)}


def _from_record(record: Any, path: str | Path) -> Contents:
    if not isinstance(record, dict) or record.get('format') != FORMAT:
        raise BadInput(path, 'format', f'is not {FORMAT!r}', 'name a file that the designer wrote')
    top = CheckedObject(path, '', record)
    version = top.get('version', int, 'a whole number')
    if not OLDEST <= version <= VERSION:
        mend = 'update vsensor_ros' if version > VERSION else MEND
        raise top.fail('version', f'is {str(version):.20}; this vsensor_ros reads {OLDEST} to '
                       f'{VERSION}', mend)
    top.only(('format', 'version', 'plant', 'wanted', 'entries', 'isolability', 'fault_sizes'))
    plant = top.object('plant')
    plant.only(('name', 'hash', 'sample_time', 'states', 'inputs', 'sensors', 'units', 'Cu',
                'tolerances', 'ranges', 'wrap', 'curves', 'delays', 'noise'))
    states, inputs, sensors = (plant.names(key) for key in ('states', 'inputs', 'sensors'))
    sample_time = None
    if plant.record.get('sample_time', 0) is not None:
        sample_time = plant.positive('sample_time')
    units = plant.get('units', dict, 'an object')
    for text in (*units, *units.values()):
        check_text(text, path, 'plant.units')
    wanted = _read_wanted(top, (*sensors, *inputs), sensors)
    Cu = plant.array('Cu', len(sensors), len(inputs)) if 'Cu' in plant.record else None
    entries: dict[Key, Entry | Refusal] = {}
    design = Contents(plant.text('name'), plant.text('hash'), states, inputs, sensors, units,
                      sample_time, entries, wanted, Cu,
                      _read_positive(plant, 'tolerances', sensors),
                      _read_ranges(plant, sensors), _read_wrap(plant, sensors),
                      _read_curves(plant, sensors, inputs),
                      _read_positive(plant, 'delays', (*sensors, *inputs)),
                      _read_positive(plant, 'noise', sensors))
    for reader in top.objects('entries'):
        entry = read_entry(reader, design, version)
        for output in (entry.channel,) if isinstance(entry, Refusal) else entry.outputs:
            if (entry.fault_set, output) in entries:
                raise reader.fail('channel', f'{output} stands there twice for this fault set')
            entries[entry.fault_set, output] = entry
    if 'isolability' in top.record:
        design = replace(design, isolability=read_isolability(
            top.object('isolability'), design, version))
    if 'fault_sizes' in top.record:
        design = replace(design, fault_sizes=read_fault_sizes(
            top.object('fault_sizes'), design, version))
    return design


def _read_wanted(top: CheckedObject, known: tuple[str, ...],
                 sensors: tuple[str, ...]) -> tuple[str, ...]:
    """Read names of functionals, and of faults of what is known."""
    faults = [FAULT + name for name in known]
    wanted = [name for name in top.get('wanted', list, 'a list of names') if name not in faults]
    for name in replace(top, record={'wanted': wanted}).names('wanted'):
        if name in sensors:
            raise top.fail('wanted', f'{name} is a sensor')
    found = tuple(top.record['wanted'])
    if len(set(found)) < len(found):
        raise top.fail('wanted', 'holds a name twice')
    return found


def _read_positive(plant: CheckedObject, key: str, names: tuple[str, ...]) -> dict[str, float]:
    reader = _by_name(plant, key, names)
    return {name: reader.positive(name) for name in reader.record}


def _read_ranges(plant: CheckedObject, sensors: tuple[str, ...]) -> dict[str, tuple[float, float]]:
    reader = _by_name(plant, 'ranges', sensors)
    ranges = {}
    for name in reader.record:
        low, high = reader.array(name, 2)
        if not low < high:
            raise reader.fail(name, 'is not [low, high] with low below high')
        ranges[name] = float(low), float(high)
    return ranges


def _read_wrap(plant: CheckedObject,
               sensors: tuple[str, ...]) -> tuple[dict[str, float], ...]:
    angles: list[dict[str, float]] = []
    for reader in plant.objects('wrap') if 'wrap' in plant.record else []:
        reader.only(sensors)
        turns = {name: reader.number(name) for name in reader.record}
        for name, turn in turns.items():
            if not turn:
                raise reader.fail(name, 'is no turn')
            if any(name in others for others in angles):
                raise reader.fail(name, 'stands there twice')
        angles.append(turns)
    return tuple(angles)


def _curve_record(curve: Curve) -> dict[str, Any]:
    if not curve.text:
        return {'offset': curve.offset}
    return {'function': curve.text, 'low': curve.low, 'high': curve.high,
            'beside': dict(curve.beside)}


def _read_curves(plant: CheckedObject, sensors: tuple[str, ...],
                 inputs: tuple[str, ...]) -> dict[str, Curve]:
    every = _by_name(plant, 'curves', sensors)
    curves = {}
    for name in every.record:
        reader = every.object(name)
        if 'offset' in reader.record:
            reader.only(('offset',))
            curves[name] = Curve(reader.number('offset'))
            continue
        reader.only(('function', 'low', 'high', 'beside'))
        beside = _by_name(reader, 'beside', inputs)
        curves[name] = Curve(0.0, reader.text('function'), reader.number('low'),
                             reader.number('high'), {u: beside.number(u) for u in beside.record})
        curves[name].check(plant.path, f'{every.place}{name}')
    return curves


def _by_name(plant: CheckedObject, key: str, names: tuple[str, ...]) -> CheckedObject:
    """Return an object whose keys are such names; an empty one where there is none."""
    if key not in plant.record:
        return CheckedObject(plant.path, f'{plant.place}{key}.', {})
    reader = plant.object(key)
    reader.only(names)
    return reader


def read_entry(reader: CheckedObject, design: Contents, version: int) -> Entry | Refusal:
    """Read an entry of a design file of some version; the plant is that of the design."""
    channel, fault_set = _read_key(reader, design)
    if 'reason' in reader.record:
        return _read_refusal(reader, channel, fault_set)
    return _read_virtual_sensor(reader, channel, fault_set, design, version)


def _read_key(reader: CheckedObject, design: Contents) -> tuple[str, tuple[str, ...]]:
    channel = reader.text('channel')
    fault_set = reader.names('fault_set')
    if not set(fault_set) <= set(design.sensors):
        raise reader.fail('fault_set', 'names a sensor that the plant does not have')
    if fault_set != tuple(name for name in design.sensors if name in fault_set):
        raise reader.fail('fault_set', 'is not in the order of the sensors')
    if channel not in (*fault_set, *design.wanted):
        raise reader.fail('channel', f'{channel:.80} is not in its fault set')
    return channel, fault_set


def _read_refusal(reader: CheckedObject, channel: str, fault_set: tuple[str, ...]) -> Refusal:
    reader.only(('channel', 'fault_set', 'reason', 'doubts', 'alternative'))
    return Refusal(channel, fault_set, reader.text('reason'), reader.texts('doubts'),
                   reader.text('alternative'))


def _read_virtual_sensor(reader: CheckedObject, channel: str, fault_set: tuple[str, ...],
                         design: Contents, version: int) -> Entry:
    name, own = 'functional', ['channel', 'fault_set']
    if version >= FIRST_WITH_KINDS:
        name = reader.word('kind', kind_names())
        own.append('kind')
    entry = kind_named(name).read(reader.without(own), channel, fault_set, design, version)
    known = {*fault_set, *design.wanted}
    if channel not in entry.outputs or not known.issuperset(entry.outputs):
        raise reader.fail('outputs', 'are not its channel and others of its fault set, or wanted')
    return entry
