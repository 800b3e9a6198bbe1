"""
The least sensitive virtual sensor where none can be decoupled from all unknown inputs.

As many unknown inputs as can be are decoupled exactly; the others disturb the estimate, and how
much is stated: the peak over frequency of what they do to the error. Candidates are Kalman filters
for which these inputs are white noise of growing intensity (H2), filters that guard against the
worst input (H-infinity), and smaller observers whose free gain is descended on. The least
disturbed is taken whose noise stays within NOISE_FACTOR of the quietest.
Source: method 2 (composition, SVD fallback) and 3.6; D section 3.2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from decimal import Context, ROUND_CEILING

import numpy as np
from scipy.linalg import block_diag, LinAlgError, solve_continuous_are, solve_discrete_are

from vsensor_ros.designer import invariant_spaces
from vsensor_ros.designer.candidates import Contender, Ground, grounds, judged, static
from vsensor_ros.designer.canonical import identification_rows
from vsensor_ros.designer.existence import avoidable_signs, examine, Existence
from vsensor_ros.designer.gain import peak, peak_on_grid
from vsensor_ros.designer.noise import (
    Filter,
    kalman,
    mean_rate,
    noise_model,
    NoiseModel,
    usual_decay,
)
from vsensor_ros.designer.observer import (
    build,
    Candidate,
    close_loop,
    knows_arguments,
    linearised,
)
from vsensor_ros.designer.order_noise import climb, SLUGGISH
from vsensor_ros.designer.papers import with_residual
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.quotient import Quotient
from vsensor_ros.designer.stabilise import decay_of
from vsensor_ros.observers import Noise, Refusal, Rung, VirtualSensor
from vsensor_ros.plant import Plant

NOISE_FACTOR = 4.0  # the quietest's noise may grow so much for less disturbance
EXACT = 1.2  # decoupling from one input may raise what the others do by this factor
WORTH = 1.2  # the least order is taken whose disturbance is within this factor of the least
ALIKE = 1.02  # within this factor of the least disturbance, the quietest is taken
INTENSITIES = 10.0 ** np.arange(-1, 7)  # of unknown inputs, against the process noise
BISECTIONS = 4  # of the intensity, to the limit of the noise
GUARDS = 5  # bisections of the bound that an H-infinity filter is made for
CLOSURES = 4  # closed subspaces tried
LARGEST_HINTED = 60  # states of a plant for which a refusal names the alternative


@dataclass(frozen=True, eq=False)
class Disturbed(NoiseModel):
    """
    Noise together with unknown inputs that are not decoupled.

    A filter is made for both; what is then judged is noise and disturbance, each for itself.
    """

    D: np.ndarray  # (n, d), in the scaled coordinates, per unit of rho
    Cd: np.ndarray  # (l0, d)
    Vd: np.ndarray  # (p, d)
    v_size: np.ndarray  # (p,)
    weight: np.ndarray  # (d,) intensity that filters are made for
    limit: float  # of the noise, in the unit of the channel

    def drives(self, known):  # type: ignore[no-untyped-def]
        """Append the unknown inputs to the columns of the noise."""
        B, D = super().drives(known)
        return (np.hstack([B, (known.Phi @ self.D - known.J @ self.Cd) * self.weight]),
                np.hstack([D, known.R @ self.Cd * self.weight]))

    def variance(self, N: np.ndarray, B: np.ndarray, Cv: np.ndarray, Q: np.ndarray) -> float:
        """
        Return what is to be small: with unknown inputs in B not the noise but their gain, squared.

        Noise beyond the limit counts as if it were disturbance.
        """
        noisy = len(self.process) + len(self.reading)
        if B.shape[1] == noisy:
            return super().variance(N, B, Cv, Q)
        size = self.v_size[:, None]
        noise = super().variance(N, B[:, :noisy], size * Cv, size * Q)
        gain = peak_on_grid(N, B[:, noisy:] / self.weight, size * Cv,
                        size * (self.Vd - Q @ self.Cd), self.sample_time)[0]
        return gain**2 * max(1.0, noise / self.limit**2) ** 4

    def gain(self, candidate: Candidate) -> float:
        """Return the peak over a grid of frequencies of the unknown inputs' gain."""
        size = self.v_size[:, None]
        return peak_on_grid(candidate.N, candidate.Phi @ self.D - candidate.J @ self.Cd,
                        size * candidate.Cv, size * (self.Vd - candidate.Q @ self.Cd),
                        self.sample_time)[0]


@dataclass(frozen=True, eq=False)
class Relaxed:
    """A problem with only those unknown inputs left that can be decoupled together."""

    original: Problem
    problem: Problem
    existence: Existence
    avoid: frozenset[int]  # nonlinear terms to be decoupled from besides
    kept: tuple[int, ...]  # unknown inputs that disturb
    floor: float  # noise of the quietest, when nothing is decoupled
    least: float  # disturbance of the least disturbed Kalman filter
    order: int  # of that filter
    quick: bool  # whether that filter is fast enough to be taken

    @property
    def limit(self) -> float:
        """Return the noise that is allowed, in the unit of the channel."""
        return NOISE_FACTOR * self.floor

    def noise(self, plain: NoiseModel, intensity: float) -> Disturbed:
        """Return the noise of the problem together with the unknown inputs that disturb."""
        problem, plant, kept = self.problem, self.original.plant, list(self.kept)
        rows = [plant.sensors.index(s) for s in problem.healthy]
        D = plant.D[:, kept] / problem.scale[:, None]
        Cd = plant.Cd[rows][:, kept] / problem.y0_size[:, None]
        Vd = self.original.wanted[2][:, kept] / problem.v_size[:, None]
        size = np.where(D.any(axis=0), np.linalg.norm(D, axis=0),
                        np.linalg.norm(np.vstack([Cd, Vd]), axis=0))
        size = np.where(size > 0, size, 1.0)
        rate = mean_rate(problem) * (1.0 if plain.sample_time is None else plain.sample_time)
        unit = max(_mean_square(plain.process), _mean_square(plain.reading) * np.sqrt(2 * rate))
        return Disturbed(plain.reading, plain.process, plain.interval, plain.sample_time,
                         plain.assumed, D, Cd, Vd, problem.v_size, intensity * unit / size,
                         self.limit)


def least_sensitive(problem: Problem, prefer: str, decay: float | None,
                    ) -> VirtualSensor | None:
    """
    Return the virtual sensor that unknown inputs disturb least; None where none is stable.

    For a problem that has no decoupled one. ``prefer``: 'quiet' takes the least order that is
    disturbed within WORTH of the least, 'least' the least order there is. Of several rows of a
    functional those that can be decoupled are (method 2, Composition).
    """
    relaxed = relax(problem)
    if relaxed is None:
        return None
    composed = _composed(problem, prefer, decay)
    return composed or _chosen(relaxed, prefer, decay)


def alternative(problem: Problem) -> str:
    """Say in one sentence what ``least_sensitive`` has to offer; '' if nothing, or if unknown."""
    if len(problem.A) > LARGEST_HINTED:
        return ''
    relaxed = relax(problem)
    if relaxed is None:
        return ''
    order, gain = relaxed.order, ALIKE * WORTH * relaxed.least
    if not relaxed.quick:  # whether its filter is fast enough to be taken is known when it is
        sensor = _chosen(relaxed, 'quiet', None)
        if sensor is None:
            return ''
        order, gain = sensor.order, sensor.disturbance_gain
    return (f'not decoupled, but bounded: order {order} or less with '
            f'{_at_most(problem, relaxed.kept, gain)} (bounded=True, or --bounded)')


def relax(problem: Problem) -> Relaxed | None:
    """
    Give up decoupling from as few unknown inputs as leave a stable virtual sensor.

    They are decoupled one after the other, the one that would disturb most first, each if it can
    be together with those before, and if the others do not disturb much more for it. None when
    none exists even without decoupling.
    """
    plant = problem.plant
    several = range(len(plant.disturbances))
    best = _relaxed(problem, (), None) if several else None
    if best is None or len(several) == 1:
        return best
    ground = _grounds(best, None)[0]
    noise = best.noise(ground.noise, 1.0)
    gains = [min((replace(noise, D=noise.D[:, [i]], Cd=noise.Cd[:, [i]], Vd=noise.Vd[:, [i]]).gain(
        c.candidate) for c in _filters(ground, [ground.filter])), default=0.0) for i in several]
    floor, enough = best.floor, EXACT * best.least
    decoupled: tuple[int, ...] = ()
    for i in sorted(several, key=lambda i: -gains[i]):
        chosen = tuple(sorted((*decoupled, i)))
        # that not all can be is known, though it may have taken exact arithmetic to tell
        more = _relaxed(problem, chosen, floor) if len(chosen) < len(several) else None
        if more is not None and more.least <= enough:
            best, decoupled = more, chosen
    return best


def _relaxed(problem: Problem, decoupled: tuple[int, ...], floor: float | None,
             ) -> Relaxed | None:
    """Decouple from some unknown inputs; None when there is no stable virtual sensor then."""
    plant = problem.plant
    columns = list(decoupled)
    easier = _posed(problem, replace(
        plant, disturbances=tuple(plant.disturbances[i] for i in columns),
        D=plant.D[:, columns], Cd=plant.Cd[:, columns]))
    existence = examine(easier)
    if existence.obstruction is not None:
        return None
    signs = avoidable_signs(easier)
    kept = tuple(i for i in range(len(plant.disturbances)) if i not in decoupled)
    relaxed = Relaxed(problem, easier, existence, signs, kept, np.inf, np.inf, 0, False)
    ground = _grounds(relaxed, None)[0]
    swept = _swept(relaxed, ground, floor)
    if not swept:
        return None
    floor = min(c.error for _, c in swept) if floor is None else floor
    inside = [(noise.gain(c.candidate), c.order, c.decay >= SLUGGISH * ground.decay)
              for noise, c in swept if c.error <= NOISE_FACTOR * floor]
    least, order, quick = min(inside, default=(np.inf, 0, False))
    return replace(relaxed, floor=floor, least=least, order=order, quick=quick)


def _posed(problem: Problem, plant: Plant) -> Problem:
    """Pose a problem for another plant of the same states."""
    sensor = problem.channel in plant.sensors
    return pose(plant, problem.fault_set, problem.channel, None if sensor else problem.wanted[0])


def _grounds(relaxed: Relaxed, decay: float | None) -> list[Ground]:
    problem = relaxed.problem
    return grounds(problem, relaxed.existence, relaxed.avoid, noise_model(problem),
                   usual_decay(problem) if decay is None else decay)


def _filters(ground: Ground, found: list[Filter | None], method: str = 'filter',
             ) -> list[Contender]:
    return judged(ground, [invariant_spaces.filter_candidate(ground.known, f, ground.terms)
                           for f in found if f is not None], method)


def _swept(relaxed: Relaxed, ground: Ground, floor: float | None,
           ) -> list[tuple[Disturbed, Contender]]:
    """
    Return Kalman filters for unknown inputs of growing intensity, up to the noise limit.

    ``floor``: the noise that the limit is a multiple of; by default that of the quietest.
    """
    found: list[tuple[Disturbed, Contender]] = []

    def tried(intensity: float) -> bool:
        noise = relaxed.noise(ground.noise, intensity)
        for contender in _filters(ground, [kalman(ground.known, noise)]):
            found.append((noise, contender))
            least = min(c.error for _, c in found) if floor is None else floor
            return contender.error > NOISE_FACTOR * least
        return False

    low = high = 0.0
    for intensity in INTENSITIES:
        if tried(intensity):
            high = intensity
            break
        low = intensity
    if low and high:
        for _ in range(BISECTIONS):
            middle = np.sqrt(low * high)
            low, high = (low, middle) if tried(middle) else (middle, high)
    return found


def _guarded(ground: Ground, noise: Disturbed) -> Iterator[Filter]:
    """
    Yield H-infinity filters, for all noise and disturbance as one input of bounded energy.

    The bound is bisected between nothing and the worst gain of the Kalman filter.
    """
    known, h = ground.known, noise.sample_time
    start = kalman(known, noise)
    if start is None or not len(known.E):
        return
    B, D = noise.drives(known)

    def worst(found: Filter) -> float:
        N = known.A - found.L @ known.E
        if decay_of(np.linalg.eigvals(N), h) <= 0:
            return np.inf
        return peak_on_grid(N, B - found.L @ D, found.Cv, -found.g @ D, h)[0]

    low, high = 0.0, worst(start)
    if not np.isfinite(high):
        return
    for _ in range(GUARDS):
        middle = 0.5 * (low + high)
        found = _h_infinity(known, B, D, start.g, middle, h)
        if found is None or worst(found) > 1.01 * middle:
            low = middle
        else:
            high = middle
            yield found


def _h_infinity(known: Quotient, B: np.ndarray, D: np.ndarray, g: np.ndarray, bound: float,
                sample_time: float | None) -> Filter | None:
    """Return the filter that hands on less than ``bound`` of unit inputs, if there is one."""
    E, v = known.E, known.v
    meter, cross = D @ D.T, B @ D.T
    meter = meter + 1e-12 * np.trace(meter) * np.eye(len(meter))
    both, mixed = np.vstack([E, v]), np.hstack([cross, np.zeros((len(B), len(v)))])
    weights = block_diag(meter, -bound**2 * np.eye(len(v)))
    try:
        if sample_time is None:
            X = solve_continuous_are(known.A.T, both.T, B @ B.T, weights, s=mixed)
            return Filter(np.linalg.solve(meter, (X @ E.T + cross).T).T, v, g, 0.0)
        X = solve_discrete_are(known.A.T, both.T, B @ B.T, weights, s=mixed)
        seen = E @ X @ E.T + meter
        g = np.linalg.solve(seen, E @ X @ v.T).T
        return Filter(np.linalg.solve(seen, (known.A @ X @ E.T + cross).T).T, v - g @ E, g, 0.0)
    except (LinAlgError, ValueError):  # no filter keeps below the bound
        return None


def _contenders(relaxed: Relaxed, ground: Ground) -> list[Contender]:
    """Return all virtual sensors that are tried on one ground."""
    swept = _swept(relaxed, ground, relaxed.floor)
    found = [*_filters(ground, [ground.filter]), *(c for _, c in swept), *static(ground)]
    if not swept:
        return found
    inside = [n for n, c in swept if c.error <= relaxed.limit] or [swept[0][0]]
    last = max(inside, key=lambda n: float(n.weight.max()))
    for factor in (0.1, 1.0, 10.0):
        noise = replace(last, weight=factor * last.weight)
        found += _filters(ground, list(_guarded(ground, noise)), 'H-infinity filter')
    rows = ([ground.known.v] if not len(ground.terms)
            else [ground.known.v, np.vstack([ground.known.v, ground.terms])])
    for outputs in rows:
        for _, space in zip(range(CLOSURES), invariant_spaces.closures(ground.known, outputs)):
            found += judged(ground, invariant_spaces.candidates(
                ground.known, last, space, ground.decay), 'closed subspace')
    return found


def _chosen(relaxed: Relaxed, prefer: str, decay: float | None) -> VirtualSensor | None:
    """Return the least order that is disturbed nearly as little as any."""
    where = _grounds(relaxed, decay)
    pool: list[tuple[float, Contender]] = []
    for ground in where:
        noise = relaxed.noise(ground.noise, 1.0)
        pool += [(noise.gain(c.candidate), c) for c in _contenders(relaxed, ground)
                 if c.error <= relaxed.limit]
    if not pool:
        return None
    enough = SLUGGISH * min(where[0].decay, max(c.decay for _, c in pool))
    pool = [(gain, c) for gain, c in pool if c.decay >= enough]
    rungs = {}
    for k in sorted({c.order for _, c in pool}):
        found_here = _built(relaxed, [f for f in pool if f[1].order == k])
        if found_here is not None:
            rungs[k] = found_here
    if not rungs:
        return None
    least = min(sensor.disturbance_gain for _, sensor in rungs.values())
    k = next(k for k, (_, sensor) in sorted(rungs.items())
             if prefer == 'least' or sensor.disturbance_gain <= WORTH * least)
    contender, sensor = rungs[k]
    ladder = tuple(Rung(order, c.error, v.noise_gain, c.decay, (
        f'{c.method}, unknown inputs times {v.disturbance_gain:.3g}'))
        for order, (c, v) in sorted(rungs.items()))
    return replace(sensor, ladder=ladder,
                   noise=Noise(contender.error, min(relaxed.floor, contender.error),
                               where[0].noise.assumed),
                   method=f'{sensor.method}; {_told(relaxed.original, relaxed.kept, sensor)}')


def _built(relaxed: Relaxed, pool: list[tuple[float, Contender]],
           ) -> tuple[Contender, VirtualSensor] | None:
    """Build the quietest of those that are disturbed least."""
    while pool:
        least = min(gain for gain, _ in pool)
        best = min((f for f in pool if f[0] <= ALIKE * least), key=lambda f: f[1].error)
        sensor = build(relaxed.problem, best[1].candidate, best[1].method)
        if sensor is not None:
            return best[1], graded(relaxed.original, sensor)
        pool = [f for f in pool if f is not best]
    return None


def graded(problem: Problem, sensor: VirtualSensor) -> VirtualSensor:
    """Return a sensor with grade 'bounded' and its disturbance gain."""
    gain, _ = peak(*error_system(problem, sensor), problem.plant.sample_time)
    return replace(sensor, grade='bounded', disturbance_gain=gain)


def error_system(problem: Problem, sensor: VirtualSensor,
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """
    Return ``d e = N e + B rho``, ``v - vhat = C e + D rho``, e = Phi x - z, as (N, B, C, D).

    In the user's units, with the nonlinear terms' slopes at the operating point.
    """
    plant = problem.plant
    Cd = plant.Cd[[plant.sensors.index(s) for s in problem.healthy]]
    N, J = linearised(plant, sensor)
    return (N, sensor.Phi @ plant.D - J @ Cd, sensor.Cv, problem.wanted[2] - sensor.Q @ Cd)


def _composed(problem: Problem, prefer: str, decay: float | None) -> VirtualSensor | None:
    """
    Decouple the rows that can be, and use what they give as readings for the others.

    None where all rows or none can be decoupled. Source: method 2 (Composition), D section 3.2.
    """
    rows, plant = problem.wanted[0], problem.plant
    if len(rows) < 2:
        return None

    def part(chosen: list[int], of: Plant) -> Problem:
        return pose(of, problem.fault_set, problem.channel, rows[chosen])

    clear = [i for i in range(len(rows))
             if examine(part([i], plant)).obstruction is None]
    rest = [i for i in range(len(rows)) if i not in clear]
    if not clear or not rest:
        return None
    exact_problem = part(clear, plant)
    existence = examine(exact_problem)
    if existence.obstruction is not None:
        return None
    signs = avoidable_signs(exact_problem)
    exact = climb(exact_problem, existence, signs, prefer, decay, None)
    if isinstance(exact, Refusal):
        return None
    relaxed = relax(part(rest, _with_readings(plant, exact, exact_problem)))
    below = None if relaxed is None else _chosen(relaxed, prefer, decay)
    if relaxed is None or below is None:
        return None
    sensor = _cascade(plant, exact, below, clear, rest)
    bare = _relaxed(problem, (), None)
    if bare is None:
        return None
    noise = noise_model(bare.problem)
    error = noise.error(bare.problem, _scaled(bare.problem, sensor))
    sensor = graded(problem, sensor)
    several = len(clear) > 1
    return replace(
        sensor, noise=Noise(error, min(error, bare.floor), noise.assumed),
        method=f'{below.method.partition("; ")[0]} below {exact.method}; '
        f'row{"s" * several} {", ".join(str(i + 1) for i in clear)} decoupled from all; '
        f'the others {_told(problem, relaxed.kept, sensor)}')


def _with_readings(plant: Plant, exact: VirtualSensor, problem: Problem) -> Plant:
    """Return the plant with the states z of a decoupled sensor as sensors that cannot fail."""
    k = exact.order
    noise, scaled = noise_model(problem), _scaled(problem, exact)
    B = np.hstack([scaled.Phi * noise.process,
                   -scaled.J * noise.reading * np.sqrt(noise.interval)])
    shown = [np.sqrt(noise.variance(scaled.N, B, row[None, :], np.zeros((1, len(exact.healthy)))))
             for row in np.eye(k)]
    names: list[str] = []
    number = 0
    while len(names) < k:
        number += 1
        if f'z{number}' not in plant.sensors:
            names.append(f'z{number}')
    return replace(
        plant, sensors=(*plant.sensors, *names), C=np.vstack([plant.C, exact.Phi]),
        Cu=np.vstack([plant.Cu, np.zeros((k, plant.Cu.shape[1]))]),
        Cd=np.vstack([plant.Cd, np.zeros((k, plant.Cd.shape[1]))]),
        noise=np.concatenate([plant.noise, shown]))


def _cascade(plant: Plant, exact: VirtualSensor, below: VirtualSensor, clear: list[int],
             rest: list[int]) -> VirtualSensor:
    """Join a decoupled sensor with one that reads its z, after y0, as further readings."""
    k, l0, s = exact.order, len(exact.healthy), below.order

    def apart(M: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return M[:, :l0], M[:, l0:]

    J, Jz = apart(below.J)
    Q, Qz = apart(below.Q)
    gain, gain_z = apart(below.z0_gain)
    N = np.block([[exact.N, np.zeros((k, s))], [Jz, below.N]])
    Cv, whole_Q, Qu = (np.zeros((len(clear) + len(rest), width))
                       for width in (k + s, l0, len(plant.inputs)))
    Cv[clear, :k], whole_Q[clear], Qu[clear] = exact.Cv, exact.Q, exact.Qu
    Cv[rest] = np.hstack([Qz, below.Cv])
    whole_Q[rest], Qu[rest] = Q, below.Qu
    J = np.vstack([exact.J, J])
    Gz, Gy, Gu = [], [], []
    for i in range(len(plant.terms)):
        if i in exact.active:  # what is decoupled must not look at what is not
            Gz.append(np.hstack([exact.Gz[i], np.zeros((len(exact.Gz[i]), s))]))
            Gy.append(exact.Gy[i])
            Gu.append(exact.Gu[i])
        else:
            gy, gz = apart(below.Gy[i])
            Gz.append(np.hstack([gz, below.Gz[i]]))
            Gy.append(gy)
            Gu.append(below.Gu[i])
    eigenvalues = np.concatenate([exact.eigenvalues, below.eigenvalues])
    return replace(
        below, healthy=exact.healthy, Phi=np.vstack([exact.Phi, below.Phi]), N=N, J=J,
        B=np.vstack([exact.B, below.B]), P=np.vstack([exact.P, below.P]), Cv=Cv, Q=whole_Q,
        Gz=tuple(Gz), Gy=tuple(Gy), Gu=tuple(Gu), Qu=Qu,
        z0=np.concatenate([exact.z0, below.z0 + gain_z @ exact.z0]),
        z0_gain=np.vstack([exact.z0_gain, gain + gain_z @ exact.z0_gain]),
        eigenvalues=eigenvalues[np.lexsort([eigenvalues.imag, eigenvalues.real])],
        noise_gain=peak(N, J, Cv, whole_Q, plant.sample_time)[0], ladder=())


def _scaled(problem: Problem, sensor: VirtualSensor) -> Candidate:
    """Return a virtual sensor in the scaled coordinates of its problem."""
    size = problem.v_size[:, None]
    return Candidate(sensor.Phi * problem.scale, sensor.N, sensor.J * problem.y0_size,
                     sensor.Cv / size, sensor.Q * problem.y0_size / size)


def singular(problem: Problem) -> VirtualSensor | Refusal:
    """
    Return what the papers' method of singular values finds.

    Among the identification canonical forms of order k = 1, 2, .. without decoupling, x Nw, that
    of least |x Nw Dk| for |x| = 1: it depends on units, and neither v nor stability is asked for,
    so that it is left to chance whether v can be had of it. Source: method 2 (SVD fallback).
    """
    relaxed = _relaxed(problem, (), None)
    if relaxed is None:
        return Refusal(problem.channel, problem.fault_set, examine(problem).obstruction or '')
    easier = relaxed.problem
    D = problem.plant.D / easier.scale[:, None]
    for k in range(1, len(easier.A) + 1):
        solutions = [Phi for Phi, _ in identification_rows(
            easier.A, easier.C_star, np.zeros((len(easier.A), 0)), k)]
        if not solutions:
            continue
        disturbed = np.array([(Phi @ D).ravel() for Phi in solutions])
        x = np.linalg.svd(disturbed)[0][:, -1]
        Phi = np.einsum('s,skn->kn', x, np.array(solutions))
        candidate = close_loop(easier, Phi) if knows_arguments(easier, Phi) else None
        if candidate is None:
            continue
        found = [sensor for c in (candidate, *with_residual(easier, candidate))
                 if (sensor := build(easier, c, 'svd')) is not None]
        if found:
            sensor = min((graded(problem, s) for s in found), key=lambda s: s.disturbance_gain)
            return replace(sensor, method=f'svd; {_told(problem, relaxed.kept, sensor)}')
    return Refusal(problem.channel, problem.fault_set,
                   'no design of the method of singular values gives it and is stable')


def _told(problem: Problem, kept: tuple[int, ...], sensor: VirtualSensor) -> str:
    """Say from what a sensor is decoupled, and what the other unknown inputs do to it."""
    plant = problem.plant
    unit = _unit(problem)
    N, B, C, D = error_system(problem, sensor)
    parts = []
    for i in kept:
        gain, at = peak(N, B[:, [i]], C, D[:, [i]], plant.sample_time)
        steady = np.eye(len(N)) - N if plant.sample_time is not None else -N
        constant = float(np.linalg.norm(C @ np.linalg.solve(steady, B[:, [i]]) + D[:, [i]]))
        parts.append(f'{plant.disturbances[i]} (at most {gain:.3g}{unit} per unit, at '
                     f'{at:.3g} rad/s; {constant:.3g}{unit} when constant)')
    free = [name for i, name in enumerate(plant.disturbances) if i not in kept]
    return (f'decoupled from {", ".join(free)}, ' if free else '') + (
        f'not decoupled from {", ".join(parts)}')


def _at_most(problem: Problem, kept: tuple[int, ...], gain: float) -> str:
    names = [problem.plant.disturbances[i] for i in kept]
    above = float(Context(prec=2, rounding=ROUND_CEILING).create_decimal(gain))
    return (f'at most {above:.2g}{_unit(problem)} per unit of '
            f'{" and ".join(names)}{" together" * (len(names) > 1)}'
            + ' near the operating point' * bool(problem.plant.terms))


def _unit(problem: Problem) -> str:
    unit = problem.plant.units.get(problem.channel, '')
    return f' {unit}' if unit else ''


def _mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
