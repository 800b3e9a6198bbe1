"""What a plant is made of, checked: arrays, names and terms; one line says what is wrong."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
import difflib
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, check_text, shown
from vsensor_ros.functions.curve import Curve
from vsensor_ros.functions.expression import check_name, parse
from vsensor_ros.functions.nonlinearity import check_term, make_term, NonlinearTerm
from vsensor_ros.plant.plain_name import plain_name, short_names

LARGEST = 1e75    # of an entry: products of four must not overflow


def suggestion(name: object, known: Iterable[str]) -> str:
    """Return the end of an error line for an unknown name: the nearest, and all of them."""
    known = list(dict.fromkeys(known))
    near = difflib.get_close_matches(str(name), known, 1)
    return (f'did you mean {near[0]}? ' if near else '') + 'known: ' + (', '.join(known) or 'none')


def _array(value: Any, where: object, key: str, unknown: bool = False,
           infinite: bool = False) -> np.ndarray:
    # a frozen copy; unknown: NaN is allowed; infinite: so is infinity
    try:
        array = np.asarray(value)
        if array.dtype.kind not in 'biufO':    # texts, dates and complex numbers are none
            raise TypeError(array.dtype)
        array = np.array(array, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise BadInput(where, key, f'{shown(value)} is not a matrix of real numbers',
                       'give rows of equal length') from None
    if (np.isinf(array).any() and not infinite) or (np.isnan(array).any() and not unknown):
        raise BadInput(where, key, 'holds NaN or infinity', 'give finite numbers')
    if (abs(array[np.isfinite(array)]) > LARGEST).any():
        raise BadInput(where, key, f'holds a number beyond {LARGEST:g}', 'choose other units')
    array.flags.writeable = False
    return array


def checked_matrix(value: Any, where: object, key: str, row: bool = False) -> np.ndarray:
    """Return rows of finite numbers; row: a flat one is the only row."""
    array = _array(value, where, key)
    if row and array.ndim == 1:
        array = array[np.newaxis, :]
    if array.ndim != 2:
        raise BadInput(where, key, f'has {array.ndim} dimensions, not 2', 'give rows of numbers')
    return array


def checked_columns(value: Any, n: int, where: object, key: str) -> np.ndarray:
    """Return (n, ..): none when None, the only column when flat."""
    array = np.zeros((n, 0)) if value is None else _array(value, where, key)
    if array.size == 0:
        array = np.zeros((n, 0))
    if array.ndim == 1:
        array = array[:, np.newaxis]
    if array.ndim != 2 or len(array) != n:
        raise BadInput(where, key, f'has shape {array.shape}', f'give {n} rows, one a state')
    array.flags.writeable = False
    return array


def checked_vector(value: Any, default: np.ndarray, where: object, key: str,
                   unknown: bool = False) -> np.ndarray:
    """Return as many numbers as the default has, or the default; unknown: NaN is allowed."""
    array = _array(default if value is None else value, where, key, unknown)
    if array.shape != default.shape:
        raise BadInput(where, key, f'{shown(value)} does not fit', f'give {len(default)} numbers')
    return array


def checked_noise(value: Any, count: int, where: object, key: str = 'noise') -> np.ndarray:
    """Return (count,) standard deviations, NaN where unknown."""
    array = checked_vector(value, np.full(count, np.nan), where, key, unknown=True)
    if (array < 0.0).any():
        raise BadInput(where, key, f'{shown(value)} is negative somewhere',
                       f'give {count} standard deviations, NaN where unknown')
    return array


def checked_turns(value: Any, count: int, where: object) -> np.ndarray:
    """Return (count,), what a turn is in each reading, NaN where nothing wraps."""
    array = checked_vector(value, np.full(count, np.nan), where, 'wrap', unknown=True)
    if (array <= 0.0).any():
        raise BadInput(where, 'wrap', f'{shown(value)} is not above 0 somewhere', 'give what a '
                       'turn is in each reading, such as 2*pi or 360; NaN where nothing wraps')
    return array


def checked_direct(value: Any, height: int, width: int, where: object, key: str) -> np.ndarray:
    """Return (height, width), what sensors read directly; flat: of one sensor, or one column."""
    array = np.zeros((height, width)) if value is None else _array(value, where, key)
    if array.ndim == 1 and array.size == height * width and 1 in (height, width):
        array = array.reshape(height, width)
    if array.shape != (height, width):
        raise BadInput(where, key, f'has shape {array.shape}',
                       f'give one row of {width} numbers a sensor')
    array.flags.writeable = False
    return array


def checked_ranges(value: Any, n: int, where: object, key: str, each: str) -> np.ndarray:
    """Return (n, 2), low < high, infinite where unknown."""
    array = _array(np.tile([-np.inf, np.inf], (n, 1)) if value is None else value, where, key,
                   infinite=True)
    if array.shape != (n, 2):
        raise BadInput(where, key, f'has shape {array.shape}',
                       f'give {n} rows of low and high, one {each}')
    if not (array[:, 0] < array[:, 1]).all():
        raise BadInput(where, key, f'{shown(value)} has a low that is not below its high',
                       'give low < high, -inf and inf where unknown')
    return array


def checked_marks(names: Any, states: tuple[str, ...], where: object) -> np.ndarray:
    """Return (n,) bool: the states that are named."""
    chosen = as_list(names, where, 'slow')
    for name in chosen:
        if name not in states:
            raise BadInput(where, 'slow', f'unknown state {shown(name)}',
                           suggestion(name, states))
    marks = np.array([state in chosen for state in states])
    marks.flags.writeable = False
    return marks


def checked_tolerances(given: Mapping[str, float], sensors: tuple[str, ...],
                       where: object) -> dict[str, float]:
    """Return how far off an estimate may be, by sensor."""
    for name in given:
        if name not in sensors:
            raise BadInput(where, 'tolerances', f'unknown sensor {shown(name)}',
                           suggestion(name, sensors))
    sizes = checked_vector(list(given.values()), np.zeros(len(given)), where, 'tolerances')
    if not (sizes > 0.0).all():
        raise BadInput(where, 'tolerances', f'{shown(dict(given))} holds one that is not positive',
                       'give how far off an estimate may be')
    return dict(zip(given, sizes.tolist()))


def checked_curves(given: Mapping[str, Curve], sensors: tuple[str, ...],
                   where: object) -> dict[str, Curve]:
    """Return the curves by sensor."""
    for name, curve in given.items():
        if name not in sensors:
            raise BadInput(where, 'curves', f'unknown sensor {shown(name)}',
                           suggestion(name, sensors))
        if not isinstance(curve, Curve):
            raise BadInput(where, f'curves.{name}', f'{shown(curve)} is no Curve', 'give '
                           'Curve(offset), or Curve(text=.., low=.., high=..)')
        curve.check(where, f'curves.{name}')
    return dict(given)


def checked_spreads(given: Mapping[str, float], parameters: Mapping[str, float],
                    where: object) -> dict[str, float]:
    """Return standard deviations of parameters, by name."""
    for name in given:
        if name not in parameters:
            raise BadInput(where, 'spreads', f'unknown parameter {shown(name)}',
                           suggestion(name, parameters))
    sizes = checked_vector(list(given.values()), np.zeros(len(given)), where, 'spreads')
    if not (sizes > 0.0).all():
        raise BadInput(where, 'spreads', f'{shown(dict(given))} holds one that is not positive',
                       'give standard deviations')
    return dict(zip(given, sizes.tolist()))


def checked_equations(given: Sequence[str], names: Sequence[str],
                      definitions: Sequence[tuple[str, str]], n: int,
                      where: object) -> tuple[str, ...]:
    """Return the right-hand sides as texts over these names and definitions: n, or none."""
    for name, text in definitions:
        parse(text, where, f'definitions.{name}', known=names)
        names = (*names, name)
    texts = tuple(as_list(given, where, 'equations'))
    if len(texts) not in (0, n):
        raise BadInput(where, 'equations', f'are {len(texts)}', f'give {n}, one a state')
    for i, text in enumerate(texts):
        parse(text, where, f'equations[{i}]', known=names)
    return texts


def checked_delays(value: Any, count: int, sample_time: Any, where: object,
                   key: str) -> np.ndarray:
    """Return (count,) dead times [s], whole samples where there is a sample time."""
    array = checked_vector(value, np.zeros(count), where, key)
    if (array < 0.0).any():
        raise BadInput(where, key, f'{shown(value)} is negative somewhere', 'give times in s')
    if array.any() and sample_time is not None:
        steps = array / checked_sample_time(sample_time, where)
        if (abs(steps - np.rint(steps)) > 1e-6).any():
            raise BadInput(where, key, f'{shown(value)} is no whole number of samples',
                           f'give multiples of {sample_time:g} s')
    return array


def checked_rates(value: Any, count: int, where: object) -> np.ndarray:
    """Return (count,) readings a second, NaN where unknown."""
    array = checked_vector(value, np.full(count, np.nan), where, 'sensor_rate', unknown=True)
    if (array <= 0.0).any():
        raise BadInput(where, 'sensor_rate', f'{shown(value)} is not above 0 somewhere',
                       'give readings a second, NaN where unknown')
    return array


def checked_sample_time(value: Any, where: object) -> float | None:
    """Return seconds, or None for continuous time."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float, np.integer, np.floating)) \
            or not 0.0 < value <= LARGEST:
        raise BadInput(where, 'sample_time', f'{shown(value)} is not a positive number',
                       'give seconds, or None for continuous time')
    return float(value)


def checked_names(given: Sequence[str] | None, letter: str, count: int, where: object,
                  key: str) -> tuple[str, ...]:
    """Return one name each: those that are given, else the letter and a number."""
    if given is None:
        return tuple(f'{letter}{i + 1}' for i in range(count))
    names = tuple(as_list(given, where, key))
    if len(names) != count:
        raise BadInput(where, key, f'{len(names)} names for {count}', 'give one name each')
    for name in names:
        check_name(name, where, key)
    if len(set(names)) < count:
        twice = next(name for name in names if names.count(name) > 1)
        raise BadInput(where, key, f'{twice} is named twice', 'name each once')
    return names


def as_list(value: Any, where: object, key: str) -> list[Any]:
    """Return a list of what is given; a single text or term is a list of one."""
    try:
        return [value] if isinstance(value, (str, NonlinearTerm)) else list(value)
    except TypeError:
        raise BadInput(where, key, f'{shown(value)} is not a list', 'give a list') from None


def check_distinct(where: object, groups: Mapping[str, Sequence[str]]) -> None:
    """Raise BadInput when a name stands in two of the groups."""
    seen: dict[str, str] = {}
    for group, names in groups.items():
        for name in names:
            if name in seen:
                raise BadInput(where, group, f'{name} is also one of the {seen[name]}',
                               'rename one of them')
            seen[name] = group


def checked_terms(G: Any, nonlinearities: Sequence[str | NonlinearTerm] | None, p: np.ndarray,
                  states: tuple[str, ...], inputs: tuple[str, ...],
                  where: object) -> tuple[tuple[np.ndarray, ...], tuple[NonlinearTerm, ...]]:
    """Return the rows (r_i, n) of G and the terms, one each for a column of P (n, q)."""
    texts = [] if nonlinearities is None else as_list(nonlinearities, where, 'nonlinearities')
    given = [] if G is None else as_list(G, where, 'G')
    if len(texts) == 1 and given and not np.iterable(given[0]):
        given = [given]    # one flat row for the only term
    q = p.shape[1]
    if not len(texts) == len(given) == q:
        raise BadInput(where, 'nonlinearities', f'{len(texts)} nonlinearities, {len(given)} of '
                       f'G and {q} columns of P', 'give one of each a term')
    rows, terms = [], []
    for i, (text, g) in enumerate(zip(texts, given)):
        key = f'nonlinearities[{i}]'
        row = _array(g, where, f'G[{i}]')
        row = checked_matrix(row if row.size else np.zeros((0, len(states))), where, f'G[{i}]',
                             row=True)
        if row.shape[1] != len(states):
            raise BadInput(where, f'G[{i}]', f'has shape {row.shape}',
                           f'give rows of {len(states)} numbers')
        if isinstance(text, NonlinearTerm):
            check_text(text.name, where, key)
            checked_vector(text.slope, np.zeros(len(row)), where, f'{key}.slope')
            check_term(text, inputs, where, key)
            terms.append(text)
        else:
            bare = make_term(text, len(row), inputs, where, key)
            terms.append(NonlinearTerm(plain_name(parse(bare.text), row, states), bare.text,
                                       bare.slope))
        rows.append(row)
    return tuple(rows), short_names(terms, rows, states, inputs)
