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

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message

from benchmark import bank, designer, estimators, healthy_path, isolation, rig as rigs
from benchmark.__main__ import main, table
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


def test_estimators_beside_filters():
    pytest.importorskip('filterpy')
    told = []
    rows = estimators.measure(told.append, seconds=10.0, chosen=[2])
    assert_numbers(rows)
    names = list(estimators.PEERS)
    assert [row.what for row in rows] == ['its bare arrays', *names] * 3 + [
        f'{ours} / {name}' for ours in ('bare arrays', 'whole bank') for name in names]
    quiet, tuned, untold = ([row for row in rows if row.group.endswith(end)]
                            for end in ('all states', 'tuned for it', 'not told of it'))
    # the unknown rate moves the filters that were not told of it, and never the virtual sensor
    assert tuned[0].ours == untold[0].ours == pytest.approx(quiet[0].ours, rel=1e-6)
    for with_it, without in zip(untold[1:], quiet[1:]):
        assert with_it.peer > 1.2 * without.peer, with_it
    assert 'tuning the peers' in told[0]


@pytest.mark.parametrize('case', estimators.cases(), ids=lambda case: case.label)
def test_the_peers_know_the_plant(case):
    known, plant = estimators.model(case), case.plant
    x = np.array([3.0, 2.0, 1.0])
    u = np.arange(1.0, 1.0 + len(plant.inputs))
    assert (known.step(x, u) - x) * estimators.RATE == pytest.approx(
        plant.rate_of_change(x, u), rel=1e-9)
    slopes = [(known.step(x + dx, u) - known.step(x - dx, u)) / 2e-6 for dx in 1e-6 * np.eye(3)]
    assert known.jacobian(x) == pytest.approx(np.transpose(slopes), abs=1e-7)


def test_design_times():
    pytest.importorskip('control')
    told = []
    rows = designer.measure((6, 9), told.append)
    assert_numbers(row for row in rows if not row.what.startswith('time grows'))
    sizes = ['n = 6, 2 sensors', 'n = 9, 2 sensors']
    assert [row.what for row in rows] == 2 * (
        [*sizes, 'time grows as n to the power', *sizes, *sizes])
    assert all(row.ours <= row.peer for row in rows if row.group.startswith('states to run'))
    assert told[-1] == 'design of a network plant, n = 9, number 3'
    assert designer.exponent({10: 3.0, 100: 300.0}) == pytest.approx(2.0)
    for make in designer.KINDS.values():
        assert np.linalg.eigvals(make(30, 0).A).real.max() < 0.0


def test_a_part_alone(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('benchmark.__main__.TICKS', 5)
    assert main(['--only', 'bank', '--output', str(tmp_path / 'all.json')]) == 0
    assert 'one tick of the bank' in capsys.readouterr().out
    monkeypatch.setitem(sys.modules, 'filterpy', None)
    monkeypatch.setitem(sys.modules, 'filterpy.kalman', None)
    assert main(['--only', 'estimators', '--output', str(tmp_path / 'all.json')]) == 2
    assert 'pip install control filterpy' in capsys.readouterr().err


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
