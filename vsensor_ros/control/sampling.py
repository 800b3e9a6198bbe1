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


def sampled(here: Machine, columns: np.ndarray, errors: Errors, delay: np.ndarray,
            h: float, step: float | None) -> Steps:
    """
    Return a machine as a controller sees it that samples it each h [s].

    columns (2m, c): which commands a column of B stands for; delay (c,) [s] of these commands;
    step [s]: sample time of the plant, of which h is a multiple, None when it is continuous. A
    reading that tells of a command is taken just before the new one, if the plant is continuous.
    What the virtual sensors do to n goes by how long a reading lasts.
    """
    process = errors.process
    last = errors.lasts if step is not None else errors.lasts / h
    here = replace(here, J=here.J * errors.reading * np.sqrt(last), M=here.M * errors.reading)
    G, L = here.G @ columns, here.L @ columns
    total = len(here.F)
    Phi, whole = _flow(here.F, h, step)
    chains, late, now = [], np.zeros(G.shape), np.zeros(G.shape)
    for i, seconds in enumerate(delay):
        samples = int(np.floor(seconds / h + WHOLE))
        rest = max(0.0, float(seconds) - samples * h)
        if rest > WHOLE * h:
            after, before = _flow(here.F, h - rest, step), _flow(here.F, rest, step)
            now[:, i], late[:, i] = after[1] @ G[:, i], after[0] @ before[1] @ G[:, i]
        else:
            rest, now[:, i] = 0.0, whole @ G[:, i]
        behind = bool(rest) or (step is None and bool(L[:, i].any()))
        chains.append((samples, samples + behind, behind))
    count = sum(length for _, length, _ in chains)
    if count > MOST_REGISTERS:
        raise BadInput('plant', 'delay', f'is {count} samples of the controller in all',
                       f'keep it within {MOST_REGISTERS}: give the controller a longer '
                       'sample_time')
    A = np.zeros((total + count, total + count))
    B, C = np.zeros((len(A), len(delay))), np.zeros((len(here.H), len(A)))
    D = np.zeros((len(here.H), len(delay)))
    A[:total, :total], C[:, :total] = Phi, here.H
    first = total
    for i, (samples, length, behind) in enumerate(chains):
        if length:
            B[first, i] = 1.0
            A[first + 1:first + length, first:first + length - 1] = np.eye(length - 1)
        source, at = (A, first + samples - 1) if samples else (B, i)
        source[:total, at] += now[:, i]
        if behind:
            A[:total, first + samples] += late[:, i]
            C[:, first + samples] += L[:, i]
        elif samples:
            C[:, at] += L[:, i]
        else:
            D[:, i] += L[:, i]
        first += length
    J, M = np.zeros((len(A), here.J.shape[1])), here.M
    W = np.zeros(A.shape)
    if step is None:
        _, one, ramp, _ = phi_functions(here.F, h)
        # with s less what the newest reading's error has done to it already
        new, old = h * ramp @ here.J, h * (one - ramp) @ here.J
        J[:total], M = Phi @ new + old, here.M + here.H @ new
        W[:total, :total] = _gathered(here.F, process, h)
    else:
        steps = round(h / step)
        J[:total] = np.linalg.matrix_power(here.F, steps - 1) @ here.J
        push: np.ndarray = np.zeros((total, len(process)))
        push[:len(process)] = np.diag(process)
        for _ in range(steps):
            W[:total, :total] += push @ push.T
            push = here.F @ push
        more = here.J
        for _ in range(steps - 1):  # of readings that the controller does not look at
            W[:total, :total] += more @ more.T
            more = here.F @ more
    return Steps(A, B, J, C, D, M, M, W)


def _flow(F: np.ndarray, time: float, step: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return what a time [s] makes of the states, and of commands that are held over it."""
    n = len(F)
    held = np.eye(n) * (step is not None)
    both = np.block([[F, np.eye(n)], [np.zeros((n, n)), held]])
    moved = (expm(both * time) if step is None
             else np.linalg.matrix_power(both, round(time / step)))
    return moved[:n, :n], moved[:n, n:]


def _gathered(F: np.ndarray, process: np.ndarray, h: float) -> np.ndarray:
    """Return the covariance that white noise (n,) per sqrt(s) has gathered in h [s]."""
    Q = np.zeros(F.shape)
    Q[:len(process), :len(process)] = np.diag(process**2)
    halvings = max(0, int(np.ceil(np.log2(max(1e-300, np.linalg.norm(F, 1) * h)))) + 1)
    dt, n = h / 2.0**halvings, len(F)
    both = expm(dt * np.block([[-F, Q], [np.zeros((n, n)), F.T]]))
    Phi = np.asarray(both[n:, n:].T)
    W: np.ndarray = Phi @ both[:n, n:]
    for _ in range(halvings):
        W = W + Phi @ W @ Phi.T
        Phi = np.asarray(Phi @ Phi)
    return np.asarray(0.5 * (W + W.T))
