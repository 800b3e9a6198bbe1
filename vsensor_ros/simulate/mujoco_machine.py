"""A machine that MuJoCo moves, and what its sensors say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.bad_input import BadInput
from vsensor_ros.text_file import read_text

LARGEST_FILE = 2**20  # bytes


class NoMujoco(BadInput):
    """MuJoCo is not installed."""


class MujocoMachine:
    """
    A model (MJCF) whose sensors and motors are called as those of a plant.

    A sensor's `noise` in the model is its standard deviation, its first `user` number, if any,
    what its readings are multiples of (0: of nothing).
    """

    def __init__(self, path: Path, sensors: Sequence[str], inputs: Sequence[str],
                 initial: Mapping[str, float], gusts: Mapping[str, float], seed: int) -> None:
        """
        Begin at rest, with each joint at `initial`, else at 0; raise BadInput or NoMujoco.

        gusts: standard deviation of what pushes each joint [N or N m].
        """
        try:
            import mujoco
        except ImportError as error:
            raise NoMujoco('mujoco', '', f'cannot be loaded ({error})',
                           'pip install mujoco, or run in the .venv that make sets up') from None
        self._step = mujoco.mj_step
        self._forward = mujoco.mj_forward
        try:
            self.model = mujoco.MjModel.from_xml_string(
                read_text(path, '', 'give a model in MJCF', LARGEST_FILE))
        except ValueError as error:
            if isinstance(error, BadInput):
                raise
            raise BadInput(path, '', f'is no model: {error}', 'mend it') from None
        self.data = mujoco.MjData(self.model)

        def find(kind: int, names: Sequence[str], called: str) -> list[int]:
            found = [int(mujoco.mj_name2id(self.model, kind, name)) for name in names]
            for name, number in zip(names, found):
                if number < 0:
                    raise BadInput(path, name, f'is no {called} of the model', 'add it')
            return found
        objects = mujoco.mjtObj
        numbers = find(objects.mjOBJ_SENSOR, sensors, 'sensor')
        motors = find(objects.mjOBJ_ACTUATOR, inputs, 'actuator')
        self._at = self.model.sensor_adr[numbers]
        self._noise = self.model.sensor_noise[numbers]
        steps = self.model.sensor_user[numbers, 0] if self.model.nuser_sensor else \
            np.zeros(len(numbers))
        self._stepped = steps > 0.0
        self._steps = np.where(self._stepped, steps, 1.0)
        self._motors = motors
        self._gusts = np.zeros(self.model.nv)
        for joint, push in zip(find(objects.mjOBJ_JOINT, list(gusts), 'joint'), gusts.values()):
            self._gusts[self.model.jnt_dofadr[joint]] = push
        self._random = np.random.default_rng(seed)
        for joint, place in zip(find(objects.mjOBJ_JOINT, list(initial), 'joint'),
                                initial.values()):
            self.data.qpos[self.model.jnt_qposadr[joint]] = place
        self._forward(self.model, self.data)

    def truth(self) -> NDArray[np.float64]:
        """Return what the sensors would read if they were perfect."""
        return np.array(self.data.sensordata[self._at])

    def readings(self) -> NDArray[np.float64]:
        """Return what the sensors read, with noise and in steps."""
        noisy = self.truth() + self._noise * self._random.standard_normal(len(self._at))
        return np.where(self._stepped, np.round(noisy / self._steps) * self._steps, noisy)

    def move(self, commands: Sequence[float], period: float) -> None:
        """Let time pass, with these commands and a new gust."""
        self.data.ctrl[self._motors] = commands
        self.data.qfrc_applied[:] = self._gusts * self._random.standard_normal(self.model.nv)
        for _ in range(round(period / self.model.opt.timestep)):
            self._step(self.model, self.data)
        self._forward(self.model, self.data)
