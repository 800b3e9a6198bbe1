"""The benchmark's pieces run and give numbers. What the numbers are is not a test's business."""

from dataclasses import replace
from functools import partial
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

from benchmark import (
    bank,
    designer,
    estimators,
    healthy_path,
    isolation,
    jitter,
    memory,
    rig as rigs,
    sweeps,
    tracking,
)
from benchmark.__main__ import main, table
from benchmark.load import COUNTED, KINDS, Load
from benchmark.rig import Heard
from benchmark.row import Row

STAMP = 1_700_000_000_123_456_789  # ns


def assert_numbers(rows):
    for row in rows:
        assert row.ours > 0.0 and row.peer > 0.0 and math.isfinite(row.ratio), row


@pytest.mark.slow
def test_processes_run_in_turns_and_failed_sensors_are_replaced(monkeypatch):
    monkeypatch.setattr(rigs, 'SETTLE', 0.1)
    monkeypatch.setattr(jitter, 'SETTLE', 0.1)
    load = Load('Range', 2, 50.0, 2)
    told = []
    with rigs.set_up(load) as rig:
        assert rig.apart == [0]  # each reads the other
        legs = healthy_path.measure(rig, 0.5, 1, told.append)
        latencies = isolation.measure(rig, 3, told.append)
        assert told[-1] == 'isolation 3 of 3'
        ticks = jitter.measure(rig, 0.5, 1, True, told.append)
        grown = memory.measure(rig, 2000, told.append)
        assert [process.name for process in rig.processes] == ['the drivers']
        drivers = rig.processes[0].popen
    assert drivers.poll() is not None
    assert len(legs['relay']) == len(legs['replacer']) == 1 and len(latencies) == 3
    rows = [*healthy_path.rows(legs, load, healthy_path.Bars(0.5, 1.5, 60.0, 0)),
            *isolation.rows(latencies, 0.001), *jitter.rows(*ticks, rig.rate, 'busy'),
            *memory.rows(*grown)]
    assert_numbers(row for row in rows if 'lost' not in row.what)
    assert [row.what.split(',')[0] for row in rows if row.bar] == [
        'CPU per message', 'latency p50', 'median', 'p99', 'bank and switch', 'node at 1000 Hz']
    assert [row.what.split(' of ')[0] for row in rows if row.most is not None] == [
        'of one core', 'messages lost']
    assert len(grown[0].resident) == memory.PARTS


def heard(topic, count):
    at = STAMP - STAMP % COUNTED + 10**7 * count  # 100 Hz
    return Heard(topic, at - at % COUNTED + count % COUNTED, at + 3 * count, 0, False)


def test_what_is_lost_is_counted():
    load = Load('Range', 2, 100.0)
    sent = [heard(topic, count) for count in range(COUNTED - 99, COUNTED + 101)
            for topic in (0, 1)]
    assert healthy_path.lost(sent, load) == 0
    assert healthy_path.lost(sent[:100] + sent[107:], load) == 7
    assert healthy_path.lost(sent[1:-4:2] + sent[:-30:2], load) == 0  # some are on their way
    assert healthy_path.lost(sent[:40] + sent[41::2], load) == 180  # one falls silent
    assert healthy_path.lost(sent[::2], load) == 200  # or was never heard
    assert healthy_path.lost(sent[:9] + sent[3:4] + sent[9:], load) == 0  # one came twice


def test_ticks_are_judged_by_when_they_were_sent():
    ticks = [heard(0, count) for count in range(20)]
    assert jitter.deviations(ticks, 100.0) == pytest.approx([3e-9] * 19, abs=1e-12)
    assert jitter.deviations(ticks[:10] + ticks[11:], 100.0)[9] == pytest.approx(0.01, rel=1e-5)


def test_growth_is_seen_after_the_first_tenth():
    grown = memory.Growth(1e6, [50, *range(100, 120)])
    assert (grown.first, grown.last) == (101.5, 118.5)


def test_tick_of_the_bank():
    rows = bank.measure(20, (1, 5))
    assert_numbers(rows)
    assert [row.what for row in rows] == [
        '1 virtual sensor, linear', '5 virtual sensors, linear',
        '1 virtual sensor, nonlinear', '5 virtual sensors, nonlinear']


def test_tick_with_tracking(monkeypatch):
    monkeypatch.setattr(tracking, 'LOSSES', 1)
    rows = tracking.measure(10, (2,))
    assert_numbers(rows)
    assert [(row.what, row.bar) for row in rows] == [
        (f'2 virtual sensors, {kind}', bar) for bar in (2.0, 2.0, None)
        for kind in ('linear', 'nonlinear')]
    assert len({row.group for row in rows}) == 3


@pytest.mark.slow
def test_estimators_beside_filters(monkeypatch):
    pytest.importorskip('filterpy')
    monkeypatch.setattr(estimators, 'SCALES', (1.0, 1e1))
    monkeypatch.setattr(estimators, 'STRENGTHS', (1.0, 1e2))
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


@pytest.mark.slow
def test_design_times(monkeypatch):
    pytest.importorskip('control')
    monkeypatch.setattr(designer, 'PLANTS', 2)
    told = []
    rows = designer.measure((4, 6), told.append)
    assert_numbers(row for row in rows if not row.what.startswith('time grows'))
    sizes = ['n = 4, 2 sensors', 'n = 6, 2 sensors']
    assert [row.what for row in rows] == 2 * (
        [*sizes, 'time grows as n to the power', *sizes, *sizes])
    assert all(row.ours <= row.peer for row in rows if row.group.startswith('states to run'))
    assert told[-1] == 'design of a network plant, n = 6, number 2'
    assert designer.exponent({10: 3.0, 100: 300.0}) == pytest.approx(2.0)
    for make in designer.KINDS.values():
        assert np.linalg.eigvals(make(30, 0).A).real.max() < 0.0


@pytest.mark.slow
def test_sweeps():
    rows = sweeps.measure(3, rounds=1)
    assert_numbers(rows)
    assert [row.what for row in rows] == ['sent to one process, a task', 'two processes',
                                          'the start of a process']
    assert rows[0].group.startswith('sweep of 9 tasks')


@pytest.mark.slow
def test_a_part_alone(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(bank, 'measure', partial(bank.measure, sizes=(1,)))
    monkeypatch.setattr('benchmark.__main__.TICKS', 5)
    assert main(['--only', 'bank', '--output', str(tmp_path / 'all.json')]) == 0
    assert 'one tick of the bank' in capsys.readouterr().out
    monkeypatch.setitem(sys.modules, 'filterpy', None)
    monkeypatch.setitem(sys.modules, 'filterpy.kalman', None)
    assert main(['--only', 'estimators', '--output', str(tmp_path / 'all.json')]) == 2
    assert 'pip install control filterpy' in capsys.readouterr().err


@pytest.mark.parametrize('name', KINDS)
def test_a_replaced_message_is_known_by_its_stamp(name):
    load = Load(name, burst=50)
    raw = load.template(2.5)
    load.sign(raw, STAMP, 3 * COUNTED + 5)
    stamp, replaced = load.read(bytes(raw))
    assert not replaced and abs(stamp - STAMP) < COUNTED and stamp % COUNTED == 5
    message = deserialize_message(bytes(raw), load.kind)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
    assert message.header.frame_id == 'base'
    message.header.stamp.nanosec += 1
    assert load.read(serialize_message(message)) == (stamp + 1, True)
    assert Load.parse(load.text()) == load


def test_bars():
    row = Row('group', 'held', 'us', 1.0, 2.0, 0.5)
    assert not row.missed
    assert not replace(row, ours=5.0, bar=None).missed
    assert replace(row, ours=1.01).missed
    assert replace(row, ours=math.nan).missed
    assert 'MISSED' in table([replace(row, ours=1.01)]) and 'MISSED' not in table([row])
    lost = replace(row, ours=0.0, peer=0.0, bar=None, most=0.0)
    assert not lost.missed and 'held' in table([lost])
    assert replace(lost, ours=1.0).missed and replace(lost, ours=math.nan).missed
