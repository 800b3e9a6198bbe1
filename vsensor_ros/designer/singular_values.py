"""The papers' method of singular values, where nothing can be decoupled."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vsensor_ros.designer.canonical import identification_rows
from vsensor_ros.designer.disturbance import graded, told
from vsensor_ros.designer.existence import examine
from vsensor_ros.designer.observer import build, close_loop, knows_arguments
from vsensor_ros.designer.papers import with_residual
from vsensor_ros.designer.problem import Problem
from vsensor_ros.designer.relaxation import decouple
from vsensor_ros.designer.sentences import say
from vsensor_ros.observers import Refusal, VirtualSensor
from vsensor_ros.reason import Reason


def singular(problem: Problem) -> VirtualSensor | Refusal:
    """
    Return what the papers' method of singular values finds.

    Among the identification canonical forms of order k = 1, 2, .. without decoupling, x Nw, that
    of least |x Nw Dk| for |x| = 1: it depends on units, and neither v nor stability is asked for,
    so that it is left to chance whether v can be had of it. Source: method 2 (SVD fallback).
    """
    relaxed = decouple(problem, (), None)
    if relaxed is None:
        obstruction = examine(problem).obstruction
        return Refusal(problem.channel, problem.fault_set, say(obstruction) if obstruction else '')
    easier = relaxed.problem
    D = problem.plant.D / easier.scale[:, None]
    for k in range(1, len(easier.A) + 1):
        solutions = [Phi for Phi, _ in identification_rows(
            easier.A, easier.C_star, np.zeros((len(easier.A), 0)), k)]
        if not solutions:
            continue
        disturbed = np.array([(Phi @ D).ravel() for Phi in solutions])
        x = np.linalg.svd(disturbed)[0][:, -1]
        Phi = np.einsum('s,skn->kn', x, np.array(solutions))
        candidate = close_loop(easier, Phi) if knows_arguments(easier, Phi) else None
        if candidate is None:
            continue
        found = [sensor for c in (candidate, *with_residual(easier, candidate))
                 if (sensor := build(easier, c, 'svd')) is not None]
        if found:
            sensor = min((graded(problem, s) for s in found), key=lambda s: s.disturbance_gain)
            return replace(sensor, method=f'svd; {told(problem, relaxed.kept, sensor)}')
    return Refusal(problem.channel, problem.fault_set,
                   say(Reason.of('none by singular values')))
