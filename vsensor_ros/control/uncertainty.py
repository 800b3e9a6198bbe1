"""How far off the parameters of a plant may be, and the corners of that."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from math import isclose

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.plant import Plant
from vsensor_ros.plant.checked import suggestion

WHERE = 'uncertainty'
MOST_CORNERS = 512
SEED = 0  # of those that are looked at, where there are more
MEND = 'write 10% of all parameters, or mass=10%,length=5%'


def chosen(plant: Plant, uncertainty: str | float | Mapping[str, float]) -> dict[str, float]:
    """
    Return by how much of itself each parameter may be off; zeros and what follows are left out.

    uncertainty: '10%', 'mass=10%,length=5%', 0.1, or by name; an array stands for its elements. Of
    all parameters those do not count that are made of others. Raises BadInput.
    """
    if not plant.parameters or plant.remake is None:
        raise BadInput(WHERE, '', 'the plant has no named parameters that could be off',
                       'write its numbers under parameters in the plant file')
    if isinstance(uncertainty, str):
        uncertainty = _read(uncertainty)
    if not isinstance(uncertainty, Mapping):
        share = _share(uncertainty)
        free = _free(plant, share)
        if not free:
            raise BadInput(WHERE, '', 'all parameters of the plant are zero', MEND)
        return dict.fromkeys(free, share)
    found: dict[str, float] = {}
    for name, value in uncertainty.items():
        share = _share(value, str(name))
        names = [p for p in plant.parameters if p == name or p.startswith(f'{name}[')]
        if not names:
            raise BadInput(WHERE, '', f'unknown parameter {shown(name)}', suggestion(
                name, dict.fromkeys(p.split('[')[0] for p in plant.parameters)))
        found.update(dict.fromkeys((p for p in names if plant.parameters[p]), share))
    if not found:
        raise BadInput(WHERE, '', 'the parameters that it names are zero', MEND)
    return found


def _read(text: str) -> float | dict[str, float]:
    if '=' not in text:
        return _percent(text)
    shares: dict[str, float] = {}
    for part in text.split(','):
        name, equals, value = part.partition('=')
        name = name.strip()
        if not equals or not name:
            raise BadInput(WHERE, '', f'{shown(part)} is no name=share', MEND)
        if name in shares:
            raise BadInput(WHERE, '', f'{name} is named twice', 'name each once')
        shares[name] = _percent(value)
    return shares


def _percent(text: str) -> float:
    number = text.strip()
    part = 100.0 if number.endswith('%') else 1.0
    try:
        return float(number.removesuffix('%')) / part
    except ValueError:
        raise BadInput(WHERE, '', f'{shown(text)} is not a share', MEND) from None


def _share(value: object, name: str = '') -> float:
    of = f' of {name}' if name else ''
    if isinstance(value, str):
        value = _percent(value)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 < value < 1.0:
        raise BadInput(WHERE, '', f'{shown(value)}{of} is not between 0 and 1 (100%)', MEND)
    return float(value)


def _free(plant: Plant, share: float) -> list[str]:
    """Return the parameters that are not made of others, as their values tell."""
    made: set[str] = set()
    for name, value in plant.parameters.items():
        if value:
            moved = varied(plant, {name: 1.0 + share}).parameters
            made |= {other for other, was in plant.parameters.items()
                     if other != name and not isclose(moved[other], was, rel_tol=1e-12)}
    return [name for name, value in plant.parameters.items() if value and name not in made]


def corners(shares: Mapping[str, float]) -> list[dict[str, float]]:
    """Return factors by parameter at all corners; where these are too many, at some, at random."""
    count = len(shares)
    if 2**count <= MOST_CORNERS:
        signs = list(product((-1.0, 1.0), repeat=count))
    else:
        signs = np.random.default_rng(SEED).choice((-1.0, 1.0), (MOST_CORNERS, count)).tolist()
    return [{name: 1.0 + sign * share for (name, share), sign in zip(shares.items(), row)}
            for row in signs]


def varied(plant: Plant, factors: Mapping[str, float]) -> Plant:
    """Return the plant with its parameters times factors; raise BadInput where it is none."""
    assert plant.remake is not None
    at = ', '.join(f'{name} {100.0 * (factor - 1.0):+.3g} %' for name, factor in factors.items())
    try:
        made = plant.remake(factors)
    except BadInput as error:
        raise BadInput(error.where, error.key, f'with {at}: {error.problem}', 'choose less '
                       'uncertainty, or other parameters') from None
    if made.states != plant.states or made.sample_time != plant.sample_time:
        raise BadInput(WHERE, '', f'with {at} the plant has another sample time, or other states',
                       'leave out the parameters that times are made of')
    return made
