"""
By how much the stamps of sensors are late, as far as the plant says what belongs together.

Unknown are a delay of each sensor but one, and of each command. A first guess is where readings
are likeliest when one channel is shifted, then the next. From there it is least squares
(Gauss and Newton) on the whitened errors of a Kalman filter, in which all that is not known
exactly floats: gains and offsets of sensors and commands, the plant's parameters, and the noise.
Slopes over time are those of the smoothed motion, so that no noise is differentiated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.fitting.align_filter import answers, Filtered, filtered, Smoothed, smoothed
from vsensor_ros.fitting.align_windows import Channels, Nodes
from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.windows import check_channels
from vsensor_ros.plant.checked import suggestion
from vsensor_ros.plant.free import FreePlant
from vsensor_ros.recordings import Recording

Progress = Callable[[int, int, str], None] | None

ROUGH = 0.1  # deviation of gains and parameters of which none is said, of their size
LAGS, FEW = 40, 4  # shifts that are compared, on so many windows
BETTER = 10.0  # of a log-likelihood, from which on a shift is believed
TURNS = 12  # of Gauss and Newton
LEAST = 4  # of these, until noise is known
CLOSE = 0.02  # of a step: it ends
LARGE = 3.0  # deviations, from which on an error counts by its size only
SURE = 2.0  # standard errors of a delay that is more than none
CLEAR = 3.0  # the same, of one of several
UNSEEN = 0.25  # standard error, of the longest delay: nothing is seen of it


@dataclass(frozen=True, eq=False)
class Aligned:
    """
    What was found, by channel: delay [s] against the reference, and its standard error.

    delays: of sensors, by which their stamps are later than what they are of, besides what the
    plant file says; of commands, by which they act later. errors: inf where nothing tells it.
    """

    reference: str
    delays: dict[str, float]
    errors: dict[str, float]
    commands: tuple[str, ...]
    most: float
    count: int
    seconds: float

    def late(self) -> dict[str, float]:
        """Return the sensors whose delay is more than none, by two standard errors."""
        return {name: delay for name, delay in self.delays.items()
                if name not in self.commands and abs(delay) > SURE * self.errors[name]}


def align(given: FreePlant, runs: Sequence[Recording], most: float | None = None,
          reference: str | None = None, progress: Progress = None) -> Aligned:
    """
    Find the delays of a plant's channels in recordings.

    given: by `load_free(path, every=True)`, so that its parameters float. most: the longest delay
    that is looked for [s]; without it 1 s, or 10 readings. reference: the sensor whose stamps are
    right; without one it is that which is late the least. Raises BadInput, one line.
    """
    model = Model(given)
    check_channels(runs, model, given.plant.name)
    channels = Channels.of(model, runs)
    most = max(1.0, 10.0 * channels.step) if most is None else most
    seen = [s for i, s in enumerate(model.sensors) if any(len(r[i][0]) for r in channels.sensors)]
    if reference is not None and reference not in seen:
        raise BadInput('--reference', '', f'{reference} is no sensor of the recording',
                       suggestion(reference, seen))
    if len(seen) + len(model.inputs) < 2:
        raise BadInput(given.plant.name, '', 'only one channel is in the recording',
                       'record two that the plant relates')
    return _Search(channels, most, seen, progress).run(reference)


@dataclass(frozen=True, eq=False)
class _Noise:
    """Deviations of noise on states (N,) and sensors (l,), of starts (N,), and of readings."""

    driven: np.ndarray
    sensors: np.ndarray
    known: np.ndarray
    motion: np.ndarray


@dataclass(frozen=True, eq=False)
class _Point:
    """Windows, how stamps of commands move them, and what the filter makes of them."""

    nodes: Nodes
    later: np.ndarray  # (T, m, W), of commands, with how late their stamps are
    way: Filtered
    smooth: Smoothed
    shown: np.ndarray  # (T + 1, l, W), by the smoothed motion
    slopes: np.ndarray  # (T + 1, l, W), of that, per second


class _Search:
    """Looks for by how much the stamps of sensors and commands (l + m,) are late."""

    def __init__(self, channels: Channels, most: float, seen: Sequence[str],
                 progress: Progress) -> None:
        self.channels, self.model, self.most = channels, channels.model, most
        self.tell = progress if progress is not None else lambda *_: None
        self.where = channels.cut(most)
        self.names = (*self.model.sensors, *self.model.inputs)
        self.free = np.flatnonzero([n in seen or n in self.model.inputs for n in self.names])
        self.theta = np.array([f.value for f in self.model.given.free])

    def run(self, reference: str | None) -> Aligned:
        """Find them."""
        d: np.ndarray = np.zeros(len(self.names))
        noise = self._guess(self.channels.nodes(*self.where, d))
        d = self._scanned(d, noise)
        point = self._points([d], noise)
        for turn in range(TURNS):
            self.tell(turn, TURNS, 'all delays together')
            noise = self._learnt(point, noise)
            slopes, curve = self._solved(point)
            step = np.zeros(len(d))
            step[self.free] = -np.linalg.solve(curve + np.eye(len(self.free)) / self.most**2,
                                               slopes.sum(axis=0))
            step -= np.median(step[self.free])
            longest = 2.0 * self.channels.step + 0.05 * self.most
            d = np.clip(d + np.clip(step, -longest, longest), -2.0 * self.most, 2.0 * self.most)
            point = self._points([d], noise, point.slopes)
            if turn >= LEAST and (np.abs(step) < CLOSE * self.channels.step).all():
                break
        return self._told(d, self._covariance(d, noise, point), reference)

    def _guess(self, nodes: Nodes) -> _Noise:
        """Return noise to begin with: of the plant file, or as readings look."""
        plant, model = self.model.given.plant, self.model
        said = [r[np.isfinite(r)] for r in np.moveaxis(nodes.readings, 1, 0).swapaxes(1, 2)]
        motion = np.array([np.std(r) if len(r) else 0.0 for r in said])
        apart = np.array([np.std(np.diff(r)) / np.sqrt(2.0) if len(r) > 1 else 0.0 for r in said])
        motion = np.where(motion > 0.0, motion, 1e-9)
        apart = np.where(apart > 0.0, apart, 0.1 * motion)
        sensors = np.where(plant.noise > 0.0, plant.noise, apart)
        known = len(model.given.states)
        wide = np.ptp(plant.ranges[:known], axis=1) / 2.0
        wide = np.concatenate([wide, np.full(len(model.unknown), np.inf)])
        wide = np.where(np.isfinite(wide), wide, 10.0 * motion.max())
        length = nodes.step * len(nodes.commands)
        driven = 0.01 * wide / np.sqrt(length / (nodes.step if model.period else 1.0))
        told = np.concatenate([plant.process_noise[:known], [
            plant.disturbance_noise[plant.disturbances.index(n)] for n in model.unknown]])
        return _Noise(np.where(told > 0.0, told, driven), sensors, wide, motion)

    def _starts(self, nodes: Nodes) -> np.ndarray:
        """Return where windows seem to begin (N, W)."""
        plant, model = self.model.given.plant, self.model
        known = len(model.given.states)
        x = np.repeat(np.concatenate([plant.initial[:known], np.zeros(len(model.unknown))])
                      [:, None], len(nodes.run), axis=1)
        there = np.isfinite(nodes.readings)
        first = np.take_along_axis(nodes.readings, there.argmax(axis=0)[None], axis=0)[0]
        y, slopes = model.outputs(model.start(x), nodes.commands[0], self.theta)
        drifting = model.offsets()
        for w in range(x.shape[1]):
            read = np.isfinite(first[:, w])
            C = np.where(drifting, 0.0, slopes[w, read, :model.size])
            x[:, w] += np.linalg.pinv(C) @ (first[read, w] - y[read, w])
        return x

    def _scanned(self, d: np.ndarray, noise: _Noise) -> np.ndarray:
        """Shift one channel after the other to where all that is read is the likeliest."""
        run, starts, count = self.where
        nodes = self.channels.nodes(run, starts, count, d)
        spread = [np.ptp(np.where(np.isfinite(r), r, np.nanmean(r)), axis=0)
                  if np.isfinite(r).any() else np.zeros(len(run))
                  for r in np.moveaxis(nodes.readings, 1, 0)]
        moving = (np.array(spread) / noise.motion[:, None]).sum(axis=0)
        few = np.sort(np.argsort(-moving, kind='stable')[:FEW])
        steps = max(int(round(self.most / self.channels.step)), 1)
        stride = max(1, -(-2 * steps // LAGS))
        lags = stride * np.arange(-(steps // stride), steps // stride + 1) * self.channels.step
        best = np.inf
        for turn in range(2 * len(self.free)):
            found = []
            for k, i in enumerate(self.free):
                self.tell(k, len(self.free), f'one channel after the other, round {turn + 1}')
                costs = self._unlikely(Nodes.beside([self.channels.nodes(
                    run[few], starts[few], count, d + lag * (np.arange(len(d)) == i))
                    for lag in lags]), noise, len(lags))
                best = min(best, float(costs[len(lags) // 2]))
                j = int(np.argmin(costs))
                found.append((float(costs[j]), int(i), float(lags[j])))
            cost, i, lag = min(found)
            if best - cost < BETTER or lag == 0.0:
                break
            d, best = d + lag * (np.arange(len(d)) == i), cost
        return d

    def _unlikely(self, nodes: Nodes, noise: _Noise, parts: int) -> np.ndarray:
        """Return the negative log-likelihood (parts,) of windows that stand in so many parts."""
        way = filtered(self.model, nodes, nodes.readings, self._starts(nodes), noise.known,
                       noise.driven, noise.sensors, pushes=False)
        z, read = way.errors / way.sizes, np.isfinite(way.errors)
        large = np.abs(z) > LARGE
        each = np.log(way.sizes) + np.where(large, LARGE * (np.abs(z) - LARGE / 2.0), 0.5 * z**2)
        each = np.where(read, np.nan_to_num(each, nan=1e6, posinf=1e6), 0.0)
        sums = each.reshape(*each.shape[:2], parts, -1).sum(axis=(0, 3))
        counts = read.reshape(*each.shape[:2], parts, -1).sum(axis=(0, 3))
        return (sums / np.maximum(counts, 1) * counts.max(axis=1)[:, None]).sum(axis=0)

    def _points(self, points: Sequence[np.ndarray], noise: _Noise,
                slopes: np.ndarray | None = None) -> _Point:
        """
        Filter all windows at some delays, and at others beside them.

        slopes (T + 1, l, W): bring readings to their nodes.
        """
        parts = [self.channels.nodes(*self.where, d) for d in points]
        nodes = Nodes.beside(parts)
        readings = nodes.readings
        if slopes is not None:
            readings = readings + nodes.after * np.tile(slopes, len(points))
        later = np.concatenate([self.channels.later(part, d)
                                for part, d in zip(parts, points)], axis=2)
        way = filtered(self.model, nodes, readings, self._starts(nodes), noise.known,
                       noise.driven, noise.sensors)
        smooth = smoothed(way)
        steps, inputs, width = nodes.commands.shape
        u = np.concatenate([nodes.commands, nodes.commands[-1:]])
        shown = self.model.outputs(
            self.model.start(smooth.states.transpose(1, 0, 2).reshape(self.model.size, -1)),
            u.transpose(1, 0, 2).reshape(inputs, -1), self.theta).value
        shown = shown.reshape(-1, steps + 1, width).transpose(1, 0, 2)
        return _Point(nodes, later, way, smooth, shown, np.gradient(shown, nodes.step, axis=0))

    def _learnt(self, point: _Point, noise: _Noise) -> _Noise:
        """Return noise by one step of EM; that of starts stays."""
        H = point.way.shown[:, :, :, :self.model.size]
        variance = np.einsum('kwln,kwnm,kwlm->klw', H, point.smooth.covariances, H)
        off = point.nodes.readings + point.nodes.after * point.slopes - point.shown
        size = np.sqrt(off**2 + np.maximum(variance, 0.0))
        with np.errstate(all='ignore'):
            limit = 3.0 * np.nanmedian(size, axis=(0, 2)) / 0.6745
            sensors = np.sqrt(np.nanmean(np.minimum(size, limit[:, None])**2, axis=(0, 2)))
        sensors = np.where(np.isfinite(sensors) & (sensors > 0.0), sensors, noise.sensors)
        driven = point.smooth.driven / (1.0 if self.model.period else point.nodes.step**0.5)
        floor = 1e-6 * noise.known / np.sqrt(point.nodes.step * len(point.nodes.commands))
        return _Noise(np.maximum(driven, floor), np.maximum(sensors, 1e-6 * noise.motion),
                      noise.known, noise.motion)

    def _causes(self, point: _Point) -> tuple[np.ndarray, np.ndarray]:
        """Return what causes do to errors (T + 1, l, W, c), and the causes' deviations (c,)."""
        model, nodes, way = self.model, point.nodes, point.way
        sensors, inputs = len(model.sensors), len(model.inputs)
        free, width = len(model.given.free), len(nodes.run)
        steps = len(nodes.commands)
        y = point.shown
        columns = 3 * (sensors + inputs) + free
        readings = np.zeros((steps + 1, width, sensors, columns))
        outputs, rates = np.zeros_like(readings), np.zeros((steps, width, model.size, columns))
        every, first = np.arange(sensors), sensors + inputs
        readings[:, :, every, every] = point.slopes.transpose(0, 2, 1)
        centred = y - y.mean(axis=(0, 2), keepdims=True)
        readings[:, :, every, first + every] = centred.transpose(0, 2, 1)
        readings[:, :, every, first + sensors + every] = 1.0
        u = nodes.commands - nodes.commands.mean(axis=(0, 2), keepdims=True)
        for j in range(inputs):
            by = way.pushed[:, :, :, j]
            rates[:, :, :, sensors + j] = by * point.later[:, j, :, None]
            rates[:, :, :, first + 2 * sensors + j] = by * u[:, j, :, None]
            rates[:, :, :, first + 2 * sensors + inputs + j] = by
        if free:
            rates[:, :, :, -free:] = way.moved[:, :, :, model.size:]
            outputs[:, :, :, -free:] = way.shown[:, :, :, model.size:]
        plant = model.given.plant
        spread = [plant.spreads.get(f.name, ROUGH * (abs(f.value) or 1.0))
                  for f in model.given.free]
        deviations = np.concatenate([
            np.full(first, self.most), np.full(sensors, ROUGH / 2), ROUGH * y.std(axis=(0, 2)),
            np.full(inputs, ROUGH), ROUGH * u.std(axis=(0, 2)), spread])
        return answers(way, readings, rates, outputs), np.maximum(deviations, 1e-12)

    def _solved(self, point: _Point) -> tuple[np.ndarray, np.ndarray]:
        """
        Return the slopes of the costs (W, f) by the free delays, and their curvature (f, f).

        The costs are those of windows, the curvature that of their sum, in which all else that is
        not known is where it is the least.
        """
        causes, deviations = self._causes(point)
        way = point.way
        read = np.isfinite(way.errors)
        z = np.where(read, way.errors / way.sizes, 0.0)
        robust = np.minimum(1.0, LARGE / np.maximum(np.abs(z), 1e-9))
        A = causes * (np.where(read, np.sqrt(robust), 0.0) / way.sizes)[..., None] * deviations
        scores = np.einsum('klwc,klw->wc', A, z * np.sqrt(robust))
        normal = np.einsum('klwc,klwd->cd', A, A)
        delays, other = self.free, np.arange(len(self.names), len(deviations))
        inner = normal[np.ix_(other, other)] + np.eye(len(other))
        off = np.linalg.solve(inner, normal[np.ix_(other, delays)])
        slopes = (scores[:, delays] - scores[:, other] @ off) / self.most
        curve = normal[np.ix_(delays, delays)] - normal[np.ix_(delays, other)] @ off
        return slopes, curve / self.most**2

    def _covariance(self, d: np.ndarray, noise: _Noise, point: _Point) -> np.ndarray:
        """
        Return that of the free delays (f, f) [s^2], against the one that is known the best.

        It is of how the slopes of the costs scatter over windows, and of how they change over a
        step of the nodes, by which readings are moved as they are. Where they only follow noise,
        they change with delays in one window so and in another otherwise: that tells nothing.
        """
        slopes, assumed = self._solved(point)
        best = np.argmin(np.median(_between(np.linalg.inv(
            assumed + np.eye(len(assumed)) / self.most**2)), axis=1))
        others = np.flatnonzero(np.arange(len(self.free)) != best)
        h, curve = self.channels.step, np.empty((len(others), len(others)))
        dull = np.zeros(len(others), bool)
        for j, i in enumerate(self.free[others]):
            self.tell(j, len(others), 'standard errors')
            ahead, back = (self._solved(self._points(
                [d + side * h * (np.arange(len(d)) == i)], noise, point.slopes))[0][:, others]
                for side in (1.0, -1.0))
            each = (ahead - back) / (2.0 * h)
            curve[:, j] = each.sum(axis=0)
            dull[j] = curve[j, j] < CLEAR * np.sqrt(len(each)) * np.std(each[:, j])
        curve[dull], curve[:, dull] = 0.0, 0.0
        sizes, axes = np.linalg.eigh((curve + curve.T) / 2.0)
        inverse = (axes / (np.maximum(sizes, 0.0) + self.most**-2)) @ axes.T
        count, slopes = len(slopes), slopes[:, others]
        scatter = slopes.T @ slopes * count / max(count - len(others), 1)
        scatter[dull], scatter[:, dull] = 0.0, 0.0
        found = np.zeros((len(self.free), len(self.free)))
        found[np.ix_(others, others)] = inverse @ (
            scatter + np.eye(len(others)) / self.most**2) @ inverse
        return found

    def _told(self, d: np.ndarray, covariance: np.ndarray, reference: str | None) -> Aligned:
        """
        Return delays against the reference.

        Without one it is, of those than which none is surely less late, the one known the best.
        """
        names = [self.names[i] for i in self.free]
        d = d[self.free]
        sensors = [i for i, name in enumerate(names) if name not in self.model.inputs]
        between = _between(covariance)
        if reference is not None:
            at = names.index(reference)
        else:
            first = [i for i in sensors if not any(
                d[j] - d[i] < -CLEAR * between[i, j] for j in sensors if j != i)] or sensors
            at = min(first, key=lambda i: float(np.median(between[i, sensors])))
        errors = np.where(between[at] > UNSEEN * self.most, np.inf, between[at])
        signs = [-1.0 if name in self.model.inputs else 1.0 for name in names]
        run, _, count = self.where
        return Aligned(names[at], dict(zip(names, ((d - d[at]) * signs).tolist())),
                       dict(zip(names, errors.tolist())), self.model.inputs, self.most,
                       len(run), count * self.channels.step)


def _between(covariance: np.ndarray) -> np.ndarray:
    """Return the standard errors of differences (f, f)."""
    own = np.diag(covariance)
    return np.asarray(np.sqrt(np.maximum(own + own[:, None] - 2.0 * covariance, 0.0)))
