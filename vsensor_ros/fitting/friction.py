"""
Structures of friction that are tried in the place that a plant file names.

    definitions:
      drag:
        value: viscous*speed + coulomb*sign(speed)
        friction: {speed: speed, most: 60, fastest: 0.2}

`friction` says that this definition is a friction force: against which state, how large it may
get, and how fast that (default: its range). Each structure takes the place of `value`, with
parameters of its own, which are called as the definition and what they are: drag_coulomb.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.fitting.held_out import crossed, Predicted
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.search import Progress, search
from vsensor_ros.fitting.windows import check_channels, cut, usual_horizon
from vsensor_ros.functions.expression import names, parse
from vsensor_ros.plant.free import FreePlant, frictions, load_free
from vsensor_ros.plant.plant_yaml import read_yaml
from vsensor_ros.recordings import Recording

# what opposes the speed v; {0}: the name of the definition
STRUCTURES = {
    'none': '0',
    'viscous': '{0}_viscous*v',
    'Coulomb': '{0}_viscous*v + {0}_coulomb*sign(v)',
    'asymmetric': '{0}_viscous*v - {0}_direction*abs(v) + {0}_coulomb*sign(v) + {0}_bias',
    'Stribeck': '{0}_viscous*v + {0}_static*sign(v) - {0}_drop*tanh(v/{0}_speed)'}
BETTER = 0.95  # of a simpler structure's held-out error: more parameters must be worth it
STEPS = 100  # of the simulation in a window: enough to compare


@dataclass(frozen=True, eq=False)
class Tried:
    """A structure: plant file content, how many parameters, and held-out errors."""

    name: str
    content: dict[str, Any]
    free: FreePlant
    values: np.ndarray
    held_out: Predicted
    size: float  # rms of held-out errors, in parts of how the sensors move


def variants(path: str | Path) -> dict[str, dict[str, Any]]:
    """Return the content of a plant file with each structure of friction; raise BadInput."""
    content = read_yaml(path)
    places = frictions(path)
    if not places:
        raise BadInput(path, 'definitions', 'none says that it is friction', 'write friction: '
                       '{speed: NAME, most: SIZE} beside the value of the one that is')
    return {name: _with(content, places, text) for name, text in STRUCTURES.items()}


def _with(content: dict[str, Any], places: dict[str, tuple[str, float, float]],
          text: str) -> dict[str, Any]:
    new = deepcopy(content)
    parameters = new.setdefault('parameters', {})
    for place, (speed, most, fast) in places.items():
        written = _for_speed(text.format(place), speed)
        entry = new['definitions'][place]
        old = set(names(parse(entry['value'])))
        entry['value'] = written
        used = set(names(parse(written)))
        for name in sorted(used - set(parameters) - {speed}):
            kind = name.removeprefix(f'{place}_')
            low, high = {'viscous': (0.0, most / fast), 'coulomb': (0.0, most),
                         'static': (0.0, most), 'drop': (0.0, most), 'bias': (-most, most),
                         'direction': (-most / fast, most / fast),
                         'speed': (fast / 200.0, fast / 2.0)}[kind]
            value = (0.0 if low < 0.0 else 0.1 * high if kind != 'speed' else fast / 20.0)
            parameters[name] = {'value': value, 'fit': [low, high]}
        _drop_unused(new, old - used)
    return new


def _for_speed(text: str, speed: str) -> str:
    """Return a structure with the speed's name for v, which stands alone in it."""
    return text.replace('(v', f'({speed}').replace('*v', f'*{speed}')


def _drop_unused(content: dict[str, Any], candidates: set[str]) -> None:
    """Leave out parameters that nothing but the old friction used."""
    texts = [str(part) for key in ('dynamics', 'sensors', 'definitions', 'parameters', 'inputs')
             for part in _leaves(content.get(key) or {})]
    left: set[str] = set()
    for text in texts:
        try:
            left |= set(names(parse(text)))
        except BadInput:  # a unit or a description
            continue
    for name in candidates - left:
        content['parameters'].pop(name, None)


def _leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for part in value.values() for leaf in _leaves(part)]
    if isinstance(value, list):
        return [leaf for part in value for leaf in _leaves(part)]
    return [value]


def tried(path: str | Path, runs: Sequence[Recording], horizon: float | None = None,
          progress: Progress = None) -> list[Tried]:
    """
    Fit each structure, and say how far off each is on parts that it was not fitted to.

    Each begins with what a simpler one found of the parameters that both have.

    Raises BadInput, one line.
    """
    found: list[Tried] = []
    contents, known = variants(path), dict[str, float]()
    for i, (name, content) in enumerate(contents.items()):
        if progress is not None:
            progress(i, len(contents), name)
        free = load_free(path, content)
        model = Model(free)
        check_channels(runs, model, path)
        windows = cut(runs, model, usual_horizon(runs, model) if horizon is None else horizon,
                      steps=STEPS)
        begun = np.array([known.get(f.name, f.value) for f in free.free])
        whole = search(model, windows, begun, tries=1)
        known.update(zip(model.parameters, whole.start.theta.tolist()))
        _, held = crossed(whole)
        moved = np.nanstd(windows.readings, axis=(0, 2))
        size = float(np.sqrt(np.nanmean((held.rms(held.plant) / moved)**2)))
        found.append(Tried(name, content, free, whole.start.theta, held, size))
    return found


def chosen(structures: Sequence[Tried]) -> Tried:
    """Return the best on what was held out; of those nearly as good the one before it."""
    least = min(t.size for t in structures)
    return next(t for t in structures if BETTER * t.size <= least)
