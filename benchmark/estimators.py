"""
What a virtual sensor says and costs beside full-order filters that are told the same readings.

The truth is simulated: a plant with process noise, sensors with noise at 100 Hz, commands held at
20 Hz, one sensor failed from the beginning. Each estimator starts from the plant's own guess,
takes the same readings and is judged by its RMSE on the failed sensor once it has converged. The
unknown disturbance comes through the plant's D.

Ours: the designer's virtual sensor of its default settings, through the bank, as it runs on the
machine; and its bare arrays in numpy, without stamps and checks.

The peers are filterpy's KalmanFilter, ExtendedKalmanFilter and UnscentedKalmanFilter over all
states. They know the model, both noises and the start. Their model is stepped by Euler's rule,
which is the cheapest for them and costs them nothing: at 100 Hz Runge-Kutta gave the same RMSE.
The Kalman filter is linear: each nonlinear term is the straight line that fits it best on the
tuning run. Friction is tanh(w/0.01) for the other two, the best of several widths.
Their process noise is s Q + q D D', Q the true one: q is 0 where they are not told of the
disturbance; else q, then s are chosen for the least RMSE on a run of another seed, with other
noises, another start and another disturbance of the same kind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.linalg import expm

from benchmark.row import Row
from vsensor_ros import design, load_plant, Plant
from vsensor_ros.bank import Bank
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import Design, VirtualSensor
from vsensor_ros.simulate import simulate

CONFIG = Path(__file__).resolve().parents[1] / 'config'
RATE = 100.0  # Hz
HELD = 5  # steps for which a command and the process noise are held
SECONDS = 40.0  # of the run that is judged, and of the one for tuning
CONVERGED = 0.3  # of the run
SCALES = (1.0, 1e1, 1e2, 1e3)  # of Q
STRENGTHS = (1e-2, 1e-1, 1.0, 1e1, 1e2, 1e4)  # of D D', (unit of rho)^2 s

Step = Callable[[np.ndarray, np.ndarray, np.ndarray], float]  # y now, u before, u now -> estimate


@dataclass(frozen=True, eq=False)
class Case:
    """A plant, the sensor that failed, and what acts on the plant."""

    label: str  # the failed sensor, for people
    plant: Plant
    failed: str
    inputs: Callable[[np.ndarray], np.ndarray]  # of t (T,), as (m, T)
    spread: np.ndarray  # (n,), standard deviation of the true start about the guess
    unit: str  # of what it measures
    rho: float  # size of the unknown disturbance [unit of rho]; 0: only run without
    disturbance: str  # the same for people

    @property
    def healthy(self) -> list[int]:
        """Return the rows of C that are still read."""
        return [i for i, name in enumerate(self.plant.sensors) if name != self.failed]


@dataclass(frozen=True, eq=False)
class Run:
    """What happened, at the T steps of one run."""

    x: np.ndarray  # (T, n)
    u: np.ndarray  # (T, m), held to the next step
    y: np.ndarray  # (T, l), with noise
    truth: np.ndarray  # (T,), of the failed sensor


@dataclass(frozen=True, eq=False)
class Model:
    """What the peers know: x' = A x + B u + P psi(G x), y0 = C0 x, v = V x."""

    A: np.ndarray  # without formal addends
    B: np.ndarray
    P: np.ndarray
    G: np.ndarray  # (q, n)
    psi: Callable[[np.ndarray], np.ndarray]
    slope: Callable[[np.ndarray], np.ndarray]
    C0: np.ndarray
    V: np.ndarray  # (n,)
    R: np.ndarray
    start: np.ndarray
    P0: np.ndarray

    def step(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the state one period later."""
        return x + (self.A @ x + self.B @ u + self.P @ self.psi(self.G @ x)) / RATE

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        """Return the derivative of step by x."""
        return np.eye(len(x)) + (self.A + self.P * self.slope(self.G @ x) @ self.G) / RATE


def cases() -> list[Case]:
    """Return what is run: two levels of the three-tank rig and the velocity of the servo."""
    def flows(t: np.ndarray) -> np.ndarray:
        return np.array([0.9 + 0.5 * np.sin(0.5 * t) + 0.3 * np.sin(1.3 * t),
                         0.5 + 0.4 * np.sin(0.8 * t + 1.0)])

    def voltage(t: np.ndarray) -> np.ndarray:
        return 3.0 * np.sin(0.9 * t + 3.6)[None] + 2.0 * np.sin(0.37 * t + 1.5)

    tank, servo = (load_plant(CONFIG / name / 'plant.yaml') for name in ('three_tank', 'servo'))
    levels, motion = np.array([0.5, 0.5, 0.3]), np.array([0.2, 0.5, 0.2])
    return [
        Case('level2 of three tanks', _known(tank, 0.01, 0.02), 'y1', flows, levels, 'm', 0.0,
             ''),
        Case('level3 of three tanks', _known(tank, 0.01, 0.02, 'inflow'), 'y2', flows, levels, 'm',
             1.5, 'an unknown inflow, up to 1.5 m^3/s'),
        Case('velocity of the servo', _known(servo, 0.01, 0.05), 'y2', voltage, motion, 'rad/s',
             5.0, 'an unknown rate, up to 5 rad/s'),
    ]


def _known(plant: Plant, noise: float, process_noise: float, inflow: str = '') -> Plant:
    """Add noises (of every sensor; of every state, per sqrt(s)), and an inflow into state 1."""
    return Plant.from_matrices(
        plant.A, plant.B, plant.C, D=np.eye(len(plant.A), 1) if inflow else plant.D,
        P=plant.P, G=plant.G, nonlinearities=plant.terms, states=plant.states,
        inputs=plant.inputs, sensors=plant.sensors,
        disturbances=(inflow,) if inflow else plant.disturbances, units=None,
        initial=plant.initial, noise=[noise] * len(plant.C),
        process_noise=[process_noise] * len(plant.A), operating_point=plant.operating_point,
        operating_input=plant.operating_input, name=plant.name)


def run(case: Case, disturbed: bool, seed: int, seconds: float) -> Run:
    """Simulate a case; one seed gives one start, one disturbance and one noise."""
    plant, rng = case.plant, np.random.default_rng(seed)
    n, d = plant.D.shape
    t = np.arange(round(seconds * RATE) + 1) / RATE
    held = np.arange(len(t)) // HELD
    start = plant.initial + case.spread * rng.uniform(-1.0, 1.0, n)
    shaking = rng.standard_normal((held[-1] + 1, n))[held] * plant.process_noise * np.sqrt(
        RATE / HELD)
    phase, speed = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(2.0, 4.0)
    rho = case.rho * disturbed * np.sin(speed * t[held * HELD] + phase)
    if plant.disturbances == ('inflow',):
        rho = np.abs(rho)
    u = case.inputs(t[held * HELD]).T
    shaken = Plant.from_matrices(
        plant.A, plant.B, plant.C, D=np.hstack((plant.D, np.eye(n))), P=plant.P, G=plant.G,
        nonlinearities=plant.terms, inputs=plant.inputs)
    x = simulate(shaken, t, u, np.hstack((np.tile(rho[:, None], d), shaking)), start)
    y = x @ plant.C.T
    return Run(x, u, y + plant.noise * rng.standard_normal(y.shape),
               y[:, plant.sensors.index(case.failed)])


def model(case: Case) -> Model:
    """Write out what the peers are told."""
    plant = case.plant
    G = np.vstack(plant.G)
    psi, slope = FUNCTIONS[plant.terms[0].text]
    return Model(plant.A - plant.P * _addends(plant.terms) @ G, plant.B, plant.P, G, psi, slope,
                 plant.C[case.healthy], plant.C[plant.sensors.index(case.failed)],
                 np.diag(plant.noise[case.healthy]**2), plant.initial,
                 np.diag(case.spread**2 / 3.0))


def _addends(terms: Sequence[NonlinearTerm]) -> np.ndarray:
    return np.array([float(term.slope[0]) for term in terms])


def _sqrt(w: np.ndarray) -> np.ndarray:
    return np.sign(w) * np.sqrt(np.abs(w))


def _sqrt_slope(w: np.ndarray) -> np.ndarray:
    return 0.5 / np.sqrt(np.maximum(np.abs(w), 1e-3))


def _friction(w: np.ndarray) -> np.ndarray:
    return np.tanh(w / 0.01)


def _friction_slope(w: np.ndarray) -> np.ndarray:
    return (1.0 - np.tanh(w / 0.01)**2) / 0.01


FUNCTIONS = {'sqrt(w1)': (_sqrt, _sqrt_slope), 'sign(w1)': (_friction, _friction_slope)}


def kalman(known: Model, tuning: Run, Q: np.ndarray) -> Step:
    """Return filterpy's linear Kalman filter."""
    from filterpy.kalman import KalmanFilter
    n, m = known.B.shape
    w = known.G @ tuning.x.T
    lines = [np.polyfit(arguments, values, 1) for arguments, values in zip(w, known.psi(w))]
    b, a = np.transpose(lines)
    system = np.zeros((n + m + 1,) * 2)
    system[:n] = np.column_stack((known.A + known.P * b @ known.G, known.B, known.P @ a))
    held = expm(system / RATE)[:n]
    f = KalmanFilter(n, len(known.C0), m + 1)
    f.x, f.P, f.Q, f.R, f.H = known.start[:, None].copy(), known.P0, Q, known.R, known.C0
    f.F, f.B = held[:, :n], held[:, n:]

    def step(y: np.ndarray, before: np.ndarray, now: np.ndarray) -> float:
        f.predict(np.append(before, 1.0)[:, None])
        f.update(y[:, None])
        return float(known.V @ f.x[:, 0])
    return step


def extended(known: Model, tuning: Run, Q: np.ndarray) -> Step:
    """Return filterpy's extended Kalman filter."""
    from filterpy.kalman import ExtendedKalmanFilter

    class Filter(ExtendedKalmanFilter):
        def predict_x(self, u: np.ndarray) -> None:
            self.F = known.jacobian(self.x)
            self.x = known.step(self.x, u)

    f = Filter(len(known.A), len(known.C0))
    f.x, f.P, f.Q, f.R = known.start, known.P0, Q, known.R

    def step(y: np.ndarray, before: np.ndarray, now: np.ndarray) -> float:
        f.predict(before)
        f.update(y, lambda x: known.C0, lambda x: known.C0 @ x)
        return float(known.V @ f.x)
    return step


def unscented(known: Model, tuning: Run, Q: np.ndarray) -> Step:
    """Return filterpy's unscented Kalman filter, with Merwe's points at alpha = 1."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
    n = len(known.A)
    f = UnscentedKalmanFilter(
        n, len(known.C0), 1.0 / RATE, hx=lambda x: known.C0 @ x,
        fx=lambda x, h, u: known.step(x, u), points=MerweScaledSigmaPoints(n, 1.0, 2.0, 0.0))
    f.x, f.P, f.Q, f.R = known.start, known.P0, Q, known.R

    def step(y: np.ndarray, before: np.ndarray, now: np.ndarray) -> float:
        f.predict(u=before)
        f.update(y)
        return float(known.V @ f.x)
    return step


Peer = Callable[[Model, Run, np.ndarray], Step]  # with this process noise
PEERS: dict[str, Peer] = {'linear KF': kalman, 'EKF': extended, 'UKF': unscented}


def through_bank(case: Case, made: Design) -> Step:
    """Return the virtual sensor as it runs on the machine."""
    bank, names = Bank(made, RATE), case.plant.inputs
    healthy = [case.plant.sensors[i] for i in case.healthy]
    now = 0

    def step(y: np.ndarray, before: np.ndarray, u: np.ndarray) -> float:
        nonlocal now
        now += bank.period
        for name, value in (*zip(healthy, y.tolist()), *zip(names, u.tolist())):
            bank.take(name, now, value)
        bank.advance(now)
        estimate = bank.estimate((case.failed,), case.failed)
        return float('nan') if estimate is None else estimate
    return step


def bare(v: VirtualSensor) -> Step:
    """Return the same virtual sensor as one writes it with numpy, explicit and without checks."""
    k, active = v.order, list(v.active)
    gains = np.hstack((v.J, v.B, v.P[:, active]))
    system = np.zeros((k + gains.shape[1],) * 2)
    system[:k] = np.hstack((v.N, gains))
    E, F, H, W = np.split(expm(system / RATE)[:k], np.cumsum([k, *v.J.shape[1:], *v.B.shape[1:]]),
                          axis=1)
    Gz = np.vstack([v.Gz[i] for i in active])
    Gy = np.vstack([v.Gy[i] for i in active])
    addends = _addends([v.terms[i] for i in active])
    psi = np.sign if v.terms[0].text == 'sign(w1)' else _sqrt
    z, last = v.z0, np.zeros(len(v.healthy))
    cold = True

    def step(y: np.ndarray, before: np.ndarray, now: np.ndarray) -> float:
        nonlocal z, last, cold
        if cold:
            z, cold = v.z0 + v.z0_gain @ y, False
        else:
            w = Gz @ z + Gy @ last
            z = E @ z + F @ (0.5 * (last + y)) + H @ before + W @ (psi(w) - addends * w)
        last = y
        return float((v.Cv @ z + v.Q @ y)[0])
    return step


def follow(case: Case, told: Run, steps: Sequence[Step]) -> tuple[np.ndarray, np.ndarray]:
    """Let all take the same run, in turns; return each one's RMSE and median time a step [s]."""
    y = told.y[:, case.healthy]
    estimates, spent = np.empty((2, len(steps), len(y) - 1))
    for k in range(1, len(y)):
        for i, step in enumerate(steps):
            begin = perf_counter()
            estimates[i, k - 1] = step(y[k], told.u[k - 1], told.u[k])
            spent[i, k - 1] = perf_counter() - begin
    late = slice(int(CONVERGED * estimates.shape[1]), None)
    errors = (estimates - told.truth[1:])[:, late]
    return np.sqrt(np.mean(errors**2, axis=1)), np.median(spent, axis=1)


def tuned(case: Case, make: Peer, told: bool, tuning: Run) -> Callable[[], Step]:
    """Return how to start a peer with the process noise that serves it best on the tuning run."""
    plant, known = case.plant, model(case)

    def start(s: float, q: float) -> Step:
        return make(known, tuning, (s * np.diag(plant.process_noise**2)
                                    + q * plant.D @ plant.D.T) / RATE)

    def error(s: float, q: float) -> float:
        try:
            return float(follow(case, tuning, [start(s, q)])[0][0])
        except np.linalg.LinAlgError:  # the UKF's covariance is no longer one
            return np.inf

    q = min(STRENGTHS, key=lambda q: error(1.0, q)) if told else 0.0
    s = min(SCALES, key=lambda s: error(s, q))
    return lambda: start(s, q)


def compare(case: Case, seconds: float,
            progress: Callable[[str], None]) -> tuple[list[Row], list[Row]]:
    """Compare the errors and the times of one case."""
    made = design(case.plant, [(case.failed,)])
    v = made[(case.failed,), case.failed]
    if not isinstance(v, VirtualSensor):
        raise AssertionError(f'{case.label}: {v.reason}')
    rows: list[Row] = []

    def peers(told: bool) -> list[Callable[[], Step]]:
        progress(f'estimators for {case.label}: tuning the peers')
        tuning = run(case, told, 1, seconds)
        return [tuned(case, make, told, tuning) for make in PEERS.values()]

    def beside(starts: Sequence[Callable[[], Step]], disturbed: bool, what: str) -> np.ndarray:
        progress(f'estimators for {case.label}: {what}')
        steps = [through_bank(case, made), bare(v), *(start() for start in starts)]
        rmse, spent = follow(case, run(case, disturbed, 2, seconds), steps)
        rows.extend(Row(f'RMSE on {case.label}, {what}', name, case.unit, rmse[0], value)
                    for name, value in zip(('its bare arrays', *PEERS), rmse[1:]))
        return 1e6 * spent

    untold = peers(False)
    spent = beside(untold, False, 'nothing unknown; peers: filterpy, all states')
    if case.rho:
        beside(peers(True), True, f'{case.disturbance}; peers tuned for it')
        beside(untold, True, f'{case.disturbance}; peers not told of it')
    group = f'one step for {case.label}, virtual sensor of order {v.order}; peers: as above'
    return rows, [Row(group, f'{label} / {name}', 'us', ours, value)
                  for label, ours in (('bare arrays', spent[1]), ('whole bank', spent[0]))
                  for name, value in zip(PEERS, spent[2:])]


def measure(progress: Callable[[str], None] = lambda text: None, seconds: float = SECONDS,
            chosen: Sequence[int] = (0, 1, 2)) -> list[Row]:
    """Compare the chosen cases: all errors first, then all times."""
    errors, costs = zip(*(compare(case, seconds, progress)
                          for case in (cases()[i] for i in chosen)))
    return [row for rows in errors + costs for row in rows]
