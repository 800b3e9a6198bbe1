"""
Read the plant file of a Takagi-Sugeno plant (YAML).

Keys: name, description, time, parameters, states, inputs, disturbances, sensors (measures) as in
any plant file; premises, {name: [low, high]}, with a membership in each submodel, or grid, {name:
[points]}, between which submodels are blended linearly; submodels, a list of A, B, D, offset and
membership. Of a grid they are listed with the last premise running fastest. States and inputs may
have a range; states and sensors a noise_bound: how large it is at most, of a step, of a reading.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import to_text
from vsensor_ros.plant.entries import Entries
from vsensor_ros.plant.plant_yaml import read_yaml
from vsensor_ros.plant.takagi_sugeno import grid_memberships, MOST_SUBMODELS, TakagiSugeno

_TOP = ('name', 'description', 'time', 'parameters', 'states', 'inputs', 'disturbances', 'sensors',
        'premises', 'grid', 'submodels')


def load_takagi_sugeno(path: str | Path) -> TakagiSugeno:
    """Read a plant file with submodels; raises BadInput, one line."""
    content = read_yaml(path)
    if isinstance(content, dict) and 'submodels' not in content:
        raise BadInput(path, 'submodels', 'are missing', 'give a plant file with submodels '
                       '(docs/scheduled.md); of dynamics from_equations makes some')
    file = Entries(path, _TOP, content)
    of_states = file.section('states', ('unit', 'range', 'noise_bound'))
    of_inputs = file.section('inputs', ('unit', 'range'))
    of_disturbances = file.section('disturbances', ('unit',))
    states, inputs, disturbances = map(tuple, (of_states, of_inputs, of_disturbances))
    sensors = file.section('sensors', ('measures', 'unit', 'noise_bound'), 'measures')
    for key, found in (('states', states), ('sensors', sensors)):
        if not found:
            raise file.fail(key, 'is missing or empty', f'name the {key}')
    file.read_parameters(file.section('parameters', ('value', 'unit'), 'value'))
    C = np.array([file.linear(file.required(entry, 'measures', f'sensors.{name}', 'name a state'),
                              f'sensors.{name}.measures', states)
                  for name, entry in sensors.items()])
    submodels = file.content.get('submodels')
    if not isinstance(submodels, list) or not 0 < len(submodels) <= MOST_SUBMODELS:
        raise file.fail('submodels', 'is no list of 1 to ' + str(MOST_SUBMODELS),
                        'write - {A: [[..]], B: [[..]], membership: ..}')
    if ('grid' in file.content) == ('premises' in file.content):
        raise file.fail('premises', 'must stand there, or grid, and not both',
                        'write premises: {name: [low, high]}')
    gridded = 'grid' in file.content
    key = 'grid' if gridded else 'premises'
    axes = {name: _numbers(file, value, f'{key}.{name}') for name, value in file.mapping(
        file.content[key], key, (*states, *inputs), 'state or input').items()}
    n, A, B, E, a, weights = len(states), [], [], [], [], []
    for i, item in enumerate(submodels):
        place = f'submodels[{i}]'
        entry = file.mapping(item, place, ('A', 'B', 'D', 'offset', *(
            () if gridded else ('membership',))))
        A.append(file.matrix(entry.get('A'), f'{place}.A', n, n))
        B.append(file.matrix(entry.get('B'), f'{place}.B', n, len(inputs)))
        E.append(file.matrix(entry.get('D'), f'{place}.D', n, len(disturbances)))
        a.append(file.matrix(entry.get('offset', [0.0] * n), f'{place}.offset', n, 1)[:, 0])
        if not gridded:
            weights.append(to_text(file.expression(file.required(
                entry, 'membership', place, 'write it over the premises'),
                f'{place}.membership', tuple(axes))))
    if gridded:
        weights = list(grid_memberships(axes, file.path))
        if len(weights) != len(A):
            raise file.fail('submodels', f'are {len(A)}', f'give {len(weights)}, one a point of '
                            'the grid, the last premise running fastest')
    for name, axis in axes.items():
        if not gridded and len(axis) != 2:
            raise file.fail(f'premises.{name}', f'are {len(axis)} numbers', 'write [low, high]')
    plant = TakagiSugeno.of_submodels(
        A, B, C, E=E, a=a, premises={name: [axis[0], axis[-1]] for name, axis in axes.items()},
        memberships=weights, states=states, inputs=inputs, disturbances=disturbances,
        sensors=tuple(sensors), sample_time=file.sample_time(),
        name=file.required(file.content, 'name', '', 'write name: my_plant'), where=file.path)
    return replace(
        plant, box=np.vstack([file.ranges('states', of_states), file.ranges('inputs', of_inputs)]),
        units={name: entry['unit'] for section in (of_states, of_inputs, of_disturbances, sensors)
               for name, entry in section.items() if entry.get('unit')},
        state_noise=_bounds(file, 'states', of_states),
        reading_noise=_bounds(file, 'sensors', sensors))


def _bounds(file: Entries, key: str, entries: Mapping[str, Mapping[str, Any]],
            ) -> np.ndarray | None:
    """Read how large noise is at most, None where nothing is said; each must say it, or none."""
    given = [file.deviation(entry, 'noise_bound', f'{key}.{name}')
             for name, entry in entries.items()]
    for name, value in zip(entries, given):
        if np.isnan(value) and not np.isnan(given).all():
            raise file.fail(f'{key}.{name}.noise_bound', 'is missing, while others say it',
                            'give how large its noise is at most, 0: none')
    return None if np.isnan(given).any() else np.array(given)


def _numbers(file: Entries, value: Any, key: str) -> list[float]:
    if not isinstance(value, list) or not 2 <= len(value) <= MOST_SUBMODELS:
        raise file.fail(key, 'is no list of two numbers or more', 'write [low, .., high]')
    return [file.number(one, key) for one in value]
