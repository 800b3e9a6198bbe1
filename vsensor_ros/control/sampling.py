"""
A machine between two samples of its controller, exactly: commands are held, dead times are kept.

The readings that a virtual sensor takes in meanwhile come as they are, without a controller's
sampling. Their errors are one a sample, interpolated as the bank does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from vsensor_ros.bad_input import BadInput
from vsensor_ros.control.machine import Machine
from vsensor_ros.observers.kinds.functional.discretise import phi_functions

MOST_REGISTERS = 500  # commands that are on their way
WHOLE = 1e-9  # of a sample


@dataclass(frozen=True, eq=False)
class Steps:
    """
    ``s+ = A s + B u + J n, yhat = C s + D u + M n`` at the samples; W: what else moves s.

    s (S,) are the machine's states and the commands on their way; u (c,) is what is told now; n
    (l,) is white noise of size 1. In a loop of continuous time it is the machine itself, n is
    per sqrt(Hz), and a single reading errs by M n (what is white noise has no size).
    """

    A: np.ndarray  # (S, S)
    B: np.ndarray  # (S, m)
    J: np.ndarray  # (S, l)
    C: np.ndarray  # (l, S)
    D: np.ndarray  # (l, m)
    M: np.ndarray  # (l, l)
    E: np.ndarray  # (l, l) the same as M, as it moves s through the controller
    W: np.ndarray  # (S, S) covariance, per sample, or per second


@dataclass(frozen=True, eq=False)
class Errors:
    """Noise of a plant: of single readings, how long these last [s, or steps], of its states."""

    reading: np.ndarray  # (l,)
    lasts: np.ndarray  # (l,)
    process: np.ndarray  # (n,) per sqrt(s), or per step


def as_it_is(here: Machine, columns: np.ndarray, errors: Errors) -> Steps:
    """Return a machine for a controller of continuous time; it has no dead times."""
    white = errors.reading * np.sqrt(errors.lasts)
    W = np.zeros(here.F.shape)
    W[:len(errors.process), :len(errors.process)] = np.diag(errors.process**2)
    return Steps(here.F, here.G @ columns, here.J * white, here.H, here.L @ columns,
                 here.M * errors.reading, here.M * white, W)


@dataclass(frozen=True, eq=False)
class Late:
    """Dead times [s]."""

    commands: np.ndarray  # (c,) of each column of B
    readings: np.ndarray  # (l,) of what the controller is told


def sampled(here: Machine, columns: np.ndarray, errors: Errors, late: Late, h: float,
            step: float | None) -> Steps:
    """
    Return a machine as a controller sees it that samples it each h [s].

    columns (2m, c): which commands a column of B stands for; step [s]: sample time of the plant,
    of which h is a multiple, None when it is continuous. A reading that tells of a command is
    taken just before the new one, if the plant is continuous. What the virtual sensors do to n
    goes by how long a reading lasts. Raises BadInput.
    """
    last = errors.lasts if step is not None else errors.lasts / h
    here = replace(here, J=here.J * errors.reading * np.sqrt(last), M=here.M * errors.reading)
    F, G, H, L = here.F, here.G @ columns, here.H, here.L @ columns
    total, count = G.shape
    # a command acts so many samples after it was given, and the rest of one later
    whole = np.floor(late.commands / h + WHOLE).astype(int)
    rest = np.where(late.commands - whole * h > WHOLE * h, late.commands - whole * h, 0.0)
    behind = (rest > 0.0) | ((step is None) & L.any(axis=0))  # the one before is of interest
    # a reading tells of a time so much after a sample so many samples ago
    ago = np.ceil(late.readings / h - WHOLE).astype(int)
    since = np.where(ago * h - late.readings > WHOLE * h, ago * h - late.readings, 0.0)
    size = total + int(np.sum(whole + behind) + np.sum(ago))
    if size - total > MOST_REGISTERS:
        raise BadInput('plant', 'delay', f'is {size - total} samples of the controller in all',
                       f'keep it within {MOST_REGISTERS}: give the controller a longer '
                       'sample_time')
    firsts = total + np.concatenate([[0], np.cumsum(whole + behind)])

    def rows(of_xi: np.ndarray, of_new: np.ndarray, of_old: np.ndarray) -> np.ndarray:
        """Place what states, commands that act, and those before them count for, in (A, B)."""
        placed = np.zeros((len(of_xi), size + count))
        placed[:, :total] = of_xi
        for i in range(count):
            placed[:, firsts[i] + whole[i] - 1 if whole[i] else size + i] += of_new[:, i]
            if behind[i]:
                placed[:, firsts[i] + whole[i]] += of_old[:, i]
        return placed
    both, seen = np.zeros((size, size + count)), rows(H, L * ~behind, L * behind)  # A, B; C, D
    both[:total] = rows(*_moved(F, G, rest, h, step))
    for i in range(count):
        _queue(both, firsts[i], whole[i] + behind[i], np.eye(1, size + count, size + i)[0])
    J, M = np.zeros((size, len(H))), here.M.copy()
    J[:total], done = _stirred(here, h, step)
    W = np.zeros((size, size))
    W[:total, :total] = _gathered(F, errors.process, h, step)
    if step is not None:  # of readings that the controller does not look at
        W[:total, :total] += _gathered(F, here.J, h - step, step)
    first, between = firsts[-1], []
    for i, samples in enumerate(ago):
        if not samples:
            M[i] += H[i] @ done
            continue
        row, J[first], M[i] = seen[i], H[i] @ done + M[i], 0.0
        if since[i]:
            Phi, new, old = _moved(F, G, rest, since[i], step)
            acts = rest <= since[i]
            row = rows(H[[i]] @ Phi, H[[i]] @ new + L[[i]] * acts, H[[i]] @ old + L[[i]] * ~acts)
            J[first] += H[i] @ ((Phi - np.eye(total)) @ done
                                + _flow(F, since[i], step)[1] @ here.J)
            between.append((since[i], H[i], first))
        _queue(both, first, samples, row)
        first += samples
        seen[i] = np.eye(1, size + count, first - 1)[0]
    # what moves the states has moved readings between samples, too
    for time, row, place in between:
        until = _gathered(F, errors.process, time, step)
        W[place, :total] = W[:total, place] = _flow(F, h - time, step)[0] @ until @ row
        for other, later, at in between:
            if other >= time:
                W[at, place] = W[place, at] = later @ _flow(F, other - time, step)[0] @ until @ row
    return Steps(both[:, :size], both[:, size:], J, seen[:, :size], seen[:, size:], M, M, W)


def _queue(both: np.ndarray, first: int, length: int, row: np.ndarray) -> None:
    """Put a row into the first of some states, each of which hands on to the next."""
    if length:
        both[first] = row
        both[first + 1:first + length, first:first + length - 1] = np.eye(length - 1)


def _moved(F: np.ndarray, G: np.ndarray, rest: np.ndarray, time: float,
           step: float | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """
    Return what a time [s] after a sample makes of states, commands, and those before them.

    rest (c,) [s]: until when the commands before act.
    """
    Phi, whole = _flow(F, time, step)
    new, old = whole @ G, np.zeros(G.shape)
    for i, until in enumerate(rest):
        if until >= time:
            new[:, i], old[:, i] = 0.0, new[:, i]
        elif until:
            after, before = _flow(F, time - until, step), _flow(F, until, step)
            new[:, i], old[:, i] = after[1] @ G[:, i], after[0] @ before[1] @ G[:, i]
    return Phi, new, old


def _stirred(here: Machine, h: float, step: float | None) -> tuple[np.ndarray, np.ndarray]:
    """
    Return what a reading's error does to the states in a sample, and what it has done before.

    The states are less the latter: errors are interpolated, so that it is there with the reading.
    """
    if step is not None:
        return np.linalg.matrix_power(here.F, round(h / step) - 1) @ here.J, np.zeros(here.J.shape)
    Phi, one, ramp, _ = phi_functions(here.F, h)
    done = h * ramp @ here.J
    return Phi @ done + h * (one - ramp) @ here.J, done


def _flow(F: np.ndarray, time: float, step: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return what a time [s] makes of the states, and of commands that are held over it."""
    n = len(F)
    held = np.eye(n) * (step is not None)
    both = np.block([[F, np.eye(n)], [np.zeros((n, n)), held]])
    moved = (expm(both * time) if step is None
             else np.linalg.matrix_power(both, round(time / step)))
    return moved[:n, :n], moved[:n, n:]


def _gathered(F: np.ndarray, drive: np.ndarray, time: float, step: float | None) -> np.ndarray:
    """
    Return the covariance that white noise has gathered in a time [s].

    drive: (n,) per sqrt(s), or step, of the first states, or (N, ..) by its sources.
    """
    if drive.ndim == 1:
        drive = np.vstack([np.diag(drive), np.zeros((len(F) - len(drive), len(drive)))])
    n, Q = len(F), drive @ drive.T
    if step is None:
        halvings = max(0, int(np.ceil(np.log2(max(1e-300, np.linalg.norm(F, 1) * time)))) + 1)
        both = expm(time / 2.0**halvings * np.block([[-F, Q], [np.zeros((n, n)), F.T]]))
        Phi = np.asarray(both[n:, n:].T)
        W = np.asarray(Phi @ both[:n, n:])
        for _ in range(halvings):
            W = W + Phi @ W @ Phi.T
            Phi = np.asarray(Phi @ Phi)
        return np.asarray(0.5 * (W + W.T))
    W = np.zeros((n, n))
    for _ in range(round(time / step)):
        W = F @ W @ F.T + Q
    return W
