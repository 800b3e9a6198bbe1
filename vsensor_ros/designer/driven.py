"""
The modes that stay, behind a virtual sensor of what drives them.

Where one functional drives them all, as a speed does a position, the whole search for virtual
sensors answers how that one is had at little order. Source: method 3.12.
"""

from __future__ import annotations

import numpy as np

from vsensor_ros.designer.existence import avoidable_signs, examine, hidden_unstable_modes
from vsensor_ros.designer.observer import Candidate
from vsensor_ros.designer.order_noise import search_orders
from vsensor_ros.designer.problem import pose, Problem
from vsensor_ros.designer.quotient import Quotient
from vsensor_ros.designer.subspaces import left_kernel, RANK_TOLERANCE, solve_left, unobservable
from vsensor_ros.observers import VirtualSensor

NAME = 'drive'  # of what drives the modes; it never leaves this file


def driven(problem: Problem, known: Quotient) -> Candidate | None:
    """
    Return the modes that stay of a quotient behind the virtual sensor of what drives them.

    None where that is more than one functional, where v needs others besides, or where it has no
    virtual sensor itself.
    """
    lost = hidden_unstable_modes(known, problem)[0]
    stays = lost.T @ known.A @ lost
    hidden = unobservable(stays, known.v @ lost)
    W = (left_kernel(hidden) if hidden.shape[1] else np.eye(len(stays))) @ lost.T
    A = W @ known.A @ W.T
    # what of v and of their motion is neither in these modes nor measured
    rows = np.vstack([W @ known.A - A @ W, known.v - known.v @ W.T @ W])
    measured = solve_left(known.E, rows)
    rest = rows - measured @ known.E
    _, sizes, directions = np.linalg.svd(rest)
    if not sizes.size or sizes[0] <= RANK_TOLERANCE or (sizes[1:] > RANK_TOLERANCE).any():
        return None
    drive = _single(problem, directions[0] @ known.Phi)
    if drive is None:
        return None
    gain = rest @ directions[0][:, None]  # (h + 1, 1)
    told = measured @ known.R + gain @ drive.Q
    k, h = len(drive.N), len(W)
    N = np.block([[drive.N, np.zeros((k, h))], [gain[:h] @ drive.Cv, A]])
    return Candidate(
        np.vstack([drive.Phi, W @ known.Phi]), N, np.vstack([drive.J, W @ known.J + told[:h]]),
        np.hstack([gain[h:] @ drive.Cv, known.v @ W.T]), known.q + told[h:])


def _single(problem: Problem, row: np.ndarray) -> Candidate | None:
    """Return the virtual sensor of a row (n,) of the scaled states, in scaled coordinates."""
    one = pose(problem.plant, problem.fault_set, NAME, (row / problem.scale)[None, :])
    existence = examine(one)
    if existence.quotient is None:
        return None
    found = search_orders(one, existence, avoidable_signs(one), 'quiet', None, None)
    if not isinstance(found, VirtualSensor):
        return None
    return Candidate(found.Phi * problem.scale, found.N, found.J * problem.y0_size, found.Cv,
                     found.Q * problem.y0_size)
