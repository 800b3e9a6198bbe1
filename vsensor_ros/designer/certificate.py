"""
What can be proved of a virtual sensor's error once its nonlinear terms are taken seriously.

The error e = Phi x - z obeys, with n the error of the readings and s the difference quotients of
the terms, ``d e = (N + sum_j s_j p_j g_j) e - (J + sum_j s_j p_j h_j) n`` and
``v - vhat = Cv e - Q n``. One quadratic form V = e' S e that falls for all slopes in their
bounds proves decay at a rate for any two solutions, whatever the plant does (incremental
stability; the method, 3.5). Stable eigenvalues of every frozen linearisation prove nothing.

The matrix S is searched for by linear matrix inequalities and believed only after it has been put
into the inequalities in plain floating point, with a margin for rounding.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov, solve_triangular

from vsensor_ros.designer.error_system import decay_rate, ErrorSystem, Slopes
from vsensor_ros.designer.form_search import LARGEST_ORDER, lyapunov, search
from vsensor_ros.designer.peak_to_peak import peak_bound
from vsensor_ros.designer.quadratic_form import Form, MOST_CORNERS, ROUNDING
from vsensor_ros.designer.slopes import jumps, slope_bounds_on
from vsensor_ros.designer.stability import lasting
from vsensor_ros.functions.expression import names, parse
from vsensor_ros.functions.interval import Interval
from vsensor_ros.observers import Certificate, Limit, VirtualSensor
from vsensor_ros.observers.kinds.functional import argument_name
from vsensor_ros.plant.plant import Plant

INFINITE_SLOPE = 1e100
REACHES = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01)  # of boxes, in operating points
WORTHWHILE = 0.2  # of the linearisation's rate: a larger box is taken down to this rate
MISSING = 'cvxpy is not installed: pip install cvxpy clarabel'


def certify(plant: Plant, sensor: VirtualSensor) -> Certificate:
    """
    Prove what can be proved of the error of a virtual sensor of this plant.

    rate: |e(t)| in the norm of S falls at least as exp(-rate t) without errors of the readings.
    bound: of |v - vhat| after the start has been forgotten, when no reading is ever off by more
    than 1; scale it with their accuracy. For a linear error it is the peak-to-peak gain, the L1
    norm of the impulse response, from above within a fraction of it (an oscillation may cost a
    quarter); with terms the least of what the forms met and the peak gains prove. Unknown inputs
    that a sensor of grade 'bounded' does not keep out are in neither rate nor bound.
    S is scaled so that |v - vhat|^2 <= e' S e when the readings are right. lipschitz compares
    the papers' condition (paper S after (25); the method, 3.5), in the coordinates of z.

    Needs cvxpy and clarabel for two or more states with nonlinear terms; the reason says so
    where they are missing.
    """
    if not len(sensor.N):
        return Certificate('global', np.inf, _largest_row_sum(sensor.Q), np.zeros((0, 0)), (),
                           (0.0, np.inf), 'it has no state: what the readings say is said at once')
    everywhere = _unlimited(plant)
    bounds = _slope_bounds(plant, sensor, *everywhere)
    error = _error(sensor, bounds)
    if not _feeding_terms(sensor):
        return _linear(plant, sensor, error)
    runaway = _runaway(sensor, bounds)
    if runaway:
        return _none(sensor, bounds, runaway)
    try:
        form = search(error)
        if form is not None:
            return _certificate('global', form, sensor, bounds, (), _said(
                sensor, 'one quadratic form of the error falls for every slope that '
                f'{_listed(_term_names(sensor))} can have anywhere'))
        return _in_a_region(plant, sensor)
    except ImportError:
        return _none(sensor, bounds, MISSING)


def _in_a_region(plant: Plant, sensor: VirtualSensor) -> Certificate:
    """Confine the arguments to the plant's ranges, else to boxes about the operating point."""
    ranges, input_range = plant.ranges, plant.input_range
    used = np.any([np.abs(plant.G[i]).sum(axis=0) > 0 for i in _feeding_terms(sensor)], axis=0)
    known = bool(np.isfinite(ranges[used]).any()
                 or np.isfinite(input_range[_used_inputs(sensor)]).any())
    found: tuple[Form, np.ndarray, np.ndarray] | None = None
    if known:
        form = search(_error(sensor, _slope_bounds(plant, sensor, ranges, input_range)))
        if form is not None:
            found = form, ranges, input_range
    if found is None:
        here = _error(sensor, _slope_bounds(plant, sensor, *_box(plant, 1e-6)))
        wanted = WORTHWHILE * decay_rate(here.N, sensor.sample_time)
        for reach in REACHES if wanted > 0.0 else ():
            states, inputs = _box(plant, reach)
            form = search(_error(sensor, _slope_bounds(plant, sensor, states, inputs)), wanted)
            if form is not None:
                found = form, states, inputs
                break
    if found is None:
        place = 'in the given ranges' if known else 'near the operating point'
        tight = _slope_bounds(plant, sensor, ranges if known else _box(plant, REACHES[-1])[0],
                              input_range if known else _box(plant, REACHES[-1])[1])
        return _none(sensor, tight, _obstacle(sensor, tight, place))
    form, states, inputs = found
    region = _region(plant, sensor, states, inputs)
    return _certificate(
        'region', form, sensor, _slope_bounds(plant, sensor, states, inputs),
        tuple(limit for _, limit in region),
        _said(sensor, 'it holds only while plant and estimate both keep '
              + _listed([f'{name} in [{at.low:.4g}, {at.high:.4g}]' for name, at in region
                         if np.isfinite((at.low, at.high)).any()])))


def _linear(plant: Plant, sensor: VirtualSensor, error: ErrorSystem) -> Certificate:
    """Certify an error that no nonlinear term feeds: by its spectrum, without a solver."""
    values, stays = lasting(error.N, error.sample_time)
    bounds = _slope_bounds(plant, sensor, *_unlimited(plant))
    if stays.any():
        worst = values[stays][0]
        return _none(sensor, bounds, 'the linear error does not die out for certain '
                     f'(eigenvalue {_shown(worst)})')
    proved = lyapunov(error)
    if proved is None:
        return _none(sensor, bounds, 'the eigenvalues are stable, but so sensitive to rounding '
                     'that no quadratic form proves it')
    reason = 'its error is linear and dies out from every start'
    measured = [i for i in sensor.active if np.any(sensor.Gy[i])]
    if len(error.loose.p.T) or len(error.rising.p.T):
        near = _error(sensor, _slope_bounds(plant, sensor, plant.ranges, plant.input_range))
        if len(near.loose.p.T) or len(near.rising.p.T):
            reason += (f'; no bound for errors of the readings is known: the slope of '
                       f'{_listed([sensor.terms[i].name for i in measured])} has none')
        else:
            error = near
            reason += '; its bound holds while states and inputs stay in the given ranges'
    form = Form(*proved, peak_bound(error, *proved))
    return _certificate('global', form, sensor, bounds, (), _said(sensor, reason))


# ------------------------------------------------------------------------- the error system

def _unlimited(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    # boxes of states (n, 2) and inputs (m, 2) that say nothing
    line = np.array([-np.inf, np.inf])
    return np.tile(line, (len(plant.states), 1)), np.tile(line, (len(plant.inputs), 1))


def _box(plant: Plant, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """Surround the operating point by so many times its own size, within the ranges."""
    def around(point: np.ndarray, ranges: np.ndarray) -> np.ndarray:
        size = np.abs(point)
        typical = size.max(initial=0.0) or 1.0
        size = np.where(size > 0.0, size, typical)
        low = np.maximum(point - reach * size, ranges[:, 0])
        high = np.minimum(point + reach * size, ranges[:, 1])
        outside = low > high  # the operating point lies outside of the ranges
        return np.where(outside[:, None], ranges, np.stack([low, high], axis=1))

    return (around(plant.operating_point, plant.ranges),
            around(plant.operating_input, plant.input_range))


def _image(rows: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return the box (r, 2) in which rows @ x lies for x in a box (n, 2)."""
    low, high = box[:, 0], box[:, 1]
    with np.errstate(invalid='ignore'):
        down = np.where(rows > 0, rows * low, np.where(rows < 0, rows * high, 0.0))
        up = np.where(rows > 0, rows * high, np.where(rows < 0, rows * low, 0.0))
    return np.stack([down.sum(axis=1), up.sum(axis=1)], axis=1)


def _slope_bounds(plant: Plant, sensor: VirtualSensor, states: np.ndarray,
                  inputs: np.ndarray) -> dict[int, tuple[Interval, ...]]:
    """Bound the slopes of every active term over a box of states and inputs."""
    return {i: slope_bounds_on(sensor.terms[i], _image(plant.G[i], states), sensor.inputs, inputs)
            for i in sensor.active}


def _feeding_terms(sensor: VirtualSensor) -> list[int]:
    # active terms that see the estimate itself
    return [i for i in sensor.active if np.any(sensor.Gz[i])]


def _used_inputs(sensor: VirtualSensor) -> list[int]:
    # indices of the inputs that these terms hold
    used = {name for i in _feeding_terms(sensor) for name in names(parse(sensor.terms[i].text))}
    return [j for j, name in enumerate(sensor.inputs) if name in used]


def _error(sensor: VirtualSensor, bounds: dict[int, tuple[Interval, ...]]) -> ErrorSystem:
    N, J = np.array(sensor.N, dtype=float), np.array(sensor.J, dtype=float)
    groups: dict[str, list[tuple[np.ndarray, np.ndarray, np.ndarray, float]]] = {
        'bounded': [], 'rising': [], 'loose': []}
    for i, slopes in bounds.items():
        for j, (low, high) in enumerate(slopes):
            p, g, h = sensor.P[:, i], sensor.Gz[i][j], sensor.Gy[i][j]
            if not (g.any() or h.any()):
                continue
            sinks, climbs = low < -INFINITE_SLOPE, high > INFINITE_SLOPE
            if sinks and climbs:
                groups['loose'].append((p, g, h, np.inf))
                continue
            if sinks:
                p, centre, radius = -p, -high, np.inf
            elif climbs:
                centre, radius = low, np.inf
            else:
                centre, radius = 0.5 * (low + high), 0.5 * (high - low)
                if radius <= ROUNDING * abs(centre):
                    radius = 0.0
            N += centre * np.outer(p, g)
            J += centre * np.outer(p, h)
            if radius:
                groups['bounded' if np.isfinite(radius) else 'rising'].append((p, g, h, radius))
    k, l0 = N.shape[0], J.shape[1]
    made = {name: Slopes(np.array([p for p, *_ in some]).reshape(len(some), k).T,
                          np.array([g for _, g, _, _ in some]).reshape(len(some), k),
                          np.array([h for _, _, h, _ in some]).reshape(len(some), l0),
                          np.array([r for *_, r in some]))
            for name, some in groups.items()}
    return ErrorSystem(N, J, sensor.Cv, sensor.Q, **made, sample_time=sensor.sample_time)


# ------------------------------------------------------------- the papers' condition, the words

def _lipschitz(sensor: VirtualSensor,
               bounds: dict[int, tuple[Interval, ...]]) -> tuple[float, float] | None:
    """
    Return (M_*, lambda_min(W) / (2 lambda_max(X))) with N' X + X N = -W, W = I.

    M_* is the Lipschitz constant, by z, of the sum of P_i psi_i. For a discrete plant, where
    the papers give no formula, the right side is the M that keeps V = e' X e from rising:
    lambda_max(X) M^2 + 2 |N' X| M = 1. None where a term has no Lipschitz constant or N is not
    stable.
    """
    parts = [(np.outer(sensor.P[:, i], row), low, high)
             for i in _feeding_terms(sensor)
             for row, (low, high) in zip(sensor.Gz[i], bounds[i]) if row.any()]
    if any(max(-low, high) > INFINITE_SLOPE for _, low, high in parts):
        return None
    if lasting(sensor.N, sensor.sample_time)[1].any():
        return None
    if len(parts) <= MOST_CORNERS:
        left = max(float(np.linalg.norm(sum((s * M for s, (M, _, _) in zip(ends, parts)),
                                            np.zeros_like(sensor.N)), 2))
                   for ends in product(*((low, high) for _, low, high in parts)))
    else:
        left = float(sum(max(-low, high) * np.linalg.norm(M, 2) for M, low, high in parts))
    identity = np.eye(len(sensor.N))
    try:
        if sensor.sample_time is None:
            X = solve_continuous_lyapunov(sensor.N.T, -identity)
            right = 0.5 / np.linalg.eigvalsh(0.5 * (X + X.T))[-1]
        else:
            X = solve_discrete_lyapunov(sensor.N.T, identity)
            a, b = np.linalg.eigvalsh(0.5 * (X + X.T))[-1], np.linalg.norm(sensor.N.T @ X, 2)
            right = 1.0 / (b + np.sqrt(b * b + a))
    except (np.linalg.LinAlgError, ValueError):
        return None
    return left, max(float(right), 0.0)


def _runaway(sensor: VirtualSensor, bounds: dict[int, tuple[Interval, ...]]) -> str:
    """Name a term with a jump that pushes its own argument away from the jump, or ''."""
    for i in _feeding_terms(sensor):
        for row, (low, high) in zip(sensor.Gz[i], bounds[i]):
            push = float(row @ sensor.P[:, i])
            if sensor.sample_time is None and jumps(sensor.terms[i]) and (
                    high > INFINITE_SLOPE and push > 0 or low < -INFINITE_SLOPE and push < 0):
                return (f'{sensor.terms[i].name} drives its own argument away from zero: '
                        'two branches can stay apart')
    return ''


def _obstacle(sensor: VirtualSensor, bounds: dict[int, tuple[Interval, ...]],
              place: str) -> str:
    """Say in one clause why no form was found."""
    for i, slopes in bounds.items():
        for row, (low, high) in zip(sensor.Gz[i], slopes):
            name = sensor.terms[i].name
            steep = high > INFINITE_SLOPE, low < -INFINITE_SLOPE
            if row.any() and all(steep):
                return f'the slope of {name} has no bound {place}'
            if row.any() and any(steep):
                push = float(row @ sensor.P[:, i]) * (1.0 if steep[0] else -1.0)
                if sensor.sample_time is not None:
                    return (f'{name} is infinitely steep {place}, and in one step it can throw '
                            'its argument beyond any bound')
                if push >= 0:
                    return (f'{name} is infinitely steep {place} and does not pull its argument '
                            'back')
    terms, error = _listed(_term_names(sensor)), _error(sensor, bounds)
    if len(error.bounded.feeding.radius) <= MOST_CORNERS \
            and min(decay_rate(A, sensor.sample_time) for A in error.corners()) <= 0:
        return f'with slopes that {terms} can have {place} the error does not die out'
    if len(sensor.N) > LARGEST_ORDER:
        return f'more than {LARGEST_ORDER} states: only a coarser test was made, and it failed'
    return f'no quadratic form falls for all slopes that {terms} can have {place}'


def _region(plant: Plant, sensor: VirtualSensor, states: np.ndarray,
            inputs: np.ndarray) -> tuple[tuple[str, Limit], ...]:
    """List the boxes of the arguments, and of the inputs where those are confined too."""
    found: dict[bytes | str, tuple[str, Limit]] = {}  # equal arguments once
    for i in _feeding_terms(sensor):
        for j, (row, (low, high)) in enumerate(zip(plant.G[i], _image(plant.G[i], states))):
            found.setdefault((row + 0.0).tobytes(), (
                argument_name(sensor.terms[i], j), Limit(i, j, float(low), float(high))))
    for j in _used_inputs(sensor):
        if np.isfinite(inputs[j]).any():
            low, high = map(float, inputs[j])
            found[plant.inputs[j]] = plant.inputs[j], Limit(None, j, low, high)
    return tuple(found.values())


def _certificate(status: str, form: Form, sensor: VirtualSensor,
                 bounds: dict[int, tuple[Interval, ...]],
                 region: tuple[Limit, ...], reason: str) -> Certificate:
    # V in units of the channel: |Cv e|^2 <= e' S e
    size = max(float(np.linalg.norm(solve_triangular(form.L, row, lower=True)))
               for row in sensor.Cv)
    L = form.L * (size or 1.0)
    return Certificate(status, float(form.rate), float(form.bound * (1 + 1e-9)), L @ L.T, region,
                       _lipschitz(sensor, bounds), reason)


def _none(sensor: VirtualSensor, bounds: dict[int, tuple[Interval, ...]],
          reason: str) -> Certificate:
    return Certificate('none', 0.0, np.inf, np.zeros_like(sensor.N), (),
                       _lipschitz(sensor, bounds), reason)


def _said(sensor: VirtualSensor, reason: str) -> str:
    if sensor.grade == 'bounded':
        reason += '; what the unknown inputs do to it comes on top'
    return reason


def _term_names(sensor: VirtualSensor) -> list[str]:
    return [sensor.terms[i].name for i in _feeding_terms(sensor)]


def _listed(texts: Sequence[str]) -> str:
    texts = list(dict.fromkeys(texts))
    return ' and '.join([', '.join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def _shown(value: complex) -> str:
    return f'{value.real:.4g}' if value.imag == 0 else f'{value.real:.4g}{value.imag:+.4g}i'


def _largest_row_sum(Q: np.ndarray) -> float:
    return float(np.abs(Q).sum(axis=1).max(initial=0.0))
