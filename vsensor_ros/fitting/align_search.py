"""
Delays of all channels of a plant together, with standard errors.

A first guess is where readings are likeliest when one channel is shifted, then the next. From
there it is least squares (Gauss and Newton) on the whitened errors of a Kalman filter, in which
all that is not known exactly floats: gains and offsets of sensors and commands, the plant's
parameters, and the noise. Slopes over time are those of the smoothed motion, so that no noise is
differentiated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.fitting.align_filter import answers, Filtered, filtered, Smoothed, smoothed
from vsensor_ros.fitting.align_windows import Channels, Nodes

Progress = Callable[[int, int, str], None] | None

ROUGH = 0.1  # deviation of gains and parameters of which none is said, of their size
LAGS, FEW = 40, 4  # shifts that are compared, on so many windows
BETTER = 10.0  # of a log-likelihood, from which on a shift is believed
TURNS = 12  # of Gauss and Newton
LEAST = 4  # of these, until noise is known
CLOSE = 0.02  # of a step: it ends
LARGE = 3.0  # deviations, from which on an error counts by its size only
CLEAR = 3.0  # standard errors of what is more than none, of one of several
SURE = 2.0  # the same, of a curvature that is more than none
UNSEEN = 0.25  # standard error, of the longest delay: nothing is seen of it


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


class Search:
    """Looks for by how much the stamps of sensors and commands (l + m,) are late."""

    def __init__(self, channels: Channels, most: float, seen: Sequence[str],
                 progress: Progress) -> None:
        self.channels, self.model, self.most = channels, channels.model, most
        self.tell = progress if progress is not None else lambda *_: None
        self.where = channels.cut(most)
        self.names = (*self.model.sensors, *self.model.inputs)
        self.free = np.flatnonzero([n in seen or n in self.model.inputs for n in self.names])
        self.theta = np.array([f.value for f in self.model.given.free])

    def run(self) -> tuple[np.ndarray, np.ndarray]:
        """
        Return by how much the free channels' stamps are late (f,) [s].

        And standard errors of differences (f, f), inf where they are not seen. Raises BadInput.
        """
        d: np.ndarray = np.zeros(len(self.names))
        noise = self._guess(self.channels.nodes(*self.where, d))
        d = self._scanned(d, noise)
        point = self._points([d], noise)
        for turn in range(TURNS):
            self.tell(turn, TURNS, 'all delays together')
            noise = self._learnt(point, noise)
            slopes, curve = self._solved(point)
            if not (np.isfinite(slopes).all() and np.isfinite(curve).all()):
                raise BadInput(self.model.given.plant.name, '', 'the filter on its equations runs '
                               'away in the recording', 'fit its parameters first')
            step = np.zeros(len(d))
            step[self.free] = -np.linalg.solve(curve + np.eye(len(self.free)) / self.most**2,
                                               slopes.sum(axis=0))
            step -= np.median(step[self.free])
            longest = 2.0 * self.channels.step + 0.05 * self.most
            d = np.clip(d + np.clip(step, -longest, longest), -2.0 * self.most, 2.0 * self.most)
            point = self._points([d], noise, point.slopes)
            if turn >= LEAST and (np.abs(step) < CLOSE * self.channels.step).all():
                break
        errors = self._errors(d, noise, point)
        return d[self.free], np.where(errors > UNSEEN * self.most, np.inf, errors)

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

    def _errors(self, d: np.ndarray, noise: _Noise, point: _Point) -> np.ndarray:
        """
        Return the standard errors of differences of the free delays (f, f) [s].

        They are of how the slopes of the costs scatter over windows. What it takes for slopes
        over time may be noise. So all is filtered again some steps of the nodes to each side, by
        which readings are moved as they are: how the costs really change says what is left, and
        where it is not clear, nothing is.
        """
        slopes, assumed = self._solved(point)
        best = np.argmin(np.median(_between(np.linalg.inv(
            assumed + np.eye(len(assumed)) / self.most**2)), axis=1))
        others = np.flatnonzero(np.arange(len(self.free)) != best)
        count, slopes = len(slopes), slopes[:, others]
        scatter = slopes.T @ slopes * count / max(count - len(others), 1)
        prior = np.eye(len(others)) / self.most**2
        inverse = np.linalg.inv(assumed[np.ix_(others, others)] + prior)
        found = np.zeros((len(self.free), len(self.free)))
        found[np.ix_(others, others)] = inverse @ (scatter + prior) @ inverse
        h, times = self.channels.step, np.ones(len(self.free))
        for j in others:
            self.tell(int(j), len(self.free), 'standard errors')
            wide = h * max(1, round(min(2.0 * np.sqrt(found[j, j]), 0.25 * self.most) / h))
            aside = wide * (np.arange(len(d)) == self.free[j])
            ahead, back = (self._solved(self._points([d + side * aside], noise, point.slopes))
                           [0][:, j] for side in (1.0, -1.0))
            each = (ahead - back) / (2.0 * wide)
            clear = each.sum() > SURE * np.sqrt(count) * np.std(each)
            times[j] = max(1.0, assumed[j, j] / each.sum()) if clear else np.inf
        worse = np.maximum(times, times[:, None])
        seen = np.isfinite(worse)
        errors = np.where(seen, _between(found) * np.where(seen, worse, 1.0), np.inf)
        np.fill_diagonal(errors, 0.0)
        return errors


def _between(covariance: np.ndarray) -> np.ndarray:
    """Return the standard errors of differences (f, f)."""
    own = np.diag(covariance)
    return np.asarray(np.sqrt(np.maximum(own + own[:, None] - 2.0 * covariance, 0.0)))
