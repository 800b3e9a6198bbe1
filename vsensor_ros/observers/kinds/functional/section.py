"""The section of the design file that holds a virtual sensor of the kind functional."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vsensor_ros.functions.nonlinearity import check_term, NonlinearTerm
from vsensor_ros.observers.checked_json import CheckedObject, INF, LARGEST_SIDE, or_null
from vsensor_ros.observers.contents import Contents
from vsensor_ros.observers.kinds.functional.tracking_section import (
    read_tracking,
    tracking_record,
)
from vsensor_ros.observers.kinds.functional.virtual_sensor import (
    is_stable,
    VirtualSensor,
    worst_of,
)
from vsensor_ros.observers.knowledge import Certificate, Limit
from vsensor_ros.observers.knowledge_section import (
    noise_record,
    proof_record,
    read_covariance,
    read_noise,
    read_proof,
    read_rung,
    rung_record,
)

_ARRAYS = ('Phi', 'N', 'J', 'B', 'P', 'Cv', 'Q', 'Qu', 'z0', 'z0_gain')
_KEYS = frozenset((
    'healthy', 'order', 'method', 'grade', 'noise_gain', 'disturbance_gain', 'eigenvalues',
    'terms', 'proof', 'ladder', 'noise', 'certificate', 'start', 'tracking', 'why',
    *_ARRAYS))


def write_section(v: VirtualSensor) -> dict[str, Any]:
    """Return what the design file says of v, but for its kind, channel and fault set."""
    return {
        'healthy': list(v.healthy),
        'order': v.order,
        'method': v.method,
        'grade': v.grade,
        'noise_gain': or_null(v.noise_gain),
        'disturbance_gain': v.disturbance_gain,
        'eigenvalues': [[float(e.real), float(e.imag)] for e in v.eigenvalues],
        **{key: getattr(v, key).tolist() for key in _ARRAYS},
        'terms': [{'name': t.name, **({} if t.short == t.name else {'short': t.short}),
                   'function': t.text, 'slope': t.slope.tolist(), 'Gz': gz.tolist(),
                   'Gy': gy.tolist(), 'Gu': gu.tolist()}
                  for t, gz, gy, gu in zip(v.terms, v.Gz, v.Gy, v.Gu)],
        'proof': proof_record(v.proof),
        'ladder': [rung_record(rung) for rung in v.ladder],
        'noise': noise_record(v.noise),
        'certificate': None if v.certificate is None else _certificate_record(v.certificate),
        **({} if v.start is None else {'start': v.start.tolist()}),
        **({} if v.tracking is None else {'tracking': tracking_record(v.tracking)}),
        **({'why': v.why} if v.why else {}),
    }


def _certificate_record(c: Certificate) -> dict[str, Any]:
    return {
        'status': c.status,
        'rate': or_null(c.rate),
        'bound': or_null(c.bound),
        'S': c.S.tolist(),
        'region': [{'term': term, 'argument': argument, 'low': or_null(low, -INF),
                    'high': or_null(high)} for term, argument, low, high in c.region],
        'lipschitz': None if c.lipschitz is None else [or_null(side) for side in c.lipschitz],
        'reason': c.reason,
        **({'uncovered': c.uncovered} if c.uncovered else {}),
        **({'where': [{'name': name, 'low': or_null(low, -INF), 'high': or_null(high)}
                      for name, low, high in c.where]} if c.where else {}),
    }


def read_section(reader: CheckedObject, channel: str, fault_set: tuple[str, ...], plant: Contents,
                 version: int) -> VirtualSensor:
    """Read what write_section wrote, or an earlier version; raises BadInput."""
    reader.only(_KEYS)
    healthy = reader.names('healthy')
    if healthy != tuple(s for s in plant.sensors if s not in fault_set):
        raise reader.fail('healthy', 'is not the sensors without the fault set')
    k = reader.whole('order')
    n, l0, m = len(plant.states), len(healthy), len(plant.inputs)
    # a sensor's channel is one number, a wanted functional may be several
    p = len(reader.get('Cv', list, 'a list of rows')) if channel in plant.wanted else 1
    if not 1 <= p <= LARGEST_SIDE:
        raise reader.fail('Cv', f'must have 1 to {LARGEST_SIDE} rows')
    N = reader.array('N', k, k)
    eigenvalues = np.linalg.eigvals(N).astype(complex)
    grade = reader.word('grade', ('exact', 'bounded', 'temporary'))
    temporary = grade == 'temporary'
    if not temporary and not is_stable(eigenvalues, plant.sample_time):
        raise reader.fail('N', 'is unstable (eigenvalue '
                          f'{worst_of(eigenvalues, plant.sample_time):.6g})')
    stored = reader.array('eigenvalues', k, 2)
    if not _same_spectrum(stored[:, 0] + 1j * stored[:, 1], eigenvalues, N):
        raise reader.fail('eigenvalues', 'are not those of N')
    terms, Gz, Gy, Gu = [], [], [], []
    for item in reader.objects('terms'):
        item.only(('name', 'short', 'function', 'slope', 'Gz', 'Gy', 'Gu'))
        r = len(item.get('slope', list, 'a list of numbers'))
        term = NonlinearTerm(item.text('name'), item.text('function'), item.array('slope', r),
                             item.text('short') if 'short' in item.record else '')
        check_term(term, plant.inputs, reader.path, f'{item.place}function')
        terms.append(term)
        Gz.append(item.array('Gz', r, k))
        Gy.append(item.array('Gy', r, l0))
        Gu.append(item.array('Gu', r, m))
    v = VirtualSensor(
        channel, fault_set, healthy, plant.inputs, reader.array('Phi', k, n), N,
        reader.array('J', k, l0), reader.array('B', k, m), reader.array('P', k, len(terms)),
        reader.array('Cv', p, k), reader.array('Q', p, l0), tuple(Gz), tuple(Gy), tuple(terms),
        plant.sample_time, reader.array('z0', k), reader.array('z0_gain', k, l0),
        stored[:, 0] + 1j * stored[:, 1], reader.size('noise_gain', infinite=temporary),
        reader.text('method'), reader.array('Qu', p, m), tuple(Gu), grade,
        reader.size('disturbance_gain'), read_proof(reader.optional('proof'), k, grade),
        tuple(read_rung(item) for item in reader.objects('ladder')),
        read_noise(reader.optional('noise')), start=_read_start(reader, k),
        tracking=read_tracking(reader, fault_set, channel, N, l0, m, plant.sample_time),
        why=reader.text('why') if 'why' in reader.record else '')
    if temporary and v.tracking is None:
        raise reader.fail('tracking', 'is missing: a temporary one needs it')
    certificate = reader.optional('certificate')
    return v if certificate is None else replace(
        v, certificate=_read_certificate(certificate, v, version))


def _read_certificate(reader: CheckedObject, v: VirtualSensor, version: int) -> Certificate:
    reader.only(('status', 'rate', 'bound', 'S', 'region', 'lipschitz', 'reason',
                 'uncovered', 'where'))
    status = reader.word('status', ('global', 'region', 'none'))
    rate = reader.size('rate', infinite=True)
    if status == 'none' and rate:
        raise reader.fail('rate', 'must be 0 where nothing is certified')
    region = _read_region(reader, v) if version > 3 else _read_named_region(reader, v)
    if region is not None and bool(region) != (status == 'region'):
        raise reader.fail('region', f'does not agree with the status {status}')
    lipschitz = None
    if reader.record.get('lipschitz', 0) is not None:
        lipschitz = reader.pair('lipschitz', (True, True))
    bound, why = reader.size('bound', infinite=True), reader.text('reason')
    S = reader.array('S', v.order, v.order)
    if region is None:
        return Certificate('none', 0.0, INF, np.zeros_like(S), (), lipschitz, 'it cannot be told '
                           'which arguments the region of this older file bounds')
    if version > 3 and status != 'none' and not _is_definite(S):
        raise reader.fail('S', 'is not symmetric and positive definite')
    left = reader.text('uncovered') if 'uncovered' in reader.record else ''
    return Certificate(status, rate, bound, S, region, lipschitz, why, left, _read_where(reader))


def _read_where(reader: CheckedObject) -> tuple[tuple[str, float, float], ...]:
    places = reader.objects('where') if 'where' in reader.record else []
    for place in places:
        place.only(('name', 'low', 'high'))
    return tuple((place.text('name'), *_read_limits(place)) for place in places)


def _read_region(reader: CheckedObject, v: VirtualSensor) -> tuple[Limit, ...]:
    region: list[Limit] = []
    for item in reader.objects('region'):
        item.only(('term', 'argument', 'low', 'high'))
        term, count = None, len(v.inputs)
        if item.record.get('term', 0) is not None:
            term = item.whole('term')
            if term >= len(v.terms):
                raise item.fail('term', f'{term}: there are {len(v.terms)}, counted from 0')
            count = len(v.terms[term].slope)
        argument = item.whole('argument')
        if argument >= count:
            raise item.fail('argument', f'{argument}: there are {count}, counted from 0')
        if (term, argument) in {(limit.term, limit.argument) for limit in region}:
            raise item.fail('argument', 'stands there twice')
        region.append(Limit(term, argument, *_read_limits(item)))
    places = {(limit.term, limit.argument) for limit in region if limit.term is not None}
    feeding = _feeding(v, exact=True)
    stray = places - {place for alike in feeding for place in alike}
    if stray:
        term, argument = min(stray)
        raise reader.fail('region', f'argument {argument} of term {term} does not feed the '
                          'estimate')
    if places and not all(places.intersection(alike) for alike in feeding):
        raise reader.fail('region', 'lacks an argument that feeds the estimate')
    return tuple(region)


def _feeding(v: VirtualSensor, exact: bool) -> list[list[tuple[int, int]]]:
    """
    Return the arguments (term, argument) by which the estimate feeds its terms, equals together.

    exact: equal to the last bit; else to nine digits.
    """
    found: dict[bytes, list[tuple[int, int]]] = {}
    for i in v.active:
        for j, rows in enumerate(zip(v.Gz[i], v.Gy[i])) if v.Gz[i].any() else ():
            row = np.concatenate(rows)
            if not exact:
                scale = np.abs(row).max(initial=0.0) or 1.0
                row = np.round(row / scale, 9) * scale
            found.setdefault((row + 0.0).tobytes(), []).append((i, j))
    return list(found.values())


def _is_definite(S: np.ndarray) -> bool:
    """Tell whether a matrix is symmetric and positive definite, but for rounding."""
    size = np.sqrt(np.abs(np.diag(S)))
    if not len(S):
        return True
    if not (size > 0.0).all() or not np.allclose(S, S.T, rtol=1e-9, atol=0.0):
        return False
    return bool((np.diag(S) > 0.0).all() and np.linalg.eigvalsh(
        S / size / size[:, None]).min() > -1e-9)


def _read_named_region(reader: CheckedObject, v: VirtualSensor) -> tuple[Limit, ...] | None:
    """
    Read a region as it stood in the file before version 4: as texts; None: whose, is not clear.

    The designer listed each argument by which the estimate feeds its terms, equal ones once, and
    then commands.
    """
    items = reader.objects('region')
    for item in items:
        item.only(('name', 'low', 'high'))
    limits = [_read_limits(item) for item in items]
    told = [limit for item, limit in zip(items, limits) if item.text('name') not in v.inputs]
    commands = [Limit(None, v.inputs.index(item.text('name')), *limit)
                for item, limit in zip(items, limits) if item.text('name') in v.inputs]
    if not told:
        return tuple(commands)
    for exact in (True, False):
        arguments = [alike[0] for alike in _feeding(v, exact)]
        if len(arguments) == len(told):
            return (*(Limit(i, j, *limit) for (i, j), limit in zip(arguments, told)), *commands)
    return None


def _read_limits(reader: CheckedObject) -> tuple[float, float]:
    low, high = reader.limit('low', -INF), reader.limit('high', INF)
    if not low < high:
        raise reader.fail('low', 'is not below high')
    return low, high


def _read_start(reader: CheckedObject, k: int) -> np.ndarray | None:
    return read_covariance(reader, 'start', k) if 'start' in reader.record else None


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
