"""
The controller of a machine that falls: hears its sensors on topics, says what its motor does.

Run as a process with a system's folder; which topics it hears may be remapped after --ros-args.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
import math
from pathlib import Path
import signal
import sys

import numpy as np
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from scipy.linalg import expm, solve_discrete_are

from vsensor_ros.lab.domain import by_hand, open_nodes
from vsensor_ros.lab.parameter_file import read_parameters
from vsensor_ros.lab.played_driver import drivers_of
from vsensor_ros.lab.wiring import wiring_of
from vsensor_ros.node.accessor import get_stamp
from vsensor_ros.node.private_rclpy import take_all, Waiting
from vsensor_ros.plant import load_plant, Plant
from vsensor_ros.simulate.balance import Balance, load_balance

ORIGIN = 1_000_000_000  # ns on /clock when a run begins; 0 would be none
LONGEST = 1_000_000_000  # ns of a wait


@dataclass(frozen=True, eq=False)
class Law:
    """
    The linear quadratic regulator of a plant whose commands act one period after its readings.

    The sensors read the states, all of them. K (m, n + m) weighs these and the last command.
    """

    K: NDArray[np.float64]
    states: NDArray[np.float64]     # (n, l): from readings to states
    travels: int                    # the state that goes to and fro
    story: Balance

    @classmethod
    def of(cls, plant: Plant, story: Balance) -> Law:
        """Compute the gain, with each deviation weighed by what the story calls even."""
        n, m = plant.B.shape
        held = expm(np.block([[plant.A, plant.B], [np.zeros((m, n + m))]]) * story.period)
        A = np.block([[held[:n]], [np.zeros((m, n + m))]])
        B = np.vstack([np.zeros((n, m)), np.eye(m)])
        costs = [1.0 / story.even.get(name, math.inf) ** 2 for name in plant.states]
        R = np.diag([1.0 / story.even[name] ** 2 for name in plant.inputs])
        S = solve_discrete_are(A, B, np.diag([*costs, *np.zeros(m)]), R)
        K = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
        return cls(K, np.linalg.inv(plant.C), plant.states.index(story.travels), story)

    def command(self, time: float, readings: NDArray[np.float64],
                before: Sequence[float]) -> list[float]:
        """
        Return the command for the period after the one that begins now.

        time [s] and readings (l,) are those of now, `before` (m,) is the command until then.
        """
        x = self.states @ readings
        phase = 2.0 * math.pi / self.story.to_and_fro
        x[self.travels] -= self.story.amplitude * math.sin(phase * time)
        return [float(u) for u in -self.K @ np.concatenate([x, before])]


def control(folder: Path, ros_args: Sequence[str]) -> None:
    """Answer the readings of each period with a command, stamped with the next; never returns."""
    plant = load_plant(folder / 'plant.yaml')
    law = Law.of(plant, load_balance(folder / 'demo.yaml', plant))
    parameters = read_parameters(folder / 'replacer.yaml')
    ports = wiring_of(parameters).ports
    sensors = [ports[name] for name in plant.sensors]
    period = round(law.story.period * 1e9)
    readings, command = np.zeros(len(sensors)), [0.0] * len(plant.inputs)
    with open_nodes('controller', ros_args=[*parameters.ros_args, *ros_args]) as (node,):
        [motor] = drivers_of(node, (ports[name] for name in plant.inputs))
        heard = {topic: node.create_subscription(kind, topic, by_hand, QoSProfile(depth=1000))
                 for topic, kind in {port.output: port.kind for port in sensors}.items()}
        stamps = dict.fromkeys(heard, 0)
        answered = 0
        with Waiting(list(heard.values()), node.context) as waiting:
            while True:
                waiting.wait(LONGEST)
                for topic, subscription in heard.items():
                    for message, _ in take_all(subscription):
                        stamps[topic] = get_stamp(message)
                        for i, port in enumerate(sensors):
                            # what is not there, or NaN, is held
                            if port.output == topic and isinstance(
                                    value := port.field.get(message), float):
                                readings[i] = value if math.isfinite(value) else readings[i]
                now = max(stamps.values())
                if now > answered and now == min(stamps.values()):
                    answered = now
                    command = law.command((now - ORIGIN) * 1e-9, readings, command)
                    motor.send(command, now + period)


if __name__ == '__main__':
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: sys.exit())
    control(Path(sys.argv[1]), sys.argv[3:])
