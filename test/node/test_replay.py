"""A recording of what a node heard, replayed: the same goes out, to the last bit."""

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock

from vsensor_ros.node.accessor import put_stamp
from vsensor_ros.node.cdr import Reader
from vsensor_ros.node.parameters import setup_of
from vsensor_ros.recordings import Loss, Recording, replay, Track

JOINTS = 'sensor_msgs/msg/JointState'
PERIOD = 10_000_000  # ns
HEALTHY, LOST = 60, 40  # steps


class Heard:
    """What a node is told, kept as a recording."""

    def __init__(self, rig):
        self.rig, self.said = rig, {}

    def keep(self, name, value):
        stamps, values = self.said.setdefault(name, ([], []))
        stamps.append(self.rig.now)
        values.append(float(value))

    def recording(self):
        origin = min(stamps[0] for stamps, _ in self.said.values())
        return Recording({name: Track(np.array(stamps), np.array(values), origin)
                          for name, (stamps, values) in self.said.items()})


def step(rig, heard, k, lost=()):
    """Step the clock, then send what the machine says at that time."""
    rig.now += PERIOD
    clock = Clock()
    clock.clock.sec, clock.clock.nanosec = divmod(rig.now, 10**9)
    rig.clock.publish(clock)
    assert rig.spin_until(lambda: rig.replacer.engine.now == rig.now)
    if k == HEALTHY:
        rig.isolate(*lost)
    if k % 5 == 0:
        u = np.sin(0.1 * k)
        rig.command(float(u))
        heard.keep('u1', u)
    y1, y3 = 0.3 * np.sin(0.07 * k) + 1 / 3, float(np.float32(0.1 * k))
    y2 = 2.0 * y1 + 0.01 * np.cos(k)
    for topic, message in (rig.arm(y1, y2), ('/y3_raw', rig.reading(y3))):
        put_stamp(message, rig.now)
        before = rig.taken[topic]
        rig.publisher(type(message), topic).publish(serialize_message(message))
        assert rig.spin_until(lambda: rig.taken[topic] > before)  # noqa: B023 - used at once
    for name, value in (('y1', y1), ('y2', y2), ('y3', y3)):
        heard.keep(name, value)


@pytest.mark.parametrize('lost', [('y1',), ('y1', 'y2')])
def test_a_replay_says_what_the_node_said_to_the_last_bit(rig, joint_parameters, lost):
    given = {**joint_parameters, 'time_constant': 0.2}
    r = rig(given)
    raw = r.listen(JOINTS, '/joint_states')
    heard = Heard(r)
    for k in range(HEALTHY + LOST):
        step(r, heard, k, lost)
    reader = Reader(r.replacer.topics[0].kind, ['position[shoulder]'])
    said = {r.stamp: r.values[0] for r in map(reader.read, raw)}
    recording = heard.recording()
    start = HEALTHY * PERIOD * 1e-9
    setup = setup_of(r.replacer.settings.design, given, 'test')
    (_, found), = replay(setup, recording, [Loss(lost, start, start + LOST * PERIOD * 1e-9)])
    y1 = found['y1']
    stamps = recording.origin + np.rint(y1.times * 1e9).astype(int)
    replayed = {int(s): v for s, v in zip(stamps, y1.values) if np.isfinite(v)}
    assert len(replayed) > LOST / 2
    node = {stamp: said[stamp] for stamp in replayed}
    assert {s: v.hex() for s, v in node.items()} == {s: v.hex() for s, v in replayed.items()}
    assert len({*replayed.values()}) > LOST / 2
