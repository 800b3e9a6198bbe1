"""
Write a bag of a simulated base on two wheels, whose gyro and position are stamped 0.2 s late.

    python -m benchmark.base_bag FOLDER

FOLDER/base is the bag (rosbag2, mcap). docs/own_machine.md goes on from there with commands alone.
The truth is in PARAMETERS, and in none of the files.
"""

from __future__ import annotations

from pathlib import Path
import sys

import numpy as np

PARAMETERS = {'radius': 0.12, 'track': 0.5, 'lag': 0.15}
BIAS = 0.01  # rad/s, of the gyro
LATE = 0.2  # s, of the stamps of gyro and position
SECONDS, RATE = 150.0, 100.0  # of the simulation
BEGIN = 1_700_000_000_000_000_000  # ns
NOISE = {'x': 0.01, 'y': 0.01, 'yaw': 0.01, 'gyro': 0.01, 'wheel_left': 0.05, 'wheel_right': 0.05}
SLIP = 0.002  # m and rad per sqrt(s)


def driven(seed: int = 1) -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
    """Return times (T,), set points (T, 2) of the wheels, and what is true of each sensor (T,)."""
    random, h = np.random.default_rng(seed), 1.0 / RATE
    t = np.arange(round(SECONDS * RATE)) * h
    held = round(2.0 * RATE)
    set_points = np.repeat(random.uniform(1.0, 8.0, (len(t) // held + 1, 2)), held, axis=0)
    set_points = set_points[:len(t)]
    radius, track, lag = PARAMETERS.values()
    x, rows = np.zeros(5), []
    for u in set_points:
        left, right = x[3:]
        speed, rate = radius / 2.0 * (left + right), radius / track * (right - left)
        rows.append([*x[:3], rate + BIAS, left, right])
        middle = x[2] + rate * h / 2.0
        slip = SLIP * np.sqrt(h) * random.standard_normal(3)
        x = np.array([*(x[:3] + slip + h * np.array([
            speed * np.cos(middle), speed * np.sin(middle), rate])),
            *(u + (x[3:] - u) * np.exp(-h / lag))])
    return t, set_points, dict(zip(NOISE, np.array(rows).T))


def write(path: Path, seed: int = 1) -> None:
    """Write the bag."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    T = store.types
    t, set_points, true = driven(seed)
    random = np.random.default_rng(seed + 100)
    said = {name: values + NOISE[name] * random.standard_normal(len(t))
            for name, values in true.items()}
    Header, Time = T['std_msgs/msg/Header'], T['builtin_interfaces/msg/Time']
    Vector3, Quaternion = T['geometry_msgs/msg/Vector3'], T['geometry_msgs/msg/Quaternion']
    none, unknown = np.zeros(0), np.zeros(9)

    def header(stamp: int) -> object:
        return Header(Time(*divmod(stamp, 10**9)), '')

    def turned(yaw: float) -> object:
        return Quaternion(0.0, 0.0, float(np.sin(yaw / 2.0)), float(np.cos(yaw / 2.0)))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        kinds = {'/wheels': 'sensor_msgs/msg/JointState', '/imu': 'sensor_msgs/msg/Imu',
                 '/pose': 'geometry_msgs/msg/PoseStamped',
                 '/wheel_commands': 'sensor_msgs/msg/JointState'}
        topics = {topic: writer.add_connection(topic, kind, typestore=store)
                  for topic, kind in kinds.items()}

        def send(topic: str, recorded: int, message: object) -> None:
            writer.write(topics[topic], recorded, store.serialize_cdr(message, kinds[topic]))
        for k in range(0, len(t), 2):
            now = BEGIN + round(t[k] * 1e9)
            send('/wheel_commands', now, T[kinds['/wheel_commands']](
                header(now), ['left', 'right'], none, set_points[k], none))
            turning = np.array([said['wheel_left'][k], said['wheel_right'][k]])
            send('/wheels', now, T[kinds['/wheels']](
                header(now), ['left', 'right'], none, turning, none))
            if t[k] < LATE:
                continue
            old = k - round(LATE * RATE)
            send('/imu', now, T[kinds['/imu']](
                header(now), turned(0.0), unknown, Vector3(0.0, 0.0, said['gyro'][old]), unknown,
                Vector3(0.0, 0.0, 9.81), unknown))
            if k % 10 == 0:
                position = T['geometry_msgs/msg/Point'](said['x'][old], said['y'][old], 0.0)
                send('/pose', now, T[kinds['/pose']](header(now), T['geometry_msgs/msg/Pose'](
                    position, turned(said['yaw'][old]))))


def main() -> int:
    """Write the bag into a folder."""
    if len(sys.argv) != 2:
        print('benchmark.base_bag: name a folder', file=sys.stderr)
        return 2
    write(Path(sys.argv[1]) / 'base')
    return 0


if __name__ == '__main__':
    sys.exit(main())
