"""
The bridge between the designer and the replacer: virtual sensors, and the file that holds them.

Letters are those of the method: order k, l0 healthy sensors, m inputs, q nonlinear terms. The
format of the file is described in ``docs/design_file.md``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
import json
import os
from pathlib import Path
import secrets
import shutil
from typing import Any, NoReturn

import numpy as np

from vsensor_ros.bad_input import BadInput, check_text, reason
from vsensor_ros.expression import check_name
from vsensor_ros.nonlinearity import check_term, NonlinearTerm

FORMAT = 'vsensor_ros design'
VERSION = 1
LARGEST_FILE = 64 * 2**20
LARGEST_SIDE = 10_000  # rows or columns of one matrix; keeps a forged file from eating the memory


@dataclass(frozen=True, eq=False)
class VirtualSensor:
    """
    A functional observer that says what a failed sensor would have said.

    ``d z = N z + J y0 + B u + sum_i P[:, i] psi_i(Gz_i z + Gy_i y0, u)``,
    ``vhat = Cv z + Q y0``, where d is the derivative or, with a sample time, the next value.
    ``B`` and ``P`` are already multiplied by Phi. Source: equations (E1) to (E4) of the method.
    """

    channel: str  # the sensor it stands in for
    fault_set: tuple[str, ...]  # the sensors that have failed, in the plant's order
    healthy: tuple[str, ...]  # y0: what the columns of J, Q and Gy stand for
    inputs: tuple[str, ...]  # u: what the columns of B stand for
    Phi: np.ndarray  # (k, n), z = Phi x when converged
    N: np.ndarray  # (k, k)
    J: np.ndarray  # (k, l0)
    B: np.ndarray  # (k, m)
    P: np.ndarray  # (k, q)
    Cv: np.ndarray  # (1, k)
    Q: np.ndarray  # (1, l0)
    Gz: tuple[np.ndarray, ...]  # q arrays (r_i, k)
    Gy: tuple[np.ndarray, ...]  # q arrays (r_i, l0)
    terms: tuple[NonlinearTerm, ...]  # q
    sample_time: float | None  # s; None: continuous
    z0: np.ndarray  # (k,); the start is z = z0 + z0_gain y0
    z0_gain: np.ndarray  # (k, l0)
    eigenvalues: np.ndarray  # (k,) complex, of N
    noise_gain: float  # peak over frequency of |Cv (s - N)^-1 J + Q|
    method: str  # how it was found

    def __post_init__(self) -> None:
        # a fresh one and a loaded one are alike: not to be written to
        for value in vars(self).values():
            for array in value if isinstance(value, tuple) else (value,):
                if isinstance(array, np.ndarray):
                    array.flags.writeable = False

    @property
    def order(self) -> int:
        """Number of states."""
        return self.N.shape[0]

    @property
    def active(self) -> tuple[int, ...]:
        """Indices of the nonlinear terms that enter the observer."""
        return tuple(int(i) for i in np.flatnonzero(self.P.any(axis=0)))

    @property
    def reads(self) -> tuple[str, ...]:
        """Names of the healthy sensors whose readings it needs."""
        used = np.vstack([self.J, self.Q, *(self.Gy[i] for i in self.active)]).any(axis=0)
        return tuple(self.healthy[i] for i in np.flatnonzero(used))


@dataclass(frozen=True)
class Refusal:
    """Why a channel cannot be replaced when a set of sensors has failed."""

    channel: str
    fault_set: tuple[str, ...]
    reason: str  # one sentence, in the user's names


@dataclass(frozen=True, eq=False)
class Design:
    """All virtual sensors of one plant, by fault set and channel."""

    plant_name: str
    plant_hash: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    units: dict[str, str]
    sample_time: float | None
    entries: dict[tuple[tuple[str, ...], str], VirtualSensor | Refusal]

    def __getitem__(self, key: tuple[Iterable[str], str]) -> VirtualSensor | Refusal:
        """Look up ``design[fault_set, channel]``; raise KeyError when it was not designed."""
        try:
            fault_set, channel = key if isinstance(key, tuple) else ()
            names = {fault_set} if isinstance(fault_set, str) else set(fault_set)
            unknown = sorted(map(str, (names | {channel}) - set(self.sensors)))
        except (TypeError, ValueError):
            raise KeyError(f'{key!r:.80}: is not a fault set and a channel; write '
                           "design[('y1', 'y2'), 'y1']") from None
        if unknown:
            raise KeyError(f'{", ".join(unknown)}: no such sensor; there are '
                           f'{", ".join(self.sensors)}')
        ordered = tuple(name for name in self.sensors if name in names)
        try:
            return self.entries[ordered, channel]
        except KeyError:
            designed = ', '.join('{' + ', '.join(s) + '}' for s in self.fault_sets)
            raise KeyError(f'channel {channel} of fault set {{{", ".join(ordered)}}} was not '
                           f'designed; the fault sets are {designed}') from None

    @property
    def fault_sets(self) -> tuple[tuple[str, ...], ...]:
        """The sets of failed sensors that were designed for."""
        return tuple(dict.fromkeys(fault_set for fault_set, _ in self.entries))

    @property
    def virtual_sensors(self) -> tuple[VirtualSensor, ...]:
        """All virtual sensors, without the refusals."""
        return tuple(e for e in self.entries.values() if isinstance(e, VirtualSensor))

    @property
    def refusals(self) -> tuple[Refusal, ...]:
        """All refusals."""
        return tuple(e for e in self.entries.values() if isinstance(e, Refusal))

    def save(self, path: str | Path) -> None:
        """
        Write the design file; the old file stays whole until the new one is complete.

        A link stays a link, a pipe or a device is written into. Raises BadInput when the file
        cannot be written, or when it would not be loaded.
        """
        try:
            text = json.dumps(_to_record(self), indent=1) + '\n'
        except (TypeError, ValueError) as error:
            raise BadInput(path, 'design', f'cannot be written as JSON ({error})',
                           'make it of numbers and texts') from error
        _from_record(json.loads(text), path)
        try:
            if os.path.exists(path) and not os.path.isfile(path):
                Path(path).write_text(text, encoding='utf-8')
                return
            target = Path(os.path.realpath(path))
            beside = target.with_name(f'.design.{secrets.token_hex(8)}')
            try:
                with open(beside, 'x', encoding='utf-8') as file:
                    file.write(text)
                if target.exists():
                    shutil.copymode(target, beside)
                os.replace(beside, target)
            finally:
                beside.unlink(missing_ok=True)
        except (OSError, ValueError) as error:
            raise BadInput(path, 'design file', f'cannot be written ({reason(error)})',
                           'name a file in a folder that exists and is writable') from error

    @classmethod
    def load(cls, path: str | Path) -> Design:
        """
        Read a design file without executing anything in it.

        Raises BadInput, one line, when the file is missing, malformed, of a newer version, not
        finite, inconsistent in its shapes or unstable.
        """
        return _from_record(_read_json(path), path)


def is_stable(eigenvalues: np.ndarray, sample_time: float | None) -> bool:
    """Tell whether a linear error with these eigenvalues dies out."""
    if sample_time is None:
        return bool(np.all(eigenvalues.real < 0.0))
    return bool(np.all(np.abs(eigenvalues) < 1.0))


# ---------------------------------------------------------------------------------- the file

_MEND = 'write the file anew with the designer'


def _to_record(design: Design) -> dict[str, Any]:
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
        },
        'entries': [_entry_record(entry) for entry in design.entries.values()],
    }


def _entry_record(v: VirtualSensor | Refusal) -> dict[str, Any]:
    if isinstance(v, Refusal):
        return {'channel': v.channel, 'fault_set': list(v.fault_set), 'reason': v.reason}
    return {
        'channel': v.channel,
        'fault_set': list(v.fault_set),
        'healthy': list(v.healthy),
        'order': v.order,
        'method': v.method,
        'noise_gain': v.noise_gain,
        'eigenvalues': [[float(e.real), float(e.imag)] for e in v.eigenvalues],
        **{key: getattr(v, key).tolist()
           for key in ('Phi', 'N', 'J', 'B', 'P', 'Cv', 'Q', 'z0', 'z0_gain')},
        'terms': [{'name': t.name, 'function': t.text, 'slope': t.slope.tolist(),
                   'Gz': gz.tolist(), 'Gy': gy.tolist()}
                  for t, gz, gy in zip(v.terms, v.Gz, v.Gy)],
    }


def _read_json(path: str | Path) -> Any:
    def no_constant(name: str) -> NoReturn:
        raise BadInput(path, name, 'is not a finite number', _MEND)

    def no_repeat(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        record = dict(pairs)
        if len(record) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise BadInput(path, twice, 'stands there twice', _MEND)
        return record

    try:
        with open(path, 'rb') as file:
            data = file.read(LARGEST_FILE + 1)
    except (OSError, ValueError) as error:
        raise BadInput(path, 'design file', f'cannot be read ({reason(error)})',
                       'name a file that the designer wrote') from error
    if len(data) > LARGEST_FILE:
        raise BadInput(path, 'design file', f'is larger than {LARGEST_FILE // 2**20} MiB', _MEND)
    try:
        return json.loads(data.decode('utf-8'), parse_constant=no_constant,
                          object_pairs_hook=no_repeat)
    except UnicodeDecodeError as error:
        raise BadInput(path, 'design file', 'is not a text file', _MEND) from error
    except json.JSONDecodeError as error:
        raise BadInput(path, f'line {error.lineno}', f'is not JSON ({error.msg})',
                       _MEND) from error
    except (RecursionError, ValueError) as error:  # ValueError: an integer of 5000 digits
        if isinstance(error, BadInput):
            raise
        raise BadInput(path, 'design file', 'is nested or written beyond reason',
                       _MEND) from error


@dataclass(frozen=True)
class _Reader:
    """One JSON object being checked, and where it stands in the file."""

    path: str | Path
    place: str
    record: dict[str, Any]

    def fail(self, key: str, problem: str, mend: str = _MEND) -> BadInput:
        return BadInput(self.path, f'{self.place}{key}', problem, mend)

    def only(self, keys: Iterable[str]) -> None:
        for key in self.record:
            if key not in keys:
                raise self.fail(key[:80], 'is not a key of the design file')

    def get(self, key: str, kind: type | tuple[type, ...], what: str) -> Any:
        if key not in self.record:
            raise self.fail(key, 'is missing')
        value = self.record[key]
        if not isinstance(value, kind) or isinstance(value, bool):
            raise self.fail(key, f'must be {what}')
        return value

    def text(self, key: str) -> str:
        return check_text(self.get(key, str, 'a text'), self.path, f'{self.place}{key}')

    def number(self, key: str) -> float:
        value = _as_float(self.get(key, (int, float), 'a number'))
        if not np.isfinite(value):
            raise self.fail(key, 'is not finite')
        return value

    def names(self, key: str) -> tuple[str, ...]:
        value = self.get(key, list, 'a list of names')
        if len(value) > LARGEST_SIDE:
            raise self.fail(key, f'has more than {LARGEST_SIDE} names')
        for name in value:
            check_name(name, self.path, f'{self.place}{key}')
        if len(set(value)) < len(value):
            raise self.fail(key, 'holds a name twice')
        return tuple(value)

    def array(self, key: str, *shape: int) -> np.ndarray:
        """Read nested lists as a float array of just this shape."""
        value = self.get(key, list, 'a list of numbers')
        if not _has_shape(value, shape):
            size = ' x '.join(str(side) for side in shape)
            raise self.fail(key, f'is not {size} numbers')
        array = np.array(value, dtype=float).reshape(shape)
        if not np.all(np.isfinite(array)):
            raise self.fail(key, 'is not finite')
        return array

    def objects(self, key: str) -> list[_Reader]:
        value = self.get(key, list, 'a list')
        readers = []
        for i, item in enumerate(value):
            if not isinstance(item, dict):
                raise self.fail(f'{key}[{i}]', 'must be an object')
            readers.append(_Reader(self.path, f'{self.place}{key}[{i}].', item))
        return readers


def _as_float(value: int | float) -> float:
    """Convert a JSON number, however long, to a float (infinite when too large)."""
    try:
        return float(value)
    except OverflowError:
        return float('inf')


def _has_shape(value: Any, shape: tuple[int, ...]) -> bool:
    if not shape:
        return isinstance(value, (int, float)) and not isinstance(value, bool) \
            and np.isfinite(_as_float(value))
    return isinstance(value, list) and len(value) == shape[0] and (
        all(_has_shape(item, shape[1:]) for item in value))


def _from_record(record: Any, path: str | Path) -> Design:
    if not isinstance(record, dict) or record.get('format') != FORMAT:
        raise BadInput(path, 'format', f'is not {FORMAT!r}', 'name a file that the designer wrote')
    top = _Reader(path, '', record)
    version = top.get('version', int, 'a whole number')
    if version != VERSION:
        mend = 'update vsensor_ros' if version > VERSION else _MEND
        raise top.fail('version', f'is {str(version):.20}; this vsensor_ros reads {VERSION}', mend)
    top.only(('format', 'version', 'plant', 'entries'))
    plant = _Reader(path, 'plant.', top.get('plant', dict, 'an object'))
    plant.only(('name', 'hash', 'sample_time', 'states', 'inputs', 'sensors', 'units'))
    states, inputs, sensors = (plant.names(key) for key in ('states', 'inputs', 'sensors'))
    sample_time = None
    if plant.record.get('sample_time', 0) is not None:
        sample_time = plant.number('sample_time')
        if sample_time <= 0:
            raise plant.fail('sample_time', 'must be positive')
    units = plant.get('units', dict, 'an object')
    for text in (*units, *units.values()):
        check_text(text, path, 'plant.units')
    design = Design(
        plant.text('name'), plant.text('hash'), states, inputs, sensors, units, sample_time, {})
    for reader in top.objects('entries'):
        entry = _read_refusal(reader, sensors) if 'reason' in reader.record else (
            _read_sensor(reader, design))
        key = (entry.fault_set, entry.channel)
        if key in design.entries:
            raise reader.fail('channel', f'{key[1]} stands there twice for this fault set')
        design.entries[key] = entry
    return design


def _read_refusal(reader: _Reader, sensors: tuple[str, ...]) -> Refusal:
    reader.only(('channel', 'fault_set', 'reason'))
    channel, fault_set = _read_key(reader, sensors)
    return Refusal(channel, fault_set, reader.text('reason'))


def _read_key(reader: _Reader, sensors: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    channel = reader.text('channel')
    fault_set = reader.names('fault_set')
    if not set(fault_set) <= set(sensors):
        raise reader.fail('fault_set', 'names a sensor that the plant does not have')
    if fault_set != tuple(name for name in sensors if name in fault_set):
        raise reader.fail('fault_set', 'is not in the order of the sensors')
    if channel not in fault_set:
        raise reader.fail('channel', f'{channel:.80} is not in its fault set')
    return channel, fault_set


_SENSOR_KEYS = frozenset((
    'channel', 'fault_set', 'healthy', 'order', 'method', 'noise_gain', 'eigenvalues', 'Phi', 'N',
    'J', 'B', 'P', 'Cv', 'Q', 'z0', 'z0_gain', 'terms'))


def _read_sensor(reader: _Reader, design: Design) -> VirtualSensor:
    reader.only(_SENSOR_KEYS)
    channel, fault_set = _read_key(reader, design.sensors)
    healthy = reader.names('healthy')
    if healthy != tuple(s for s in design.sensors if s not in fault_set):
        raise reader.fail('healthy', 'is not the sensors without the fault set')
    k = reader.get('order', int, 'a whole number')
    if not 0 <= k <= LARGEST_SIDE:
        raise reader.fail('order', f'must lie in 0..{LARGEST_SIDE}')
    n, l0, m = len(design.states), len(healthy), len(design.inputs)
    N = reader.array('N', k, k)
    eigenvalues = np.linalg.eigvals(N).astype(complex)
    if not is_stable(eigenvalues, design.sample_time):
        raise reader.fail('N', f'is unstable (eigenvalue {_worst(eigenvalues, design):.6g})')
    stored = reader.array('eigenvalues', k, 2)
    if not _same_spectrum(stored[:, 0] + 1j * stored[:, 1], eigenvalues, N):
        raise reader.fail('eigenvalues', 'are not those of N')
    terms, Gz, Gy = [], [], []
    for item in reader.objects('terms'):
        item.only(('name', 'function', 'slope', 'Gz', 'Gy'))
        r = len(item.get('slope', list, 'a list of numbers'))
        term = NonlinearTerm(item.text('name'), item.text('function'), item.array('slope', r))
        check_term(term, design.inputs, reader.path, f'{item.place}function')
        terms.append(term)
        Gz.append(item.array('Gz', r, k))
        Gy.append(item.array('Gy', r, l0))
    noise_gain = reader.number('noise_gain')
    if noise_gain < 0:
        raise reader.fail('noise_gain', 'must not be negative')
    return VirtualSensor(
        channel, fault_set, healthy, design.inputs, reader.array('Phi', k, n), N,
        reader.array('J', k, l0), reader.array('B', k, m), reader.array('P', k, len(terms)),
        reader.array('Cv', 1, k), reader.array('Q', 1, l0), tuple(Gz), tuple(Gy), tuple(terms),
        design.sample_time, reader.array('z0', k), reader.array('z0_gain', k, l0),
        stored[:, 0] + 1j * stored[:, 1], noise_gain, reader.text('method'))


def _worst(eigenvalues: np.ndarray, design: Design) -> complex:
    size = eigenvalues.real if design.sample_time is None else np.abs(eigenvalues)
    return complex(eigenvalues[int(np.argmax(size))])


def _same_spectrum(stored: np.ndarray, computed: np.ndarray, N: np.ndarray) -> bool:
    """
    Compare two spectra through sum and sum of squares.

    The eigenvalues of a matrix that is nearly defective depend on the machine in their last
    digits by far more than rounding; their power sums do not, down to the rounding of N itself.
    """
    tiny = np.finfo(float).tiny
    scale = max(np.abs(computed).max(initial=tiny), 1e-4 * np.abs(N).max(initial=0.0))
    with np.errstate(all='ignore'):  # what overflows compares as different
        return bool(np.isfinite(scale)) and all(
            abs(np.sum((stored / scale)**p) - np.sum((computed / scale)**p)) <= 1e-6 * len(N)
            for p in (1, 2))
