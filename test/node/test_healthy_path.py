"""What is sent on while nothing has failed, and what is counted instead."""

import math
import time

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
from sensor_msgs.msg import Range
from std_msgs.msg import Float64

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns, of the bank and of the sensors


def test_healthy_messages_go_on_byte_for_byte(rig, parameters):
    r = rig(parameters)
    heard = [r.listen(RANGE, f'/y{i}') for i in (1, 2, 3)]
    for i in range(20):
        r.step(*r.healthy(y1=i, y2=math.nan if i == 7 else -i, y3=math.inf if i == 8 else 0))
    assert r.spin_until(lambda: all(len(h) == 20 for h in heard))
    for i, h in enumerate(heard, 1):
        assert [bytes(raw) for raw in h] == r.sent[f'/y{i}_raw']


def test_bytes_that_are_no_message(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y1')
    r.step(*r.healthy(), periods=3)
    topics = {'/y1_raw': Range, '/u1': Float64, '/isolation': DiagnosticArray}
    for topic, kind in topics.items():
        for raw in (b'', b'garbage', b'\x00\x01\x00\x00' + b'\xff' * 6):
            r.publisher(kind, topic).publish(raw)
    r.spin()
    assert sum(r.counts.values()) == 6 and not r.reported
    r.step(*r.healthy())
    assert r.spin_until(lambda: len(heard) == 4)


def test_bad_readings_are_counted_and_stop_nothing(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=3)
    for value in (math.nan, math.inf, -math.inf):
        r.step(*r.healthy(y1=value))
    backwards = r.reading(0.5)
    backwards.header.stamp.sec = r.now // 10**9 - 5
    r.publisher(Range, '/y1_raw').publish(backwards)
    r.spin()
    counts = r.counts
    assert counts['y1', 'not finite'] == 1
    assert counts['y1', 'range is marked as not there (beyond min_range and max_range)'] == 2
    assert counts['y1', 'stamp runs backwards'] == 1
    r.isolate('y2')
    r.step(*r.healthy(y1=0.75), periods=3)
    assert r.values(heard)[-1] == 1.5


def test_the_same_again_is_not_logged_again(rig, parameters, capfd):
    r = rig(parameters)
    r.step(*r.healthy(), periods=2)
    for _ in range(20):
        r.step(*r.healthy(y1=math.nan))
    assert r.counts['y1', 'not finite'] == 20
    assert capfd.readouterr().err.count('y1: not finite') == 1


def test_a_sensor_that_is_slower_than_max_age_is_said_once(rig, parameters, capfd):
    r = rig(parameters)
    r.step(*r.healthy(), periods=3)
    for _ in range(6):
        r.step(*r.healthy()[::2], periods=4)
        r.now += 96 * PERIOD
        r.step()  # the clock, first
        r.send(r.now)
    said = [line for line in capfd.readouterr().err.splitlines() if 'raise max_age' in line]
    assert len([line for line in said if 'y2: its readings are 1.01 s apart' in line]) == 1


def test_on_the_wall_clock(rig, parameters):
    r = rig(parameters, sim_time=False)
    heard = r.listen(RANGE, '/y2')
    y1, y2, y3 = (r.publisher(Range, f'/y{i}_raw') for i in (1, 2, 3))
    u1 = r.publisher(Float64, '/u1')

    def send(value, until):
        end = time.monotonic() + 60.0
        while not until():
            assert time.monotonic() < end
            for publisher in (y1, y2, y3):
                message = r.reading(value)
                message.header.stamp = r.node.get_clock().now().to_msg()
                publisher.publish(message)
            u1.publish(Float64(data=0.0))
            r.spin(0.01)

    send(0.75, lambda: len(heard) > 5)
    r.isolate('y2')
    count = len(heard)
    send(0.75, lambda: len(heard) >= count + 20)
    assert r.values(heard[count:]) == [1.5] * len(heard[count:])
    assert np.all(np.diff(r.stamps(heard)) > 0)
    r.isolate()
    send(0.75, lambda: r.values(heard)[-1] == 0.75)
    assert np.all(np.diff(r.stamps(heard)) > 0)
