"""
One step of every functional observer of a design at once.

Virtual sensors are stacked along a first axis V and padded with zeros to a common order k, so
that a number that overflows in one of them cannot reach another. Other letters are those of the
method, and L sensors, m commands, S terms with r arguments (the most of one virtual sensor).
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from typing import Any, NamedTuple, Protocol

import numpy as np

from vsensor_ros.functions.nonlinearity import (
    compile_outside_domain,
    compile_term,
    NonlinearTerm,
    set_valued,
)
from vsensor_ros.observers.kinds.functional.discretise import phi_functions
from vsensor_ros.observers.kinds.functional.virtual_sensor import VirtualSensor

NOTHING = np.zeros(0)

_SWEEPS = 100  # of Gauss-Seidel at most; one sign term needs one
_STUCK = 1e-9  # of what friction changes in one step: anything slower stands still


class Step(Protocol):
    """Takes z (V, k), readings and commands, see `make_step`."""

    def __call__(self, z: np.ndarray, y0: np.ndarray, y1: np.ndarray, u0: np.ndarray,
                 u1: np.ndarray, u: np.ndarray, held0: np.ndarray = NOTHING,
                 held1: np.ndarray = NOTHING) -> tuple[np.ndarray, np.ndarray]:
        """Return z at the end of the step, and who was outside of a function's domain (V,)."""


def make_step(
    virtual_sensors: Sequence[VirtualSensor], sensors: Sequence[str], h: float
) -> Step:
    """
    Build the fused step of period h [s] for the virtual sensors (at least one) of one design.

    It takes the readings at both ends of the step (L,), the commands at both ends and their mean
    (m,), and those that hold from either end on (m,), which readings taken there have seen: not
    needed where all Gu are zero.

    Discrete plants: the map itself, with the readings at the beginning of the step and the mean
    command. Continuous plants: exact in the linear part for readings that are linear in time,
    fourth-order exponential Runge-Kutta (Cox and Matthews 2002, ETDRK4) for smooth terms, the
    resolvent for ``sign(w1)`` where the sign of its coefficient has one (method, section 5).
    """
    if virtual_sensors[0].sample_time is not None:
        return _Map(virtual_sensors, sensors)
    return _Flow(virtual_sensors, sensors, h)


def step_of(step: Step, rows: np.ndarray) -> Step:
    """Return the step of some of its virtual sensors alone; rows (n,) int may repeat."""
    found = copy(step)
    for name, value in vars(step).items():
        if isinstance(value, np.ndarray):
            setattr(found, name, value[rows])
        elif isinstance(value, _Terms):
            setattr(found, name, value.of(rows))
    return found


def pad(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Stack arrays of different shapes, filled up with zeros."""
    stacked = np.zeros((len(arrays), *np.max([a.shape for a in arrays], axis=0)))
    for slot, array in zip(stacked, arrays):
        slot[tuple(slice(side) for side in array.shape)] = array
    return stacked


def widen(v: VirtualSensor, sensors: Sequence[str], matrix: np.ndarray) -> np.ndarray:
    """Spread columns over the healthy sensors of v to all sensors, (..., L)."""
    wide = np.zeros((*matrix.shape[:-1], len(sensors)))
    wide[..., [sensors.index(name) for name in v.healthy]] = matrix
    return wide


def _times(matrices: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Multiply (V, a, b) by (V, b)."""
    return (matrices @ vectors[..., None])[..., 0]


class _Function(NamedTuple):
    """What equal terms compute of their r arguments (r, n)."""

    width: int  # r
    value: Any
    slope: np.ndarray | None  # (r,) taken out of it; None: nothing
    outside: Any  # None: it is defined everywhere


class _Terms:
    """
    Chosen terms of each virtual sensor: P (V, k, S), Gz (V, S r, k), Gy (V, S r, L), Gu (.., m).

    ``self(w, u)``, with w (V, S r), gives psi (V, S). Equal terms are evaluated together.
    """

    def __init__(self, virtual_sensors: Sequence[VirtualSensor], sensors: Sequence[str],
                 chosen: Sequence[Sequence[int]]) -> None:
        V, S = len(virtual_sensors), max(map(len, chosen))
        self._r = r = max([len(v.terms[i].slope) for v, on in zip(virtual_sensors, chosen)
                           for i in on], default=0)
        k = max(v.order for v in virtual_sensors)
        inputs = virtual_sensors[0].inputs
        self.P = np.zeros((V, k, S))
        Gz, Gy, Gu = (np.zeros((V, S, r, width)) for width in (k, len(sensors), len(inputs)))
        same: dict[tuple[str, bytes], tuple[NonlinearTerm, list[int], list[int]]] = {}
        for row, (v, on) in enumerate(zip(virtual_sensors, chosen)):
            for slot, i in enumerate(on):
                term = v.terms[i]
                self.P[row, :v.order, slot] = v.P[:, i]
                Gz[row, slot, :len(term.slope), :v.order] = v.Gz[i]
                Gy[row, slot, :len(term.slope)] = widen(v, sensors, v.Gy[i])
                Gu[row, slot, :len(term.slope)] = v.Gu[i]
                _, rows, slots = same.setdefault(
                    (term.text, term.slope.tobytes()), (term, [], []))
                rows.append(row)
                slots.append(slot)
        self.Gz, self.Gy, self.Gu = (G.reshape(V, S * r, G.shape[3]) for G in (Gz, Gy, Gu))
        self._lay_out([(
            _Function(len(term.slope), compile_term(term, inputs),
                      term.slope if term.slope.any() else None,
                      compile_outside_domain(term, inputs)),
            np.array(rows), np.array(slots)) for term, rows, slots in same.values()])

    def _lay_out(self, same: list[tuple[_Function, np.ndarray, np.ndarray]]) -> None:
        """Put equal terms side by side: their arguments, one (r, n) block each, and values."""
        self._same = same  # with the rows (n,) and slots (n,) in which each stands
        V, S = self.P.shape[0], self.P.shape[2]
        where = np.arange(V * S * self._r).reshape(V, S, self._r)
        self._gather = np.concatenate([np.zeros(0, dtype=int), *(
            where[rows, slots, :function.width].T.ravel() for function, rows, slots in same)])
        self._blocks: list[tuple[slice, tuple[int, int], slice, _Function, np.ndarray]] = []
        values = sum(len(rows) for _, rows, _ in same)
        self._scatter = np.full((V, S), values)  # one more value, always 0, for empty slots
        self._values = np.zeros(values + 1)
        at, start = 0, 0
        for function, rows, slots in same:
            n, width = len(rows), function.width
            self._scatter[rows, slots] = np.arange(start, start + n)
            self._blocks.append((slice(at, at + width * n), (width, n), slice(start, start + n),
                                 function, rows))
            at, start = at + width * n, start + n

    def of(self, rows: np.ndarray) -> _Terms:
        """Return those of some virtual sensors alone; rows (n,) int may repeat."""
        found = copy(self)
        found.P, found.Gz, found.Gy, found.Gu = (
            matrix[rows] for matrix in (self.P, self.Gz, self.Gy, self.Gu))
        same = []
        for function, own, slots in self._same:
            new, at = np.nonzero(rows[:, None] == own)
            if new.size:
                same.append((function, new, slots[at]))
        found._lay_out(same)
        return found

    def __call__(self, w: np.ndarray, u: np.ndarray) -> np.ndarray:
        flat, values = w.ravel()[self._gather], self._values
        for arguments, shape, out, function, _ in self._blocks:
            block = flat[arguments].reshape(shape)
            values[out] = function.value(block, u)
            if function.slope is not None:
                values[out] -= function.slope @ block
        return values[self._scatter]

    def outside(self, w: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Tell for each virtual sensor whether a function sees what is not in its domain."""
        result, flat = np.zeros(len(w), dtype=bool), w.ravel()[self._gather]
        for arguments, shape, _, function, rows in self._blocks:
            if function.outside is not None:
                result[rows] |= function.outside(flat[arguments].reshape(shape), u)
        return result


class _Map:
    """``z+ = N z + J y + B u + P psi(Gz z + Gy y + Gu u, u)``."""

    def __init__(self, virtual_sensors: Sequence[VirtualSensor], sensors: Sequence[str]) -> None:
        self._terms = T = _Terms(virtual_sensors, sensors, [v.active for v in virtual_sensors])
        N, B = pad([v.N for v in virtual_sensors]), pad([v.B for v in virtual_sensors])
        J = pad([widen(v, sensors, v.J) for v in virtual_sensors])
        self._of_z = np.concatenate((N, T.Gz), axis=1)
        of_u = np.concatenate((B, np.zeros((len(B), T.Gz.shape[1], B.shape[2]))), axis=1)
        self._of_data = np.concatenate((np.concatenate((J, T.Gy), axis=1), of_u), axis=2)
        self._direct = bool(T.Gu.any())

    def __call__(self, z: np.ndarray, y0: np.ndarray, y1: np.ndarray, u0: np.ndarray,
                 u1: np.ndarray, u: np.ndarray, held0: np.ndarray = NOTHING,
                 held1: np.ndarray = NOTHING) -> tuple[np.ndarray, np.ndarray]:
        linear = _times(self._of_z, z) + self._of_data @ np.concatenate((y0, u))
        end, w = np.split(linear, [z.shape[1]], axis=1)
        if self._direct:
            w = w + self._terms.Gu @ held0
        return end + _times(self._terms.P, self._terms(w, u)), self._terms.outside(w, u)


class _Flow:
    """
    One period of ``d/dt z = N z + J y + B u + P psi(Gz z + Gy y + Gu u, u)``.

    Of the arguments, w are those of the smooth terms, s those of the implicit sign terms.
    """

    def __init__(self, virtual_sensors: Sequence[VirtualSensor], sensors: Sequence[str],
                 h: float) -> None:
        N, B = pad([v.N for v in virtual_sensors]), pad([v.B for v in virtual_sensors])
        J = pad([widen(v, sensors, v.J) for v in virtual_sensors])
        E, phi1, phi2, phi3 = phi_functions(N, h)
        E_half, phi1_half, phi2_half, _ = phi_functions(N, h / 2)
        implicit = [_with_resolvent(v, f[:v.order, :v.order])
                    for v, f in zip(virtual_sensors, h * phi1)]
        smooth = [[i for i in v.active if i not in signs]
                  for v, signs in zip(virtual_sensors, implicit)]
        self._smooth = T = _Terms(virtual_sensors, sensors, smooth)
        self._sign = R = _Terms(virtual_sensors, sensors, implicit)
        # Gu takes out of a reading what it has seen of the commands, so it is interpolated alike
        self._direct = bool(T.Gu.any() or R.Gu.any())

        # the linear flow as rows over (z, readings at both ends, commands at both ends and, if
        # direct, those held from there on): z at the end, then w and s at the beginning, the
        # middle and the end
        more = [np.zeros_like(B)] * (2 * self._direct)

        def flow(decay: np.ndarray, *gains: np.ndarray) -> np.ndarray:
            return np.concatenate(
                (decay, *(gain @ X for X in (J, B) for gain in gains), *more), axis=2)

        def seen(G: _Terms, z: np.ndarray, *weights: float) -> np.ndarray:
            rows = G.Gz @ z
            (L, m), k = (G.Gy.shape[2], G.Gu.shape[2]), G.Gz.shape[2]
            for i, weight in enumerate(weights):
                rows[..., k + i * L:k + (i + 1) * L] += weight * G.Gy
                if self._direct:
                    held = k + 2 * L + (2 + i) * m
                    rows[..., held:held + m] += weight * G.Gu
            return rows

        nothing = np.zeros_like(N)
        start = flow(nothing + np.eye(N.shape[1]), nothing, nothing)
        middle = flow(E_half, h / 2 * phi1_half - h / 4 * phi2_half, h / 4 * phi2_half)
        end = flow(E, h * (phi1 - phi2), h * phi2)
        rows = [end] + [seen(G, *at) for G in (T, R) for at in (
            (start, 1.0, 0.0), (middle, 0.5, 0.5), (end, 0.0, 1.0))]
        ends = np.cumsum([block.shape[1] for block in rows]).tolist()
        self._cuts = [slice(a, b) for a, b in zip([0, *ends], ends)]
        stacked = np.concatenate(rows, axis=1)
        self._of_z = np.ascontiguousarray(stacked[..., :N.shape[1]])
        self._of_data = np.ascontiguousarray(stacked[..., N.shape[1]:])

        # what the smooth terms add: in the middle, from there to the end, over the whole step
        self._half = h / 2 * phi1_half @ T.P
        self._w_half = T.Gz @ self._half
        self._w_carried = T.Gz @ (E_half - np.eye(N.shape[1])) @ self._half
        self._weights = np.concatenate((h * (phi1 - 3 * phi2 + 4 * phi3) @ T.P,
                                        h * (2 * phi2 - 4 * phi3) @ T.P,
                                        h * (4 * phi3 - phi2) @ T.P), axis=2)
        # what a sign held over the step, or over its first half, adds to z and takes from s
        self._push, self._push_half = h * phi1 @ R.P, h / 2 * phi1_half @ R.P
        self._stop, self._stop_half = -R.Gz @ self._push, -R.Gz @ self._push_half
        self._w_push, self._w_push_half = T.Gz @ self._push, T.Gz @ self._push_half
        self._s_first = R.Gz @ (h * phi1) @ T.P
        own = np.einsum('vii->vi', self._stop)
        self._still = _STUCK * own
        self._to_rest = self._push / np.where(own > 0.0, own, 1.0)[:, None, :]

    def __call__(self, z: np.ndarray, y0: np.ndarray, y1: np.ndarray, u0: np.ndarray,
                 u1: np.ndarray, u: np.ndarray, held0: np.ndarray = NOTHING,
                 held1: np.ndarray = NOTHING) -> tuple[np.ndarray, np.ndarray]:
        data = [y0, y1, u0, u1, *((held0, held1) if self._direct else ())]
        linear = _times(self._of_z, z) + self._of_data @ np.concatenate(data)
        end, w0, w_half, w1, s0, s_half, s1 = (linear[:, cut] for cut in self._cuts)
        outside = np.zeros(len(z), dtype=bool)
        if self._smooth.P.shape[2]:
            psi, outside = self._smooth, self._smooth.outside(w0, u)
            first = psi(w0, u)
            if s0.shape[1]:  # the smooth terms see the friction, to second order
                sigma = _resolve(self._stop, s1 + _times(self._s_first, first))
                w_half = w_half + _times(self._w_push_half, sigma)
                w1 = w1 + _times(self._w_push, sigma)
            second = psi(w_half + _times(self._w_half, first), u)
            third = psi(w_half + _times(self._w_half, second), u)
            last = psi(w1 + _times(self._w_carried, first) + 2 * _times(self._w_half, third), u)
            added = _times(self._weights, np.concatenate((first, second + third, last), axis=1))
            end = end + added
            s_half = s_half + _times(self._sign.Gz, _times(self._half, third))
            s1 = s1 + _times(self._sign.Gz, added)
        if s0.shape[1]:
            end = self._rub(end, s0, s_half, s1, y1, held1)
        return end, outside

    def _rub(self, end: np.ndarray, s0: np.ndarray, s_half: np.ndarray, s1: np.ndarray,
             y1: np.ndarray, held1: np.ndarray) -> np.ndarray:
        """
        Add the friction of one step to z (V, k) at its end.

        s (V, S): arguments of the signs without friction. What moves keeps its sign until the
        first zero crossing (a parabola through three points); from there on, and for what
        stands still, each sign is the one that belongs to its argument at the end of the step.
        """
        moving = np.where(np.abs(s0) > self._still, np.sign(s0), 0.0)
        sigma = _resolve(self._stop, s1, moving)
        s1 = s1 - _times(self._stop, sigma)
        end = end + _times(self._push, sigma)
        crossed = moving * s1 < 0.0
        if crossed.any():
            s_half = s_half - _times(self._stop_half, sigma)
            left = 1.0 - np.where(crossed, _zero(s0, s_half, s1), 1.0).min(axis=1)
            left = left[:, None, None]  # of the step, 0 where nothing crossed
            push = left * ((4.0 * self._push_half - self._push)
                           + 2.0 * left * (self._push - 2.0 * self._push_half))
            stop = -self._sign.Gz @ push
            after = _resolve(stop, s1 + _times(stop, sigma))
            end = end + _times(push, after - sigma)
            sigma = np.where(left[:, 0] > 0.0, after, sigma)
        resting = np.abs(sigma) < 1.0
        if resting.any():  # rounding must not leave a speed behind
            rest = _times(self._sign.Gz, end) + self._sign.Gy @ y1
            if self._direct:
                rest = rest + self._sign.Gu @ held1
            end = end + _times(self._to_rest, np.where(resting, rest, 0.0))
        return end


def _with_resolvent(v: VirtualSensor, integral: np.ndarray) -> list[int]:
    """Return the sign terms whose own effect on their argument within a step opposes it."""
    found = []
    for i in v.active:
        if set_valued(v.terms[i]) and not v.terms[i].slope.any():
            push = integral @ v.P[:, i]
            effect = float(v.Gz[i][0] @ push)
            if effect < -1e-9 * np.linalg.norm(v.Gz[i]) * np.linalg.norm(push):
                found.append(i)
    return found


def _resolve(stop: np.ndarray, s: np.ndarray, held: np.ndarray | None = None) -> np.ndarray:
    """
    Find sigma with sigma_i in Sign(s - stop sigma)_i, (V, S); where held is not 0 it stays so.

    One term: the soft threshold. Several: projected Gauss-Seidel, which converges when friction
    brakes mostly its own argument.
    """
    sigma = np.zeros_like(s) if held is None else held.copy()
    free = sigma == 0.0
    for _ in range(_SWEEPS):
        largest = 0.0
        for i in range(s.shape[1]):
            own = np.maximum(stop[:, i, i], 1e-300)
            rest = s[:, i] - (stop[:, i] * sigma).sum(axis=1) + stop[:, i, i] * sigma[:, i]
            new = np.where(free[:, i], np.clip(rest / own, -1.0, 1.0), sigma[:, i])
            largest = max(largest, float(np.abs(new - sigma[:, i]).max()))
            sigma[:, i] = new
        if s.shape[1] == 1 or not largest > 1e-13:
            break
    return sigma


def _zero(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Return where in 0..1 the parabola through (0, a), (1/2, b), (1, c) is 0, if a c < 0."""
    slope, bend = -3.0 * a + 4.0 * b - c, 2.0 * (a - 2.0 * b + c)
    turn = np.where(a < 0.0, -1.0, 1.0)  # as if a were positive: then this root is the first
    root = np.sqrt(np.maximum(slope**2 - 4.0 * a * bend, 0.0)) - turn * slope
    return np.clip(np.divide(2.0 * np.abs(a), root, out=np.ones_like(a), where=root > 0.0),
                   0.0, 1.0)
