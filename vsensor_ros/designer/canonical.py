"""
The papers' designs: rows of Phi with A_* in Jordan or in identification canonical form.

Both solve ``Phi A = A_* Phi + J_* C_*`` with ``Phi D = 0`` for outputs ``C_* = [C0; V]``, where V
is the functional that the virtual sensor itself provides. What becomes of the spectrum when v is
fed back is decided in ``observer.py``: only N counts.
"""

from __future__ import annotations

import numpy as np

from vsensor_ros.designer.subspaces import left_kernel


def jordan_rows(A: np.ndarray, C: np.ndarray, D: np.ndarray, eigenvalue: float,
                ) -> tuple[np.ndarray, np.ndarray]:
    """
    Solve ``phi A = eigenvalue phi + j C`` with ``phi D = 0`` for all rows phi and j.

    A (n, n), C (l, n), D (n, d). Returns orthonormal solutions as phi (s, n) and j (s, l); their
    number s is often larger than one. Source: S (19), R (14).
    """
    L0 = left_kernel(D)
    size = max(np.linalg.norm(A, 2) if A.size else 0.0, abs(eigenvalue), np.finfo(float).tiny)
    rows = left_kernel(np.vstack([(L0 @ A - eigenvalue * L0) / size, C]))
    return rows[:, :len(L0)] @ L0, -rows[:, len(L0):] * size


def identification_rows(A: np.ndarray, C: np.ndarray, D: np.ndarray, k: int,
                        C_first: np.ndarray | None = None) -> list[tuple[np.ndarray, np.ndarray]]:
    """
    Solve ``phi_i A = phi_{i+1} + j_i C`` (i < k), ``phi_k A = j_k C`` with ``phi_i D = 0``.

    A (n, n), C (l, n), D (n, d). With ``C_first`` (the healthy outputs) phi_1 is a combination
    of its rows, so that a residual exists (R (9)); without, phi_1 is free (S (14), D (21)).
    Returns a basis of the solutions, each as Phi (k, n) and J (k, l), without those of phi_1 = 0.
    """
    n, l0 = len(A), len(C)
    first = np.eye(n) if C_first is None else C_first
    size = max(np.linalg.norm(A, 2), np.finfo(float).tiny)
    A = A / size  # powers of A keep their size; undone below
    powers = [np.eye(n)]
    for _ in range(k):
        powers.append(powers[-1] @ A)
    W = np.vstack([first @ powers[k], *(C @ powers[k - i] for i in range(1, k + 1))])
    D_k = np.vstack([
        np.hstack([first @ powers[j] @ D for j in range(k)]),
        *(np.hstack([np.zeros((l0, D.shape[1])) if j < i else C @ powers[j - i] @ D
                     for j in range(k)]) for i in range(1, k + 1))])
    solutions = []
    for row in left_kernel(np.hstack([W, D_k])):
        phi = row[:len(first)] @ first
        if np.linalg.norm(phi) < 1e-9:
            continue
        Phi, J = [phi], []
        for i in range(k):
            j = -row[len(first) + i * l0:len(first) + (i + 1) * l0]
            J.append(j)
            Phi.append(Phi[-1] @ A - j @ C)
        # back from A/size: phi_i grows by size^(i-1), j_i by size^i
        grow = size ** np.arange(k)
        solutions.append((np.array(Phi[:k]) * grow[:, None],
                          np.array(J) * (grow * size)[:, None]))
    return solutions
