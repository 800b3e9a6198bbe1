"""
Bags of all forms, wired by a parameter file, say what was put into them.

They are of a rig whose message package is installed nowhere, written here as others write them.
"""

import os
import sqlite3
import sys

os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)  # before any message class is loaded

import numpy as np
import pytest

pytest.importorskip('rclpy')
pytest.importorskip('rosbags')
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
from rosbags.typesys import get_types_from_msg, get_typestore, Stores

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import message_type
from vsensor_ros.recordings import Dataset, load_dataset
from vsensor_ros.recordings.bag import open_bag
from vsensor_ros.recordings.surveying import survey

COUNT = 50
BEGIN = 1_700_000_000_000_000_000  # ns
MSG = 'rig_of_ours_msgs/msg/Drive'
DRIVE = """
uint8 BROKEN=3
std_msgs/Header header
string label
rig_of_ours_msgs/Axis[] axes
float32[3] currents
bool on
"""
AXIS = 'string name\nfloat64 angle\nfloat64[] history\n'
STEP = 10_000_000  # ns
LATE = 2_000_000  # ns from a stamp to the recording

WIRING = """
/**:
  ros__parameters:
    design_file: none.json
    sensors:
      angle: {topic: rig/state, type: rig_of_ours_msgs/msg/Drive, field: 'axes[1].angle'}
      current: {topic: rig/state, type: rig_of_ours_msgs/msg/Drive, field: 'currents[2]'}
      turn: {topic: imu, type: sensor_msgs/msg/Imu, field: 'yaw(orientation)'}
      speed: {topic: joints, type: sensor_msgs/msg/JointState, field: 'velocity[left]'}
    commands:
      volt: {topic: volt, type: std_msgs/msg/Float64, field: data}
"""


def truth(k):
    """Return what the channels say in message k."""
    return {'angle': 0.1 * k + 1 / 3, 'current': float(np.float32(np.sin(k))),
            'turn': 0.01 * k - 0.2, 'speed': -0.3 * k, 'volt': 1.0 + k}


def write_bag(path, count=50, form='sqlite3', raw='_raw', skip=()):
    """Write messages of the rig; in the k-th of `skip` nothing is said."""
    ros1 = form == 'ros1'
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_JAZZY)
    store.register({**get_types_from_msg(AXIS, 'rig_of_ours_msgs/msg/Axis'),
                    **get_types_from_msg(DRIVE, MSG)})
    if ros1:
        writer = Writer1(path)
    else:
        writer = Writer2(path, version=9, storage_plugin=StoragePlugin.MCAP if 'mcap' in form
                         else StoragePlugin.SQLITE3)
        if 'zstd' in form:
            writer.set_compression(
                {'message': CompressionMode.MESSAGE, 'file': CompressionMode.FILE,
                 'storage': CompressionMode.STORAGE}[form.rpartition('-')[2]],
                CompressionFormat.ZSTD)
    T = store.types
    with writer:
        topics = {topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in (
            (f'/rig/state{raw}', MSG), (f'/imu{raw}', 'sensor_msgs/msg/Imu'),
            (f'/joints{raw}', 'sensor_msgs/msg/JointState'), ('/volt', 'std_msgs/msg/Float64'),
            ('/words', 'std_msgs/msg/String'))}

        def header(stamp):
            at = T['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9))
            return T['std_msgs/msg/Header'](*([7] if ros1 else []), stamp=at, frame_id='odd')

        def send(topic, message):
            connection = topics[topic]
            writer.write(connection, stamp + LATE, (
                store.serialize_ros1 if ros1 else store.serialize_cdr)(
                    message, connection.msgtype))

        xyz, no = T['geometry_msgs/msg/Vector3'], np.zeros(9)
        for k in range(count):
            if k in skip:
                continue
            stamp, said = BEGIN + k * STEP, truth(k)
            axis = T['rig_of_ours_msgs/msg/Axis']
            send(f'/rig/state{raw}', T[MSG](
                header(stamp), 'é' * (k % 3), [
                    axis('a', -1.0, np.arange(k % 4, dtype=float)),
                    axis('b', said['angle'], np.zeros(0))],
                np.array([0, 1, said['current']], np.float32), True))
            half = said['turn'] / 2
            send(f'/imu{raw}', T['sensor_msgs/msg/Imu'](
                header(stamp), T['geometry_msgs/msg/Quaternion'](0.0, 0.0, np.sin(half),
                                                                 np.cos(half)),
                no, xyz(0.0, 0.0, 0.0), no, xyz(0.0, 0.0, 0.0), no))
            names = ['left', 'right'] if k % 2 else ['right', 'left']
            speeds = {'left': said['speed'], 'right': 9.0}
            send(f'/joints{raw}', T['sensor_msgs/msg/JointState'](
                header(stamp), names, np.zeros(0), np.array([speeds[n] for n in names]),
                np.zeros(0)))
            send('/volt', T['std_msgs/msg/Float64'](said['volt']))
            send('/words', T['std_msgs/msg/String']('hello'))




@pytest.fixture
def wiring(tmp_path):
    path = tmp_path / 'replacer.yaml'
    path.write_text(WIRING)
    return path


def only(dataset):
    recording, = dataset.load()
    return recording


def codes(channel):
    return [why.code for why in channel.suspicions]


@pytest.mark.parametrize('form', ['sqlite3', 'mcap', 'sqlite3-zstd-message', 'sqlite3-zstd-file',
                                  'mcap-zstd-storage', 'ros1'])
def test_a_bag_says_what_was_put_in(tmp_path, wiring, form):
    path = tmp_path / ('rig.bag' if form == 'ros1' else 'rig')
    write_bag(path, COUNT, form)
    recording = only(Dataset((path,), wiring))
    assert recording.origin == BEGIN
    for name, track in recording.tracks.items():
        late = LATE if name == 'volt' else 0  # it has no stamp but that of the recording
        np.testing.assert_array_equal(track.stamps, BEGIN + late + STEP * np.arange(COUNT))
        np.testing.assert_allclose(track.values, [truth(k)[name] for k in range(COUNT)],
                                   rtol=0.0, atol=1e-12 if name == 'turn' else 0.0)
    assert recording.units == {'turn': 'rad'}


def test_a_file_of_a_bag_alone_is_read(tmp_path, wiring):
    write_bag(tmp_path / 'rig')
    file, = (tmp_path / 'rig').glob('*.db3')
    assert len(only(Dataset((file,), wiring)).tracks['angle'].values) == COUNT


def test_a_bag_from_before_there_was_a_replacer_is_read(tmp_path, wiring):
    write_bag(tmp_path / 'rig', raw='')
    assert len(only(Dataset((tmp_path / 'rig',), wiring)).tracks['angle'].values) == COUNT


def test_types_of_a_bag_are_gone_with_it(tmp_path):
    write_bag(tmp_path / 'rig')
    with open_bag(tmp_path / 'rig') as bag:
        assert message_type(MSG) is bag.kinds[MSG] and message_type(MSG).BROKEN == 3
    with pytest.raises(BadInput, match='no package of interfaces'):
        message_type(MSG)


def test_delays_are_taken_off(tmp_path, wiring):
    write_bag(tmp_path / 'rig')
    (tmp_path / 'rig.yaml').write_text(
        'recordings: [rig]\nwiring: replacer.yaml\ndelays: {angle: 0.02}\n')
    recording, = load_dataset(tmp_path / 'rig.yaml')
    assert recording.tracks['angle'].times[3] == pytest.approx(0.01)
    assert recording.tracks['current'].times[3] == pytest.approx(0.03)


def test_what_is_in_a_bag_is_found_without_a_wiring(tmp_path):
    write_bag(tmp_path / 'rig', 200, skip=range(50, 90))
    found = survey(tmp_path / 'rig', Dataset(()))
    assert found.form == 'ROS 2' and found.begin == BEGIN
    channels = {c.name: c for c in found.channels}
    angle = channels['/rig/state_raw axes[1].angle']
    assert angle.count == 160 and angle.rate == pytest.approx(100.0)
    assert angle.late == pytest.approx(0.002) and angle.late_spread == pytest.approx(0.0)
    assert angle.jitter == pytest.approx(0.0, abs=1e-9)
    assert angle.gap == pytest.approx(0.41) and 'gaps' in codes(angle)
    assert channels['/imu_raw yaw(orientation)'].unit == 'rad'
    assert 'constant' in codes(channels['/joints_raw velocity[right]'])
    assert any('/words' in note for note in found.notes)


def test_what_is_in_a_bag_as_it_is_wired(tmp_path, wiring):
    write_bag(tmp_path / 'rig')
    found = survey(tmp_path / 'rig', Dataset((), wiring))
    assert [c.name for c in found.channels] == ['angle', 'current', 'turn', 'speed', 'volt']
    assert found.channels[3].low == truth(COUNT - 1)['speed']


@pytest.mark.parametrize('old, new, says', [
    ('topic: joints', 'topic: jonts', 'did you mean /joints'),
    ('sensor_msgs/msg/Imu', 'sensor_msgs/msg/Range', 'carries sensor_msgs/msg/Imu'),
    ('axes[1].angle', 'axes[1].engle', 'its fields are name, angle, history'),
    ("'velocity[left]'", '3', 'is no text')])
def test_a_wrong_wire_is_one_line(tmp_path, wiring, old, new, says):
    write_bag(tmp_path / 'rig', 3)
    wiring.write_text(WIRING.replace(old, new))
    with pytest.raises(BadInput) as raised:
        only(Dataset((tmp_path / 'rig',), wiring))
    assert says in str(raised.value) and '\n' not in str(raised.value)


def test_a_broken_bag_is_one_line(tmp_path, wiring):
    write_bag(tmp_path / 'rig.bag', 50, 'ros1')
    whole = (tmp_path / 'rig.bag').read_bytes()
    for broken in (b'', b'garbage' * 100, whole[:len(whole) // 2],
                   whole[:5000] + bytes(2000) + whole[7000:]):
        (tmp_path / 'rig.bag').write_bytes(broken)
        with pytest.raises(BadInput) as raised:
            only(Dataset((tmp_path / 'rig.bag',), wiring))
        assert 'rig.bag' in str(raised.value) and '\n' not in str(raised.value)


def test_a_bag_whose_recorder_was_killed_is_mended_by_name(tmp_path, wiring):
    write_bag(tmp_path / 'rig', 50, 'mcap')
    file, = (tmp_path / 'rig').glob('*.mcap')
    (tmp_path / 'cut.mcap').write_bytes(file.read_bytes()[:-300])
    with pytest.raises(BadInput, match='mcap recover'):
        only(Dataset((tmp_path / 'cut.mcap',), wiring))
    (tmp_path / 'rig' / 'metadata.yaml').unlink()
    with pytest.raises(BadInput, match='ros2 bag reindex'):
        only(Dataset((tmp_path / 'rig',), wiring))


def test_a_message_that_is_none_is_left_out(tmp_path, wiring):
    write_bag(tmp_path / 'rig', 20)
    file, = (tmp_path / 'rig').glob('*.db3')
    with sqlite3.connect(file) as base:
        for number in (1, 6):  # both of the drive
            base.execute('UPDATE messages SET data = ? WHERE id = ?', (b'\0\1\0\0nothing', number))
    base.close()
    assert len(only(Dataset((tmp_path / 'rig',), wiring)).tracks['angle'].values) == 18
