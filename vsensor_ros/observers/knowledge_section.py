"""How what is known of a virtual sensor stands in the design file, whatever its kind."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from vsensor_ros.observers.checked_json import CheckedObject, or_null
from vsensor_ros.observers.knowledge import Noise, OrderStep, Proof, Rung


def proof_record(proof: Proof | None) -> dict[str, Any] | None:
    """Write what is proved of the least order."""
    if proof is None:
        return None
    return {
        **{key: value for key, value in asdict(proof).items() if key != 'modulo' or value},
        'steps': [{**asdict(s), 'gap': [s.gap[0], or_null(s.gap[1])]} for s in proof.steps]}


def rung_record(rung: Rung) -> dict[str, Any]:
    """Write an order to choose from."""
    return {**asdict(rung), 'decay': or_null(rung.decay)}


def noise_record(noise: Noise | None) -> dict[str, Any] | None:
    """Write what noise does in steady state."""
    return None if noise is None else {**asdict(noise), 'floor': or_null(noise.floor)}


def read_proof(reader: CheckedObject | None, order: int, grade: str) -> Proof | None:
    """Read what is proved of the least order."""
    if reader is None:
        return None
    reader.only(('lower', 'upper', 'steps', 'doubts', 'modulo'))
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
    return Proof(lower, upper, tuple(steps), reader.texts('doubts'),
                 'modulo' in reader.record and reader.flag('modulo'))


def read_rung(reader: CheckedObject) -> Rung:
    """Read an order to choose from."""
    reader.only(('order', 'noise', 'noise_gain', 'decay', 'method'))
    return Rung(reader.whole('order'), reader.size('noise'), reader.size('noise_gain'),
                reader.size('decay', infinite=True), reader.text('method'))


def read_noise(reader: CheckedObject | None) -> Noise | None:
    """Read what noise does in steady state."""
    if reader is None:
        return None
    reader.only(('error', 'floor', 'assumed'))
    return Noise(reader.size('error'), reader.size('floor', infinite=True),
                 reader.flag('assumed'))


def read_covariance(reader: CheckedObject, key: str, k: int) -> np.ndarray:
    """Read a covariance (k, k)."""
    found = reader.array(key, k, k)
    if not np.array_equal(found, found.T):
        raise reader.fail(key, 'is not symmetric')
    size = np.sqrt(np.abs(np.diag(found)))
    unit = np.divide(1.0, size, out=np.zeros(k), where=size > 0.0)
    with np.errstate(all='ignore'):
        scaled = found * unit * unit[:, None]
    if not np.isfinite(scaled).all() or found[size == 0.0].any() or (
            k and np.linalg.eigvalsh(scaled).min() < -1e-6):
        raise reader.fail(key, 'is not a covariance')
    return found
