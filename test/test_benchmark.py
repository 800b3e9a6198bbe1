"""The benchmark's pieces run and give numbers. What the numbers are is not a test's business."""

from dataclasses import replace
import math
import os
from pathlib import Path
import sys

# before any ROS context is made
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(
    Path(__file__).parents[1] / 'config' / 'fastdds_localhost.xml'))

import pytest
from rclpy.serialization import deserialize_message, serialize_message

from benchmark import bank, healthy_path, isolation, rig as rigs
from benchmark.__main__ import table
from benchmark.load import KINDS, Load
from benchmark.row import Row

STAMP = 1_700_000_000_123_456_789  # ns


def assert_numbers(rows):
    for row in rows:
        assert row.ours > 0.0 and row.peer > 0.0 and math.isfinite(row.ratio), row


def test_processes_run_in_turns_and_failed_sensors_are_replaced(monkeypatch):
    monkeypatch.setattr(rigs, 'SETTLE', 0.1)
    load = Load('Range', 2, 50.0)
    told = []
    with rigs.set_up(load) as rig:
        legs = healthy_path.measure(rig, 0.5, 1, told.append)
        latencies = isolation.measure(rig, 3, told.append)
        assert [process.name for process in rig.processes] == ['the drivers']
        drivers = rig.processes[0].popen
    assert drivers.poll() is not None
    assert len(legs['relay']) == len(legs['replacer']) == 1 and len(latencies) == 3
    rows = [*healthy_path.rows(legs, load), *isolation.rows(latencies, 0.001)]
    assert_numbers(rows)
    assert [row.what for row in rows if row.bar] == ['CPU per message', 'median']
    assert told[-1] == 'isolation 3 of 3'


def test_tick_of_the_bank():
    rows = bank.measure(20, (1, 5))
    assert_numbers(rows)
    assert [row.what for row in rows] == [
        '1 virtual sensor, linear', '5 virtual sensors, linear',
        '1 virtual sensor, nonlinear', '5 virtual sensors, nonlinear']


@pytest.mark.parametrize('name', KINDS)
def test_a_replaced_message_is_known_by_its_stamp(name):
    load = Load(name)
    raw = load.template(2.5)
    load.sign(raw, STAMP)
    assert load.read(bytes(raw)) == (STAMP, False)
    message = deserialize_message(bytes(raw), load.kind)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == STAMP
    assert message.header.frame_id == 'base'
    message.header.stamp.nanosec += 1
    assert load.read(serialize_message(message)) == (STAMP + 1, True)
    assert Load.parse(load.text()) == load


def test_bars():
    row = Row('group', 'held', 'us', 1.0, 2.0, 0.5)
    assert not row.missed
    assert not replace(row, ours=5.0, bar=None).missed
    assert replace(row, ours=1.01).missed
    assert replace(row, ours=math.nan).missed
    assert 'MISSED' in table([replace(row, ours=1.01)]) and 'MISSED' not in table([row])
