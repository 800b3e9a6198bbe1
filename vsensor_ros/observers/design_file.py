"""
The design file: JSON text that holds a design, and nothing else can be read from it.

The format is described in ``docs/design_file.md``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass
import json
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from vsensor_ros.bad_input import BadInput, check_text, reason
from vsensor_ros.functions.expression import check_name
from vsensor_ros.functions.nonlinearity import check_term, NonlinearTerm
from vsensor_ros.observers.kinds.functional.virtual_sensor import (
    Certificate,
    Design,
    is_stable,
    Noise,
    OrderStep,
    Proof,
    Refusal,
    Rung,
    VirtualSensor,
)
from vsensor_ros.whole_file import write_whole

FORMAT = 'vsensor_ros design'
VERSION = 3
OLDEST = 2  # has neither the optional key start nor Cu
LARGEST_FILE = 64 * 2**20
LARGEST_SIDE = 10_000  # rows or columns of one matrix; keeps a forged file from eating the memory
_MEND = 'write the file anew with the designer'
_INF = float('inf')


def write(design: Design, path: str | Path) -> None:
    """Write a design; raises BadInput. See ``Design.save``."""
    try:
        text = json.dumps(_to_record(design), indent=1, default=np.generic.item) + '\n'
    except (TypeError, ValueError) as error:
        raise BadInput(path, 'design', f'cannot be written as JSON ({error})',
                       'make it of numbers and texts') from error
    _from_record(json.loads(text), path)
    try:
        write_whole(path, text)
    except (OSError, ValueError) as error:
        raise BadInput(path, 'design file', f'cannot be written ({reason(error)})',
                       'name a file in a folder that exists and is writable') from error


def read(path: str | Path) -> Design:
    """Read a design; raises BadInput. See ``Design.load``."""
    return _from_record(_read_json(path), path)


# ---------------------------------------------------------------------------------- to JSON

_ARRAYS = ('Phi', 'N', 'J', 'B', 'P', 'Cv', 'Q', 'Qu', 'z0', 'z0_gain')


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
            **({} if design.Cu is None else {'Cu': design.Cu.tolist()}),
        },
        'wanted': list(design.wanted),
        'entries': [_entry_record(entry) for entry in design.entries.values()],
    }


def _entry_record(v: VirtualSensor | Refusal) -> dict[str, Any]:
    if isinstance(v, Refusal):
        return asdict(v)
    return {
        'channel': v.channel,
        'fault_set': list(v.fault_set),
        'healthy': list(v.healthy),
        'order': v.order,
        'method': v.method,
        'grade': v.grade,
        'noise_gain': v.noise_gain,
        'disturbance_gain': v.disturbance_gain,
        'eigenvalues': [[float(e.real), float(e.imag)] for e in v.eigenvalues],
        **{key: getattr(v, key).tolist() for key in _ARRAYS},
        'terms': [{'name': t.name, 'function': t.text, 'slope': t.slope.tolist(),
                   'Gz': gz.tolist(), 'Gy': gy.tolist(), 'Gu': gu.tolist()}
                  for t, gz, gy, gu in zip(v.terms, v.Gz, v.Gy, v.Gu)],
        'proof': None if v.proof is None else {
            **asdict(v.proof),
            'steps': [{**asdict(s), 'gap': [s.gap[0], _null(s.gap[1])]} for s in v.proof.steps]},
        'ladder': [{**asdict(rung), 'decay': _null(rung.decay)} for rung in v.ladder],
        'noise': None if v.noise is None else {**asdict(v.noise), 'floor': _null(v.noise.floor)},
        'certificate': None if v.certificate is None else _certificate_record(v.certificate),
        **({} if v.start is None else {'start': v.start.tolist()}),
    }


def _certificate_record(c: Certificate) -> dict[str, Any]:
    return {
        'status': c.status,
        'rate': _null(c.rate),
        'bound': _null(c.bound),
        'S': c.S.tolist(),
        'region': [{'name': name, 'low': _null(low, -_INF), 'high': _null(high)}
                   for name, low, high in c.region],
        'lipschitz': None if c.lipschitz is None else [_null(side) for side in c.lipschitz],
        'reason': c.reason,
    }


def _null(value: float, infinite: float = _INF) -> float | None:
    """Write the infinity that a number may be as null; JSON has none."""
    return None if value == infinite else value


# -------------------------------------------------------------------------------- from JSON

def _read_json(path: str | Path) -> Any:
    def no_constant(name: str) -> NoReturn:
        raise BadInput(path, name, 'is not a finite number', _MEND)

    def no_repeat(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        record = dict(pairs)
        if len(record) < len(pairs):
            counts = Counter(key for key, _ in pairs)
            twice = next(key for key, count in counts.items() if count > 1)
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

    def limit(self, key: str, infinite: float) -> float:
        """Read a number that may be infinite: null."""
        return infinite if self.record.get(key, 0.0) is None else self.number(key)

    def size(self, key: str, infinite: bool = False) -> float:
        """Read a number that is not negative, and infinite only where it may be: null."""
        value = self.limit(key, _INF) if infinite else self.number(key)
        if value < 0.0:
            raise self.fail(key, 'must not be negative')
        return value

    def pair(self, key: str, infinite: tuple[bool, bool]) -> tuple[float, float]:
        """Read two numbers as `size` does; infinite: which of them may be so."""
        value = self.get(key, list, 'a list of two numbers')
        if len(value) != 2:
            raise self.fail(key, 'is not 2 numbers')
        items = _Reader(self.path, self.place, {f'{key}[{i}]': v for i, v in enumerate(value)})
        first, second = (items.size(f'{key}[{i}]', infinite[i]) for i in range(2))
        return first, second

    def whole(self, key: str) -> int:
        value = self.get(key, int, 'a whole number')
        if not 0 <= value <= LARGEST_SIDE:
            raise self.fail(key, f'must lie in 0..{LARGEST_SIDE}')
        return value

    def flag(self, key: str) -> bool:
        if not isinstance(self.record.get(key), bool):
            raise self.fail(key, 'must be true or false' if key in self.record else 'is missing')
        return self.record[key]

    def word(self, key: str, known: tuple[str, ...]) -> str:
        value = self.text(key)
        if value not in known:
            raise self.fail(key, f'{value:.80} is not one of {", ".join(known)}')
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        value = self.get(key, list, 'a list of texts')
        return tuple(check_text(text, self.path, f'{self.place}{key}') for text in value)

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

    def object(self, key: str) -> _Reader:
        return _Reader(self.path, f'{self.place}{key}.', self.get(key, dict, 'an object'))

    def optional(self, key: str) -> _Reader | None:
        """Read an object, or null."""
        return None if self.record.get(key, 0) is None else self.object(key)

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
    if not OLDEST <= version <= VERSION:
        mend = 'update vsensor_ros' if version > VERSION else _MEND
        raise top.fail('version', f'is {str(version):.20}; this vsensor_ros reads {OLDEST} to '
                       f'{VERSION}', mend)
    top.only(('format', 'version', 'plant', 'wanted', 'entries'))
    plant = top.object('plant')
    plant.only(('name', 'hash', 'sample_time', 'states', 'inputs', 'sensors', 'units', 'Cu'))
    states, inputs, sensors = (plant.names(key) for key in ('states', 'inputs', 'sensors'))
    sample_time = None
    if plant.record.get('sample_time', 0) is not None:
        sample_time = plant.number('sample_time')
        if sample_time <= 0:
            raise plant.fail('sample_time', 'must be positive')
    units = plant.get('units', dict, 'an object')
    for text in (*units, *units.values()):
        check_text(text, path, 'plant.units')
    wanted = top.names('wanted')
    for name in wanted:
        if name in sensors:
            raise top.fail('wanted', f'{name} is a sensor')
    Cu = plant.array('Cu', len(sensors), len(inputs)) if 'Cu' in plant.record else None
    design = Design(plant.text('name'), plant.text('hash'), states, inputs, sensors, units,
                    sample_time, {}, wanted, Cu)
    for reader in top.objects('entries'):
        entry = _read_refusal(reader, design) if 'reason' in reader.record else (
            _read_sensor(reader, design))
        key = (entry.fault_set, entry.channel)
        if key in design.entries:
            raise reader.fail('channel', f'{key[1]} stands there twice for this fault set')
        design.entries[key] = entry
    return design


def _read_refusal(reader: _Reader, design: Design) -> Refusal:
    reader.only(('channel', 'fault_set', 'reason', 'doubts', 'alternative'))
    channel, fault_set = _read_key(reader, design)
    return Refusal(channel, fault_set, reader.text('reason'), reader.texts('doubts'),
                   reader.text('alternative'))


def _read_key(reader: _Reader, design: Design) -> tuple[str, tuple[str, ...]]:
    channel = reader.text('channel')
    fault_set = reader.names('fault_set')
    if not set(fault_set) <= set(design.sensors):
        raise reader.fail('fault_set', 'names a sensor that the plant does not have')
    if fault_set != tuple(name for name in design.sensors if name in fault_set):
        raise reader.fail('fault_set', 'is not in the order of the sensors')
    if channel not in (*fault_set, *design.wanted):
        raise reader.fail('channel', f'{channel:.80} is not in its fault set')
    return channel, fault_set


_SENSOR_KEYS = frozenset((
    'channel', 'fault_set', 'healthy', 'order', 'method', 'grade', 'noise_gain',
    'disturbance_gain', 'eigenvalues', 'terms', 'proof', 'ladder', 'noise', 'certificate',
    'start', *_ARRAYS))


def _read_sensor(reader: _Reader, design: Design) -> VirtualSensor:
    reader.only(_SENSOR_KEYS)
    channel, fault_set = _read_key(reader, design)
    healthy = reader.names('healthy')
    if healthy != tuple(s for s in design.sensors if s not in fault_set):
        raise reader.fail('healthy', 'is not the sensors without the fault set')
    k = reader.whole('order')
    n, l0, m = len(design.states), len(healthy), len(design.inputs)
    # a sensor's channel is one number, a wanted functional may be several
    p = len(reader.get('Cv', list, 'a list of rows')) if channel in design.wanted else 1
    if not 1 <= p <= LARGEST_SIDE:
        raise reader.fail('Cv', f'must have 1 to {LARGEST_SIDE} rows')
    N = reader.array('N', k, k)
    eigenvalues = np.linalg.eigvals(N).astype(complex)
    if not is_stable(eigenvalues, design.sample_time):
        raise reader.fail('N', f'is unstable (eigenvalue {_worst(eigenvalues, design):.6g})')
    stored = reader.array('eigenvalues', k, 2)
    if not _same_spectrum(stored[:, 0] + 1j * stored[:, 1], eigenvalues, N):
        raise reader.fail('eigenvalues', 'are not those of N')
    terms, Gz, Gy, Gu = [], [], [], []
    for item in reader.objects('terms'):
        item.only(('name', 'function', 'slope', 'Gz', 'Gy', 'Gu'))
        r = len(item.get('slope', list, 'a list of numbers'))
        term = NonlinearTerm(item.text('name'), item.text('function'), item.array('slope', r))
        check_term(term, design.inputs, reader.path, f'{item.place}function')
        terms.append(term)
        Gz.append(item.array('Gz', r, k))
        Gy.append(item.array('Gy', r, l0))
        Gu.append(item.array('Gu', r, m))
    grade = reader.word('grade', ('exact', 'bounded'))
    return VirtualSensor(
        channel, fault_set, healthy, design.inputs, reader.array('Phi', k, n), N,
        reader.array('J', k, l0), reader.array('B', k, m), reader.array('P', k, len(terms)),
        reader.array('Cv', p, k), reader.array('Q', p, l0), tuple(Gz), tuple(Gy), tuple(terms),
        design.sample_time, reader.array('z0', k), reader.array('z0_gain', k, l0),
        stored[:, 0] + 1j * stored[:, 1], reader.size('noise_gain'), reader.text('method'),
        reader.array('Qu', p, m), tuple(Gu), grade, reader.size('disturbance_gain'),
        _read_proof(reader.optional('proof'), k, grade),
        tuple(_read_rung(item) for item in reader.objects('ladder')),
        _read_noise(reader.optional('noise')),
        _read_certificate(reader.optional('certificate'), k), _read_start(reader, k))


def _read_proof(reader: _Reader | None, order: int, grade: str) -> Proof | None:
    if reader is None:
        return None
    reader.only(('lower', 'upper', 'steps', 'doubts'))
    lower, upper = reader.whole('lower'), reader.whole('upper')
    if lower > upper:
        raise reader.fail('lower', f'{lower} is above upper, {upper}')
    if grade == 'exact' and upper > order:
        raise reader.fail('upper', f'{upper} is above the order {order} of this virtual sensor')
    steps: list[OrderStep] = []
    for item in reader.objects('steps'):
        item.only(('order', 'verdict', 'why', 'freedom', 'gap'))
        step = OrderStep(
            item.whole('order'), item.word('verdict', ('impossible', 'possible', 'open')),
            item.text('why'), item.whole('freedom'), item.pair('gap', (False, True)))
        if steps and step.order <= steps[-1].order:
            raise item.fail('order', 'is not above that of the step before')
        if step.verdict == 'impossible' and step.order >= lower:
            raise item.fail('verdict', f'impossible does not agree with lower, {lower}')
        if step.verdict == 'possible' and step.order < upper:
            raise item.fail('verdict', f'possible does not agree with upper, {upper}')
        steps.append(step)
    return Proof(lower, upper, tuple(steps), reader.texts('doubts'))


def _read_rung(reader: _Reader) -> Rung:
    reader.only(('order', 'noise', 'noise_gain', 'decay', 'method'))
    return Rung(reader.whole('order'), reader.size('noise'), reader.size('noise_gain'),
                reader.size('decay', infinite=True), reader.text('method'))


def _read_noise(reader: _Reader | None) -> Noise | None:
    if reader is None:
        return None
    reader.only(('error', 'floor', 'assumed'))
    return Noise(reader.size('error'), reader.size('floor', infinite=True),
                 reader.flag('assumed'))


def _read_certificate(reader: _Reader | None, k: int) -> Certificate | None:
    if reader is None:
        return None
    reader.only(('status', 'rate', 'bound', 'S', 'region', 'lipschitz', 'reason'))
    status = reader.word('status', ('global', 'region', 'none'))
    rate = reader.size('rate', infinite=True)
    if status == 'none' and rate:
        raise reader.fail('rate', 'must be 0 where nothing is certified')
    region = []
    for item in reader.objects('region'):
        item.only(('name', 'low', 'high'))
        low, high = item.limit('low', -_INF), item.limit('high', _INF)
        if not low < high:
            raise item.fail('low', 'is not below high')
        region.append((item.text('name'), low, high))
    if bool(region) != (status == 'region'):
        raise reader.fail('region', f'does not agree with the status {status}')
    lipschitz = None
    if reader.record.get('lipschitz', 0) is not None:
        lipschitz = reader.pair('lipschitz', (True, True))
    return Certificate(status, rate, reader.size('bound', infinite=True),
                       reader.array('S', k, k), tuple(region), lipschitz, reader.text('reason'))


def _read_start(reader: _Reader, k: int) -> np.ndarray | None:
    if 'start' not in reader.record:
        return None
    start = reader.array('start', k, k)
    if not np.array_equal(start, start.T):
        raise reader.fail('start', 'is not symmetric')
    size = np.sqrt(np.abs(np.diag(start)))
    unit = np.divide(1.0, size, out=np.zeros(k), where=size > 0.0)
    with np.errstate(all='ignore'):
        scaled = start * unit * unit[:, None]
    if not np.isfinite(scaled).all() or start[size == 0.0].any() or (
            k and np.linalg.eigvalsh(scaled).min() < -1e-6):
        raise reader.fail('start', 'is not a covariance')
    return start


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
