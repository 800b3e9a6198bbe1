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
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from vsensor_ros.designer.error_in_box import (
    Bounds,
    error_system,
    feeding_terms,
    image,
    joint_system,
    slope_bounds,
    used_inputs,
    used_states,
)
from vsensor_ros.designer.error_system import decay_rate, ErrorSystem
from vsensor_ros.designer.form_search import ceiling, lyapunov, search
from vsensor_ros.designer.lipschitz import lipschitz
from vsensor_ros.designer.natural_size import reaches
from vsensor_ros.designer.obstacles import (
    listed_once,
    obstacle,
    runaway,
    steep_readings,
    term_names,
)
from vsensor_ros.designer.peak_to_peak import peak_bound
from vsensor_ros.designer.quadratic_form import bound_on, Form
from vsensor_ros.designer.stability import lasting
from vsensor_ros.designer.uncovered import uncovered
from vsensor_ros.observers import Certificate, Limit, VirtualSensor
from vsensor_ros.observers.kinds.functional import sum_place, together
from vsensor_ros.plant.plant import Plant

# of boxes, in operating points
REACHES = (10.0, 5.0, 2.0, 1.0, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01)
WORTHWHILE = 0.2  # of the linearisation's rate: a larger box is taken down to this rate
LEAST = 1e-3  # of that rate: what falls more slowly does not count as falling
ROOM = 1.1  # eigenvalues must allow so much more, or a form is not looked for
PLENTY = 1.5  # of that
MOST_TRIED = 4  # virtual sensors in one box
BOUND_ON_RANGES = '; its bound holds while states, readings and inputs stay in the given ranges'
Box = tuple[np.ndarray, np.ndarray]  # of states (n, 2) and inputs (m, 2)


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
    try:
        found = everywhere(plant, sensor) or on_ranges(plant, sensor)
        near = None if found else near_the_point(plant, [sensor])
        return found or (near[1] if near else nowhere(plant, sensor))
    except ImportError as missing:
        return nowhere(plant, sensor, str(missing))


def everywhere(plant: Plant, sensor: VirtualSensor) -> Certificate | None:
    """Prove it wherever plant and estimate are; None: not proved. Raises as ``certify`` says."""
    if not len(sensor.N):
        return Certificate('global', np.inf, _largest_row_sum(sensor.Q), np.zeros((0, 0)), (),
                           (0.0, np.inf), 'it has no state: what the readings say is said at once')
    bounds = slope_bounds(plant, sensor, *_unlimited(plant))
    error = error_system(sensor, bounds)
    if not feeding_terms(sensor):
        return _linear(plant, sensor, error)
    if runaway(sensor, bounds):
        return None
    form = search(error, LEAST * _rate_here(plant, sensor))
    if form is None:
        return None
    reason = ('one quadratic form of the error falls for every slope that '
              f'{listed_once(term_names(sensor))} can have anywhere')
    if not np.isfinite(form.bound):
        near = slope_bounds(plant, sensor, plant.ranges, plant.input_range)
        bound = bound_on(error_system(sensor, near), form.L, form.rate)
        if np.isfinite(bound):
            form, reason = replace(form, bound=bound), reason + BOUND_ON_RANGES
        else:
            reason += steep_readings(plant, sensor, near)
    return _certificate('global', form, sensor, bounds, (), _said(sensor, reason))


def on_ranges(plant: Plant, sensor: VirtualSensor, share: float = 0.0) -> Certificate | None:
    """
    Prove it in the ranges that the plant gives; None: not proved, or there are none.

    share: of the linearisation's rate, that is to be proved at least.
    """
    if not _ranged(plant, sensor) or _runs_away(plant, sensor):
        return None
    box = plant.ranges, plant.input_range
    form = _form_in(plant, sensor, box, max(share, LEAST) * _rate_here(plant, sensor))
    return None if form is None else _in_region(plant, sensor, form, box)


def near_the_point(plant: Plant, sensors: Sequence[VirtualSensor]) -> tuple[
        VirtualSensor, Certificate] | None:
    """
    Prove it of one of these sensors in a box about the operating point; None: of none.

    The largest box counts that leaves a worthwhile rate, of those alike the first sensor.
    """
    wanted = [(sensor, WORTHWHILE * _rate_here(plant, sensor)) for sensor in sensors
              if feeding_terms(sensor) and not _runs_away(plant, sensor)]
    boxes = _boxes(plant, [sensor for sensor, _ in wanted])
    for box, larger in zip(boxes, [(plant.ranges, plant.input_range), *boxes]):
        if all(map(np.array_equal, box, larger)):
            continue
        room = [promise(plant, sensor, box) / rate if rate > 0.0 else 0.0
                for sensor, rate in wanted]
        # the first with plenty of it, else those with most
        enough = max(ROOM, min(PLENTY, *sorted(room)[-MOST_TRIED:])) if room else ROOM
        likely = [i for i, share in enumerate(room) if share >= enough][:MOST_TRIED]
        found = _first_proved(plant, wanted, likely, box)
        if found is not None:
            # a little more room got it tried, and is no reason to go against the rank
            before = [i for i in range(found[0]) if room[i] > 1.0 and i not in likely]
            at, form = _first_proved(plant, wanted, before[:MOST_TRIED], box) or found
            return wanted[at][0], _in_region(plant, wanted[at][0], form, box)
    return None


def _first_proved(plant: Plant, wanted: Sequence[tuple[VirtualSensor, float]],
                  places: Sequence[int], box: Box) -> tuple[int, Form] | None:
    """Return the first of these places whose sensor has its wanted rate in a box, and the form."""
    for i in places:
        form = _form_in(plant, wanted[i][0], box, wanted[i][1])
        if form is not None:
            return i, form
    return None


def nowhere(plant: Plant, sensor: VirtualSensor, reason: str = '') -> Certificate:
    """Say why nothing is proved."""
    if not feeding_terms(sensor):
        bounds = slope_bounds(plant, sensor, *_unlimited(plant))
        values, stays = lasting(sensor.N, sensor.sample_time)
        return _none(sensor, bounds, 'the linear error does not die out for certain (eigenvalue '
                     f'{_shown(values[stays][0])})' if stays.any() else
                     'the eigenvalues are stable, but so sensitive to rounding '
                     'that no quadratic form proves it')
    ranged = _ranged(plant, sensor)
    reason = reason or _runs_away(plant, sensor)
    box = (_unlimited(plant) if reason else (plant.ranges, plant.input_range) if ranged
           else _box(plant, REACHES[-1]))
    bounds = slope_bounds(plant, sensor, *box)
    place = 'in the given ranges' if ranged else 'near the operating point'
    return _none(sensor, bounds, reason or obstacle(plant, sensor, bounds, box, place),
                 uncovered(plant, sensor, None))


def on_declared_ranges(plant: Plant, sensor: VirtualSensor, certificate: Certificate) -> bool:
    """Tell whether a certificate holds wherever the plant says that it works."""
    return certificate.status == 'global' or (
        certificate.status == 'region' and _ranged(plant, sensor)
        and certificate.region == _region(plant, sensor, plant.ranges, plant.input_range))


def promise(plant: Plant, sensor: VirtualSensor, box: Box | None) -> float:
    """Return at little cost what rate may at most be proved in a box, None: everywhere."""
    box = box or _unlimited(plant)
    bounds = slope_bounds(plant, sensor, *box)
    if feeding_terms(sensor) and _runs_away(plant, sensor):
        return -np.inf
    return ceiling(joint_system(plant, sensor, bounds, *box) or error_system(sensor, bounds))


def _rate_here(plant: Plant, sensor: VirtualSensor) -> float:
    here = error_system(sensor, slope_bounds(plant, sensor, *_box(plant, 1e-6)))
    return decay_rate(here.N, sensor.sample_time)


def _form_in(plant: Plant, sensor: VirtualSensor, box: Box, wanted: float = 0.0) -> Form | None:
    """Search for a form in a box: with each slope for itself, else with all together."""
    bounds = slope_bounds(plant, sensor, *box)
    apart, joint = error_system(sensor, bounds), joint_system(plant, sensor, bounds, *box)
    if joint is not None and not ceiling(joint) > wanted:
        return None
    form = search(apart, wanted)
    return search(joint, wanted) if form is None and joint is not None else form


def _in_region(plant: Plant, sensor: VirtualSensor, form: Form, box: Box) -> Certificate:
    bounds, region = slope_bounds(plant, sensor, *box), _region(plant, sensor, *box)
    where = together((plant.inputs[j], low, high) if i is None else sum_place(
        {name: float(factor) for name, factor in zip(plant.states, plant.G[i][j]) if factor},
        low, high) for i, j, low, high in region)
    reason = 'it holds only while plant and estimate both keep within these limits'
    if not np.isfinite(form.bound):
        reason += steep_readings(plant, sensor, bounds)
    return replace(
        _certificate('region', form, sensor, bounds, region, _said(sensor, reason)),
        uncovered=uncovered(plant, sensor, box), where=where)


def _ranged(plant: Plant, sensor: VirtualSensor) -> bool:
    # whether the plant gives a range of what its feeding terms hold
    return bool(np.isfinite(plant.ranges[used_states(plant, sensor)]).any()
                or np.isfinite(plant.input_range[used_inputs(sensor)]).any())


def _runs_away(plant: Plant, sensor: VirtualSensor) -> str:
    return runaway(sensor, slope_bounds(plant, sensor, *_unlimited(plant)))


def _linear(plant: Plant, sensor: VirtualSensor, error: ErrorSystem) -> Certificate | None:
    """Certify an error that no nonlinear term feeds: by its spectrum, without a solver."""
    bounds = slope_bounds(plant, sensor, *_unlimited(plant))
    proved = None if lasting(error.N, error.sample_time)[1].any() else lyapunov(error)
    if proved is None:
        return None
    reason = 'its error is linear and dies out from every start'
    if len(error.loose.p.T) or len(error.rising.p.T):
        inside = slope_bounds(plant, sensor, plant.ranges, plant.input_range)
        near = error_system(sensor, inside)
        if len(near.loose.p.T) or len(near.rising.p.T):
            reason += steep_readings(plant, sensor, inside)
        else:
            error = near
            reason += BOUND_ON_RANGES
    form = Form(*proved, peak_bound(error, *proved))
    return _certificate('global', form, sensor, bounds, (), _said(sensor, reason))


# ------------------------------------------------------------------------------- the boxes

def _unlimited(plant: Plant) -> tuple[np.ndarray, np.ndarray]:
    # boxes of states (n, 2) and inputs (m, 2) that say nothing
    line = np.array([-np.inf, np.inf])
    return np.tile(line, (len(plant.states), 1)), np.tile(line, (len(plant.inputs), 1))


def _boxes(plant: Plant, sensors: Sequence[VirtualSensor]) -> list[Box]:
    """Return the boxes about the operating point that are tried, the largest first."""
    states = sorted({j for sensor in sensors for j in used_states(plant, sensor)})
    inputs = sorted({j for sensor in sensors for j in used_inputs(sensor)})

    def size(box: Box) -> float:
        return float(np.log(np.ptp(np.vstack([box[0][states], box[1][inputs]]), axis=1)).sum())

    return sorted((_box(plant, reach, wide) for reach in REACHES for wide in (True, False)),
                  key=size, reverse=True)


def _box(plant: Plant, reach: float, wide: bool = False) -> Box:
    """
    Surround the operating point, each state by so many times its own reach, in the ranges.

    wide: or its own operating value, where that is larger.
    """
    def around(point: np.ndarray, ranges: np.ndarray, size: np.ndarray) -> np.ndarray:
        if wide:
            size = np.maximum(size, np.abs(point))
        low = np.maximum(point - reach * size, ranges[:, 0])
        high = np.minimum(point + reach * size, ranges[:, 1])
        outside = low > high  # the operating point lies outside of the ranges
        return np.where(outside[:, None], ranges, np.stack([low, high], axis=1))

    states, inputs = reaches(plant)
    return (around(plant.operating_point, plant.ranges, states),
            around(plant.operating_input, plant.input_range, inputs))


# ------------------------------------------------------------------------- what is handed out

def _region(plant: Plant, sensor: VirtualSensor, states: np.ndarray,
            inputs: np.ndarray) -> tuple[Limit, ...]:
    """List the boxes of the arguments, and of the inputs where those are confined too."""
    found: dict[bytes, Limit] = {}  # equal arguments once
    for i in feeding_terms(sensor):
        for j, (row, (low, high)) in enumerate(zip(plant.G[i], image(plant.G[i], states))):
            found.setdefault((row + 0.0).tobytes(), Limit(i, j, float(low), float(high)))
    return (*found.values(), *(Limit(None, j, *map(float, inputs[j])) for j in used_inputs(sensor)
                               if np.isfinite(inputs[j]).any()))


def _certificate(status: str, form: Form, sensor: VirtualSensor, bounds: Bounds,
                 region: tuple[Limit, ...], reason: str) -> Certificate:
    # V in units of the channel: |Cv e|^2 <= e' S e
    size = max(float(np.linalg.norm(solve_triangular(form.L, row, lower=True)))
               for row in sensor.Cv)
    L = form.L * (size or 1.0)
    return Certificate(status, float(form.rate), float(form.bound * (1 + 1e-9)), L @ L.T, region,
                       lipschitz(sensor, bounds), reason)


def _none(sensor: VirtualSensor, bounds: Bounds, reason: str, left: str = '') -> Certificate:
    return Certificate('none', 0.0, np.inf, np.zeros_like(sensor.N), (),
                       lipschitz(sensor, bounds), reason, left)


def _said(sensor: VirtualSensor, reason: str) -> str:
    if sensor.grade == 'bounded':
        reason += '; what the unknown inputs do to it comes on top'
    return reason


def _shown(value: complex) -> str:
    return f'{value.real:.4g}' if value.imag == 0 else f'{value.real:.4g}{value.imag:+.4g}i'


def _largest_row_sum(Q: np.ndarray) -> float:
    return float(np.abs(Q).sum(axis=1).max(initial=0.0))
