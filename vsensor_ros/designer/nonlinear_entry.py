"""
What a design holds of an observer that the algebra of functions found.

To what it says this adds what the run needs: by which readings it is tracked, where it starts, and
what noise does to it, by slopes at the operating point and over the declared ranges.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math

import numpy as np
from scipy.linalg import expm

from vsensor_ros.designer.algebra.answer import CERTIFIED, Observer, TEMPORARY
from vsensor_ros.designer.algebra.derivative import derivative, times
from vsensor_ros.designer.natural_size import RELATIVE
from vsensor_ros.designer.noise import INTERVAL, noise_model
from vsensor_ros.designer.nonlinear_limits import conditions, sample, Sampled, useful
from vsensor_ros.designer.problem import pose
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import (
    Apply,
    fold,
    Name,
    names,
    Node,
    Number,
    parse,
    substitute,
    to_text,
)
from vsensor_ros.observers import NonlinearSensor
from vsensor_ros.observers.kinds.nonlinear.batch import LEFT
from vsensor_ros.observers.kinds.nonlinear.motion import Motion
from vsensor_ros.observers.kinds.nonlinear.sensor import names_in
from vsensor_ros.plant import Plant
from vsensor_ros.plant.plain_name import affine_node
from vsensor_ros.plant.plant import reading_node
from vsensor_ros.plant.split import addends

LONGEST, TOLD = 3000, 500  # steps: of the drift after the loss, and until all is told
MOST = 0.9  # of the points
NEARLY = 1.5  # times the least deviation: then the channels have told enough
STATE = ':'  # before the name of a state among those of sensors
LAST, AT_EACH = 1e6, 8  # s of drift that are worked out, and steps of twice the length each


def nonlinear_entry(plant: Plant, fault_set: tuple[str, ...], channel: str, observer: Observer,
                    out: str, turn: float = 0.0) -> NonlinearSensor | None:
    """
    Return the entry that runs an observer; None where nothing tells a temporary one its start.

    out: what it says of the channel's linear reading, over z, sensors and inputs, where readings
    are free of what sensors read directly of inputs; turn: by what it goes round, 0: it does not.
    """
    own = plant.sensors.index(channel)
    said = to_text(Apply('+', (parse(out), affine_node(plant.Cu[own], plant.inputs)))) \
        if plant.Cu[own].any() else out
    texts = (*observer.F, out, *observer.residuals, *(c.positive for c in observer.validity))
    used = names_in(texts)
    reads = tuple(s for s in plant.sensors if s not in fault_set and s in used)
    problem = pose(plant, fault_set, channel)
    model = noise_model(problem)
    temporary = observer.grade == TEMPORARY or observer.rate <= 0.0
    tracks = _tracks(plant, fault_set, channel, observer, out)
    if temporary and not tracks:
        return None
    sampled = sample(plant)
    rate = 0.0 if temporary or not observer.names else observer.rate / (plant.sample_time or 1.0)
    phi = Equations([parse(text) for text in observer.phi], plant.states)
    low, high = np.array(observer.ranges).reshape(-1, 2).T
    seen, slopes = phi.slopes(sampled.x)
    low = np.where(np.isfinite(low), low, seen.min(axis=1))
    high = np.where(np.isfinite(high), high, seen.max(axis=1))
    told = {s for s in (*reads, *fault_set) if s in reads or s in names_in(tracks)}
    noise = np.where(np.isnan(plant.noise), RELATIVE * problem.size_of(
        list(range(len(plant.sensors)))), plant.noise)
    lasts = np.nan_to_num(1.0 / plant.sensor_rate)
    process = np.where(np.isnan(plant.process_noise), model.process * problem.scale,
                       plant.process_noise)
    known = (*observer.names, *plant.sensors, *plant.inputs)
    at = np.concatenate([seen, sampled.y, sampled.u])
    k, L = len(observer.names), len(plant.sensors)
    by_F, by_out = (Equations([parse(text) for text in some], known).slopes(at)[1]
                    for some in (observer.F, [out]))
    driven = np.nan_to_num(plant.input_noise)
    drives = _driven(observer, plant.inputs, process, driven)
    moved = np.zeros(k) if drives else _rms(
        slopes * process[:, None], by_F[:, k + L:] * driven[:, None])
    through = np.einsum('zn,zln->ln', by_out[0, :k], by_F[:, k:k + L])
    entry = NonlinearSensor(
        channel, fault_set, reads, plant.inputs, 'temporary' if temporary else 'exact',
        observer.grade == CERTIFIED, observer.names, observer.phi, observer.F, said,
        observer.residuals, tracks, drives,
        conditions(plant, observer, sampled, noise), turn,
        _region(plant, observer, reads), (low + high) / 2, np.diag((high - low)**2 / 12.0), moved,
        {s: float(noise[plant.sensors.index(s)]) for s in plant.sensors if s in told},
        {s: float(lasts[plant.sensors.index(s)]) for s in plant.sensors if s in told},
        decay=rate, warm_up=0.0, followed=0.0, ages=np.array([0.0, 1.0]), drift=np.zeros(2),
        direct={s: _typical(by_out[0, k + plant.sensors.index(s)]) for s in reads},
        pushes={s: _typical(through[plant.sensors.index(s)]) for s in reads},
        useful=useful(plant, sampled.y[own], turn), sample_time=plant.sample_time,
        words=_words(observer) or 'what readings tell at once')
    return _grown(plant, entry, sampled, seen)


def _driven(observer: Observer, inputs: Sequence[str], process: np.ndarray,
            driven: np.ndarray) -> tuple[str, ...]:
    """Return what each noise of states and inputs does to each z, row by row; () if not known."""
    texts = []
    for row, F in zip(observer.slopes, observer.F):
        of_inputs = [derivative(parse(F), name) for name in inputs]
        texts += [to_text(times(Number(float(size)), slope)) for size, slope in zip(
            (*process, *driven), (*map(parse, row), *of_inputs)) if size]
    return tuple(texts)


def _words(observer: Observer) -> str:
    said = ', '.join(observer.words)
    return said if not observer.only_coordinates else \
        f'{said}: a change of coordinates that you could choose as a state'


def _rms(*parts: np.ndarray) -> np.ndarray:
    """Return the root of the mean over points of the sum of squares (k,) of (k, .., points)."""
    total = sum((part**2).sum(axis=1) for part in parts)
    return np.sqrt(np.median(np.asarray(total), axis=1))


def _typical(values: np.ndarray) -> float:
    """Return how large they are in most places, which a pole in one does not change."""
    found = np.abs(values[np.isfinite(values)])
    return float(min(np.sqrt(np.mean(found**2)), np.quantile(found, MOST))) if len(found) else 0.0


def _region(plant: Plant, observer: Observer,
            reads: Sequence[str]) -> dict[str, tuple[float, float]]:
    found = dict(zip(observer.names, observer.ranges))
    found.update({s: ends for s, ends in plant.reading_ranges().items() if s in reads})
    found.update({u: (float(low), float(high)) for u, (low, high) in zip(
        plant.inputs, plant.input_range)})
    return {name: ends for name, ends in found.items()
            if ends[0] < ends[1] and np.isfinite(ends).all()}


# ------------------------------------------------------------------------- how it is tracked

def _tracks(plant: Plant, fault_set: tuple[str, ...], channel: str, observer: Observer,
            out: str) -> tuple[str, ...]:
    """Return what is 0 in truth of z and readings of the channels, too."""
    if not observer.names:
        return ()
    apart = {state: Name(STATE + state) for state in plant.states}  # a sensor may be called so
    readings = {s: fold(substitute(reading_node(plant, i), apart))
                for i, s in enumerate(plant.sensors)}
    told, whole = _told(readings, plant), {node: Name(s) for s, node in readings.items()}
    tracks, missing = [], False
    for name, text in zip(observer.names, observer.phi):
        node = fold(substitute(_whole(fold(substitute(parse(text), apart)), whole), told))
        if not set(names(node)) <= {*plant.sensors, *plant.inputs}:
            missing = True
        elif not set(fault_set).isdisjoint(names(node)):
            tracks.append(to_text(Apply('-', (Name(name), node))))
    if (missing or not tracks) and np.isnan(plant.wrap[plant.sensors.index(channel)]):
        tracks.append(to_text(Apply('-', (Name(channel), parse(out)))))
    return tuple(tracks)


def _told(readings: Mapping[str, Node], plant: Plant) -> dict[str, Node]:
    """Return the states that readings tell, each as a node over sensors and inputs."""
    told: dict[str, Node] = {}
    for _ in plant.states:
        for sensor, node in readings.items():
            linear, cores = addends(substitute(node, told), plant.name, sensor)
            linear_, cores_ = ({n for n in held if n.startswith(STATE)} for held in (
                linear, [name for _, core in cores for name in names(core)]))
            if len(linear_) != 1 or cores_ or not {*linear, *(
                    name for _, core in cores for name in names(core))}.isdisjoint(
                        plant.unknown_inputs):
                continue
            [left] = linear_
            rest: Node = Name(sensor)
            for factor, core in [*((linear[n], Name(n) if n else Number(1.0)) for n in linear
                                   if n != left), *cores]:
                rest = Apply('-', (rest, Apply('*', (Number(factor), core))))
            told[left] = rest if linear[left] == 1.0 else \
                fold(Apply('/', (rest, Number(linear[left]))))
    return told


def _whole(node: Node, readings: Mapping[Node, Node]) -> Node:
    """Put a sensor in place of each part that it shows as a whole."""
    if not isinstance(node, Apply):
        return node
    if node in readings:
        return readings[node]
    return replace(node, arguments=tuple(_whole(a, readings) for a in node.arguments))


# ------------------------------------------------------------------------ how it drifts off

def _grown(plant: Plant, entry: NonlinearSensor, sampled: Sampled,
           seen: np.ndarray) -> NonlinearSensor:
    """Return an entry with how its deviation grows, and when its starts are forgotten."""
    period = plant.sample_time or INTERVAL
    motion = Motion(entry, plant.sensors, plant.inputs, period)
    x, v = _point(plant, entry, sampled, seen)
    J, W = (found[0] for found in motion.linear(x[None], v))
    E, driven = (J, W) if plant.sample_time is not None else (expm(J * period), period * W)
    y, u = np.split(v, [len(plant.sensors)])

    def after(P: np.ndarray, tracked: bool) -> tuple[np.ndarray, float]:
        z = motion.corrected(motion.state(x, E @ P @ E.T + driven)[None], y, u, tracked)
        P = motion.covariance(z)[0]
        z[0, :len(x)] = x
        return P, motion.deviation(z, y, u)
    P, said = entry.start, []
    if entry.tracks:
        for _ in range(TOLD):
            P, deviation = after(P, True)
            said.append(deviation)
            if len(said) > 20 and said[-20] - deviation < 1e-4 * deviation:
                break
    followed = period * (1 + int(np.argmax(np.array(said) <= NEARLY * said[-1]))) if said else 0.0
    ages, drift = [0.0], [said[-1] if said else motion.deviation(motion.state(x, P)[None], y, u)]
    step = 1
    if not entry.z:
        return replace(entry, drift=np.full(2, drift[0]))
    while ages[-1] < LONGEST * period:
        for _ in range(step):
            P, deviation = after(P, False)
        ages.append(ages[-1] + step * period)
        drift.append(deviation)
        step = max(1, int(0.1 * ages[-1] / period))
    while ages[-1] < LAST and np.isfinite(P).all():  # corrections become rarer: no less is known
        E, driven, period = E @ E, E @ driven @ E.T + driven, 2.0 * period
        for _ in range(AT_EACH):
            P, deviation = after(P, False)
            ages.append(ages[-1] + period)
            drift.append(deviation)
    known = np.isfinite(drift)
    ages, drift = list(np.array(ages)[known]), list(np.array(drift)[known])
    first = motion.deviation(motion.state(x, entry.start)[None], y, u)
    return replace(
        entry, ages=np.array(ages), drift=np.array(drift),
        warm_up=0.0 if not entry.decay else
        math.log(max(math.e, first / (LEFT * drift[-1]))) / entry.decay,
        followed=followed)


def _point(plant: Plant, entry: NonlinearSensor, sampled: Sampled,
           seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return z and what is read and commanded at the operating point, or where it is valid."""
    known = (*entry.z, *plant.sensors, *plant.inputs)
    everything = np.concatenate([seen, sampled.y, sampled.u])
    point = replace(plant, ranges=np.column_stack([plant.operating_point] * 2),
                    input_range=np.column_stack([plant.operating_input] * 2))
    there = sample(point)
    phi = Equations([parse(text) for text in entry.phi], plant.states).values(there.x)
    tries = np.column_stack([np.concatenate([phi, there.y, there.u])[:, :1], everything])
    with np.errstate(all='ignore'):
        valid = Equations([parse(c.positive) for c in entry.validity], known).values(tries)
        F = Equations([parse(text) for text in (*entry.F, entry.out)], known).slopes(tries)[1]
    good = np.isfinite(tries).all(axis=0) & (valid > 0.0).all(axis=0) & (
        np.abs(F) < 1e9).all(axis=(0, 1))
    found = tries[:, int(np.argmax(good))]
    return found[:entry.order], found[entry.order:]
