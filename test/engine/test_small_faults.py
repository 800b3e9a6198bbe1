"""What a sensor said last before it was isolated may be the fault, however small that was."""

from dataclasses import replace
import math
from pathlib import Path
import sys

from hypothesis import given, settings, strategies as st
import pytest

sys.path.append(str(Path(__file__).parent))
from machine import faulty, Machine, PERIOD

from vsensor_ros.engine import Engine, StreamPlan
from vsensor_ros.observers import Noise

ASSUMED = Noise(0.1, 0.1, True)  # no fault within 0.4 is out of line with it
FAULTS = {'bias': lambda size, t: size, 'drift': lambda size, t: size * t,
          'wave': lambda size, t: size * math.cos(9.0 * t)}


@settings(max_examples=15)
@given(kind=st.sampled_from(sorted(FAULTS)), size=st.floats(-0.3, 0.3), lasts=st.integers(1, 50),
       model=st.floats(-0.1, 0.1), ripple=st.floats(0.0, 0.05), pace=st.floats(0.5, 40.0))
def test_an_offset_carries_on_no_more_than_healthy_readings_differed(
        bench, kind, size, lasts, model, ripple, pace):
    """The truth is known: y2 = 2 y1 + what the model does not know, and then the fault."""
    m = Machine(bench, noise=ASSUMED, time_constant=0.5)
    healthy, isolated, said = [], 600, math.nan
    for k in range(isolated + 12):
        t = 0.01 * k
        y1 = math.sin(0.3 * t)
        off = model + ripple * math.sin(pace * t)
        if k <= isolated - lasts:
            healthy.append(off)
        elif k < isolated:
            off += FAULTS[kind](size, 0.01 * (k - isolated + lasts))
        else:
            off = 99.0
        if k == isolated:
            m.isolate('y2')
            value = m.sent[-1].fields[0][1]
            assert value.value == pytest.approx(said, abs=0.01)  # no jump; y1 moves
        said = 2.0 * y1 + off
        m.step(y1, said)
    value = m.sent[-1].fields[0][1]  # after a fifth of the time constant
    centre = sorted(healthy)[len(healthy) // 2]
    most = max(abs(off - centre) for off in healthy)
    assert abs(value.offset * math.exp(0.22) - centre) <= most + 0.1 * abs(model) + 0.01
    assert m.sent[-1].time - m.sent[0].time > 11 * PERIOD


def test_a_fault_that_is_out_of_line_does_not_go_on_at_all(bench):
    m = Machine(bench, noise=ASSUMED, time_constant=0.5)
    m.step(1.0, 2.05, periods=600)
    m.step(1.0, 4.0, periods=20)
    m.isolate('y2')
    value = m.sent[-1].fields[0][1]
    assert value.value == pytest.approx(2.05, abs=1e-3)
    assert value.offset == pytest.approx(0.05, abs=1e-3)



def test_an_estimate_that_read_what_has_failed_since_is_not_carried_on(bench):
    """Three sensors say the same: y2 stands in for y1, and when that is off, y3 does."""
    m = Machine(bench)
    made = bench.design(*(bench.virtual_sensor(
        [], [], Q=[[1.0]], fault_set=failed, healthy=(other,), channel='y1', noise=ASSUMED)
        for failed, other in ((('y1',), 'y2'), (('y1', 'y2'), 'y3'))), names=('y1', 'y2', 'y3'))
    live = replace(m.setup.live, time_constant=0.5, policies=dict.fromkeys(
        made.sensors, m.setup.live.policies['y1']), max_deviation=dict.fromkeys(made.sensors, 0.0))
    m.engine = Engine(replace(
        m.setup, design=made, max_age=dict.fromkeys(made.sensors, 0.5), live=live,
        streams=(StreamPlan(made.sensors, '/in', '/out', True),)))
    m.engine.look(m.now, 0.0)
    m.engine.activate()

    def step(*said, periods=1):
        for _ in range(periods):
            m.now += PERIOD
            m.hear(0, *said)
            m.pass_time()
    step(1.0, 1.0, 1.0, periods=600)
    m.send(m.engine.isolate(faulty('y1')))
    step(9.0, 1.0, 1.0, periods=100)
    step(9.0, 1.3, 1.0, periods=10)
    m.send(m.engine.isolate(faulty('y1', 'y2')))
    assert m.sent[-1].fields[0][1].value == pytest.approx(1.3, abs=1e-3)  # no jump
    step(9.0, 9.0, 1.0, periods=10)
    assert m.sent[-1].fields[0][1].value == pytest.approx(1.0, abs=1e-6)


def test_what_may_be_the_fault_is_told_apart(bench):
    """Nothing was measured yet: all of the offset is in doubt, while it is there."""
    m = Machine(bench, noise=ASSUMED, time_constant=0.5)
    m.step(1.0, 2.2, periods=20)
    m.isolate('y2')
    value = m.sent[-1].fields[0][1]
    assert value.doubtful == pytest.approx(value.offset) == pytest.approx(0.2)
    m.step(1.0, 2.2, periods=5)
    half = m.sent[-1].fields[0][1]
    assert 0.02 < half.doubtful < 0.1
    m.step(1.0, 2.2, periods=6)
    assert m.sent[-1].fields[0][1].doubtful == 0.0
