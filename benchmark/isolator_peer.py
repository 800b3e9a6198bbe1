"""What most robots do: an extended Kalman filter of all states, with a 5 sigma gate per sensor."""

from __future__ import annotations

import numpy as np

from benchmark.isolator_plants import Case, exact, Floats, PERIOD

GATE = 5.0  # sigma
IN_A_ROW = 3  # rejected readings of a sensor, from which on it is blamed


class Peer:
    """One filter a machine (m), on nominal parameters; sensors are gated and taken in turn."""

    def __init__(self, case: Case, state: Floats) -> None:
        self.case, self.x = case, state.copy()
        m, n = state.shape
        nominal = case.parameters[None]
        self.parameters = exact(nominal) if case.name == 'drive' else nominal
        # the model errs by some percent of each state's motion, and unknown inputs act on it
        unknown = np.abs(case.plant.D) @ np.array(case.unknown) if case.unknown else 0.0
        moves = {'servo': [1.0, 2.0, 2.0], 'tank': [0.3] * 3,
                 'drive': [5.0, 1.0, 5.0, 5.0, 30.0]}[case.name]
        self.q = np.diag((PERIOD * (0.02 * np.array(moves) + unknown))**2)
        self.p = np.tile(self.q * 10, (m, 1, 1))
        self.rejected = np.zeros((m, len(case.noise)), dtype=np.int64)

    def start(self, machine: int, state: Floats) -> None:
        """Let the filter of a machine start anew, in this state (n,)."""
        self.x[machine], self.p[machine], self.rejected[machine] = state, self.q * 10, 0

    def step(self, readings: Floats, commands: Floats) -> np.ndarray:
        """Go on to these readings (m, l); return who is blamed (m, l)."""
        m, n = self.x.shape
        small = 1e-6
        around = np.concatenate([self.x, *(self.x + small * row for row in np.eye(n))])
        moved = self.case.step(around, np.tile(commands, (n + 1, 1)),
                               np.zeros((len(around), max(1, len(self.case.unknown)))),
                               np.repeat(self.parameters, len(around), axis=0))
        self.x = moved[:m]
        slope = np.moveaxis((moved[m:].reshape(n, m, n) - self.x) / small, 0, 2)
        p = slope @ self.p @ slope.transpose(0, 2, 1) + self.q
        for j, (row, noise) in enumerate(zip(self.case.plant.C, self.case.noise)):
            innovation = readings[:, j] - self.x @ row
            pc = p @ row
            s = pc @ row + noise**2
            taken = innovation**2 <= GATE**2 * s
            gain = np.where(taken[:, None], pc / s[:, None], 0.0)
            self.x = self.x + gain * innovation[:, None]
            p = p - gain[:, :, None] * pc[:, None, :]
            self.rejected[:, j] = np.where(taken, 0, self.rejected[:, j] + 1)
        self.p = (p + p.transpose(0, 2, 1)) / 2
        return self.rejected >= IN_A_ROW
