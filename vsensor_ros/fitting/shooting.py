"""
Multiple shooting: what parameters, starts of windows and offsets of runs let a simulation say.

Each window begins at states of its own, which are unknowns like the parameters. An offset, on
which nothing acts, begins at the same value in all windows of a recording. Misfits are in
deviations of each sensor, and large ones count by their size, not by their square (soft l1). The
steps are those of Levenberg and Marquardt. A window's own unknowns are eliminated from them first,
by an orthogonal projection, all windows at once.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vsensor_ros.fitting.model import Model
from vsensor_ros.fitting.windows import Windows

SOFT = 2.0  # deviations from which on a misfit counts by its size
PATIENCE = 6  # steps that may fail, each shorter than the one before
HUGE = 1e6  # deviations: a simulation that ran away
ENOUGH = 1e-4  # relative gain of a step after which no other is made


@dataclass(frozen=True, eq=False)
class Start:
    """Unknowns: parameters (P,), and where windows begin (N, W)."""

    theta: np.ndarray
    states: np.ndarray


@dataclass(frozen=True, eq=False)
class Shot:
    """
    What a simulation from a start misses.

    misfits (J, l, W), simulated less read, in the sensors' units, NaN where nothing was read;
    slopes (W, J*l, N + P): of what is simulated; cost: half the sum of the robust squares.
    """

    misfits: np.ndarray
    slopes: np.ndarray
    cost: float


@dataclass(frozen=True, eq=False)
class Shooting:
    """
    The problem: windows of a model, deviations (l,) by which misfits are weighed.

    spreads (N,): of offsets about what the plant file has for them, one standard deviation; inf
    where that is not known. noise (l,): the deviations at the starts, where no error of the model
    has grown yet; without it starts bend to what the model gets wrong later.
    """

    model: Model
    windows: Windows
    deviations: np.ndarray
    spreads: np.ndarray
    noise: np.ndarray | None = None

    def sizes(self) -> np.ndarray:
        """Return by what each misfit is weighed (J, l)."""
        found: np.ndarray = np.tile(self.deviations, (len(self.windows.readings), 1))
        if self.noise is not None:
            found[0] = np.minimum(self.noise, found[0])
        return found

    def shoot(self, start: Start) -> Shot:
        """Simulate all windows."""
        model, windows = self.model, self.windows
        x = model.start(start.states)
        misfits, slopes = [], []
        last = np.zeros((len(model.inputs), start.states.shape[1]))
        with np.errstate(all='ignore'):
            for k in range(len(windows.inputs) + 1):
                u = windows.inputs[k] if k < len(windows.inputs) else last
                if k % windows.every == 0:
                    y = model.outputs(x, u, start.theta)
                    misfits.append(y.value - windows.readings[k // windows.every])
                    slopes.append(y.slopes)
                if k < len(windows.inputs):
                    x = model.step(x, u, start.theta, windows.step)
                    last = u
            found, sizes = np.array(misfits), self.sizes()[:, :, None]
            missing = np.isnan(windows.readings)
            bounded = np.where(missing, np.nan, np.clip(np.nan_to_num(
                found, nan=HUGE, posinf=HUGE, neginf=-HUGE), -HUGE * sizes, HUGE * sizes))
            every: np.ndarray = np.stack(slopes, axis=1).reshape(
                len(windows.run), -1, model.size + len(start.theta))
            every = np.clip(np.nan_to_num(every, nan=0.0, posinf=1e12, neginf=-1e12), -1e12, 1e12)
        z = np.nan_to_num(bounded / sizes) / SOFT
        cost = SOFT**2 * float(np.sum(np.sqrt(1.0 + z * z) - 1.0))
        offset = self.offset(start)
        return Shot(bounded, every, cost + 0.5 * float(np.sum(offset**2)))

    def offset(self, start: Start) -> np.ndarray:
        """Return by how many of their spreads the offsets of each run are off (R, n offsets)."""
        drifting, first = self._shared()
        home = self.model.given.plant.initial[drifting]
        return (start.states[np.ix_(drifting, first)].T - home) / self.spreads[drifting]

    def _shared(self) -> tuple[np.ndarray, np.ndarray]:
        """Return which states are offsets, and the first window of each run."""
        drifting = np.flatnonzero(self.model.offsets())
        return drifting, np.unique(self.windows.run, return_index=True)[1]

    def arrow(self, start: Start, shot: Shot) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return weighted misfits (W, M), slopes by own (W, M, L) and by common unknowns (W, M, G).

        G: the parameters, then the offsets of each run.
        """
        n, wide = self.model.size, len(self.windows.run)
        sizes = self.sizes()
        misfit: np.ndarray = np.moveaxis(
            shot.misfits / sizes[:, :, None], 2, 0).reshape(wide, -1)
        there = np.isfinite(misfit)
        misfit = np.where(there, misfit, 0.0)
        # with this the gradient is that of the robust cost, and Gauss and Newton's step stays one
        weight = np.where(there, (1.0 + (misfit / SOFT)**2)**-0.25, 0.0)
        scale = weight / sizes.ravel()
        slopes = shot.slopes * scale[:, :, None]
        drifting, first = self._shared()
        own = np.setdiff1d(np.arange(n), drifting)
        common = [slopes[:, :, n:]]
        runs = self.windows.run[first]
        for run in runs:
            common.append(slopes[:, :, drifting] * (self.windows.run == run)[:, None, None])
        return misfit * weight, slopes[:, :, own], np.concatenate(common, axis=2)

    def solve(self, start: Start, bounds: tuple[np.ndarray, np.ndarray], most: int = 30,
              hold: bool = False) -> tuple[Start, Shot]:
        """
        Return the start with the least cost near this one.

        bounds: least and most of each parameter; most: steps; hold: keep the parameters.
        """
        shot, damping = self.shoot(start), 1e-3
        for _ in range(most):
            arrow = self.arrow(start, shot)
            for _ in range(PATIENCE):
                tried = self._moved(start, arrow, damping, bounds, hold)
                new = self.shoot(tried)
                gained = (shot.cost - new.cost) / max(shot.cost, 1e-300)
                if gained > -ENOUGH:
                    break
                damping *= 10.0
            if gained > 0.0:
                start, shot, damping = tried, new, max(damping / 10.0, 1e-7)
            if gained < ENOUGH:
                break
        return start, shot

    def _moved(self, start: Start, arrow: tuple[np.ndarray, np.ndarray, np.ndarray],
               damping: float, bounds: tuple[np.ndarray, np.ndarray], hold: bool) -> Start:
        misfit, own, common = arrow
        drifting, first = self._shared()
        count = len(start.theta)
        r, q = _projector(own, damping)
        rows = own.shape[1]

        def off(values: np.ndarray) -> np.ndarray:
            return np.swapaxes(q[:, :rows], 1, 2) @ values
        inner_common, inner_misfit = off(common), off(misfit[:, :, None])
        gram = np.einsum('wmg,wmh->gh', common, common) - np.einsum(
            'wlg,wlh->gh', inner_common, inner_common)
        pull = np.einsum('wmg,wm->g', common, misfit) - np.einsum(
            'wlg,wl->g', inner_common, inner_misfit[:, :, 0])
        if drifting.size:
            prior = np.tile(1.0 / self.spreads[drifting], len(first))
            gram[range(count, len(gram)), range(count, len(gram))] += prior**2
            pull[count:] += prior * self.offset(start).ravel()
        free = np.ones(len(gram), bool)
        free[:count] = not hold
        low, high = bounds
        free[:count] &= ~((start.theta <= low) & (pull[:count] > 0.0)
                          | (start.theta >= high) & (pull[:count] < 0.0))
        step = np.zeros(len(gram))
        if free.any():
            size = np.sqrt(np.maximum(np.diag(gram)[free], 1e-300))
            inner = gram[np.ix_(free, free)] / np.outer(size, size)
            inner[np.diag_indices_from(inner)] += damping + 1e-12
            step[free] = -np.linalg.solve(inner, pull[free] / size) / size
        theta = np.clip(start.theta + step[:count], low, high)
        step[:count] = theta - start.theta
        states = start.states.copy()
        rest = misfit + common @ step
        local = -np.linalg.solve(r, off(rest[:, :, None]))[:, :, 0] if own.shape[2] else None
        if local is not None:
            states[np.setdiff1d(np.arange(len(states)), drifting)] += local.T
        runs = self.windows.run[first]
        for i, run in enumerate(runs):
            move = step[count + i * len(drifting):count + (i + 1) * len(drifting)]
            states[np.ix_(drifting, np.flatnonzero(self.windows.run == run))] += move[:, None]
        return Start(theta, states)

    def weighed(self, deviations: np.ndarray, noise: np.ndarray) -> Shooting:
        """Return the problem with misfits weighed by others."""
        return replace(self, deviations=deviations, noise=noise)


def _projector(own: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Return R (W, L, L) and Q (W, M + L, L) of the slopes by own unknowns, damped."""
    sizes = np.sqrt(np.einsum('wml,wml->wl', own, own))
    sizes = sizes + 1e-9 * sizes.max(axis=0, initial=0.0) + 1e-300
    damped = np.concatenate([own, np.sqrt(damping) * sizes[:, :, None] * np.eye(own.shape[2])],
                            axis=1)
    q, r = np.linalg.qr(damped)
    return r, q
