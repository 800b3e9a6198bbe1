"""A table and a bag go through the commands alone: wired once, then fitted."""

import os
import sys

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)  # before any message class is loaded

import numpy as np
from plants import AXIS, recorded, torques, TRUTH, written
import pytest

from vsensor_ros import load_plant
from vsensor_ros.command.fit import main as fit
from vsensor_ros.command.recording import main as recording

LIGHT = AXIS.replace(' - dry*sign(speed)', '').replace(
    '  dry: {value: 0.1, fit: [0.0, 2.0]}\n', '')
WIRING = """
/**:
  ros__parameters:
    design_file: none.json
    sensors:
      encoder: {topic: joints, type: sensor_msgs/msg/JointState, field: 'position[load]'}
    commands:
      torque: {topic: torque, type: std_msgs/msg/Float64, field: data}
"""


def write_table(folder, run):
    """Write a table whose columns have names of their own, and say which they are."""
    t, y, u = run.tracks['encoder'].times, *(run.tracks[n].values for n in ('encoder', 'torque'))
    np.savetxt(folder / 'run.csv', np.column_stack([t, y, u]), delimiter=',', comments='',
               header='t,pos [rad],motor')
    (folder / 'wire.yaml').write_text('encoder: pos\ntorque: motor\n')
    return folder / 'run.csv'


def write_bag(folder, run):
    """Write a bag of a joint's readings and of what the motor was told, in the order of time."""
    rosbag2 = pytest.importorskip('rosbags.rosbag2')
    from rosbags.typesys import get_typestore, Stores
    store = get_typestore(Stores.ROS2_JAZZY)
    T, JOINTS, TORQUE = store.types, 'sensor_msgs/msg/JointState', 'std_msgs/msg/Float64'
    writer = rosbag2.Writer(folder / 'run', version=9)
    with writer:
        joints = writer.add_connection('/joints_raw', JOINTS, typestore=store)
        torque = writer.add_connection('/torque', TORQUE, typestore=store)
        none = np.zeros(0)
        for t, y, u in zip(run.tracks['encoder'].stamps.tolist(), run.tracks['encoder'].values,
                           run.tracks['torque'].values.tolist()):
            stamp = 1_700_000_000_000_000_000 + t
            header = T['std_msgs/msg/Header'](
                stamp=T['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9)), frame_id='')
            said = T[JOINTS](header, ['load'], np.array([y]), none, none)
            writer.write(joints, stamp, store.serialize_cdr(said, JOINTS))
            writer.write(torque, stamp, store.serialize_cdr(T[TORQUE](u), TORQUE))
    (folder / 'wire.yaml').write_text(WIRING)
    return folder / 'run'


@pytest.mark.parametrize('write', [write_table, write_bag], ids=['table', 'bag'])
def test_a_recording_is_wired_and_then_fitted(tmp_path, write):
    run = recorded(written(tmp_path, LIGHT, inertia=0.8, drag=0.6),
                   torques(300, 0.02, np.random.default_rng(8)))
    path, dataset, out = write(tmp_path, run), tmp_path / 'axis.yaml', tmp_path / 'fitted.yaml'
    assert recording([str(path), '--wire', str(tmp_path / 'wire.yaml'),
                      '--dataset', str(dataset)]) == 0
    assert fit([str(written(tmp_path, LIGHT)), str(dataset), '--horizon', '0.5', '--tries', '1',
                '-o', str(out)]) == 0
    found = load_plant(out).parameters
    assert [found['inertia'], found['drag']] == pytest.approx(
        [TRUTH['inertia'], TRUTH['drag']], rel=0.02)
