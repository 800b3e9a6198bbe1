"""An engine whose encoder is lost: served from its last good readings, for a time."""

from dataclasses import replace
import math
from pathlib import Path
import sys

import numpy as np
import pytest

sys.path.append(str(Path(__file__).parent))
from machine import Machine, PERIOD, SECOND

from vsensor_ros.engine import (
    CannotServe,
    Engine,
    IsolationReport,
    Live,
    Policy,
    Setup,
    StreamPlan,
)
from vsensor_ros.observers import Noise

START = 1000 * SECOND


class Joint(Machine):
    """An encoder beside a tacho, 100 readings a second; time goes on by periods."""

    def __init__(self, bench, entry, seed=0, limit=0.0, seconds=12, inputs=(), time_constant=0.0):
        names = ('angle', 'tacho')
        self.x, self.y = bench.joint(seconds, seed, 100.0)
        streams = tuple(StreamPlan((s,), f'/{s}_raw', f'/{s}', True) for s in names)
        self.setup = Setup(
            bench.design(entry, names=names, inputs=inputs), 100.0, dict.fromkeys(names, 0.5),
            10.0, streams, True,
            Live('stop', time_constant, {s: Policy(dwell=0.0) for s in names},
                 {'angle': limit, 'tacho': 0.0}))
        self.engine = Engine(self.setup)
        self.shared, self.now, self.sent, self.k = False, START, [], 0
        self.engine.look(self.now, 0.0)
        self.engine.activate()

    def until(self, time, angle=None):
        """Go on to a time [s] after the start; angle: what the encoder says at a time [s]."""
        while self.k < round(100 * time):
            self.k += 1
            said = self.y[self.k, 0] if angle is None else angle(0.01 * self.k)
            self.step(float(said), float(self.y[self.k, 1]))
        return self

    def isolate(self, *names, since=0):
        self.send(self.engine.isolate(IsolationReport(dict.fromkeys(names, since),
                                                      frozenset(names))))

    def error(self):
        """Return what went out last - the truth."""
        sent = self.sent[-1]
        value = sent.fields[0][1].value
        return value - self.x[round((sent.time - START) / PERIOD), 0]


@pytest.fixture
def joint(bench):
    def build(seed=0, limit=0.002, **more):
        return Joint(bench, bench.encoder(rate=100.0), seed, limit, **more)
    return build


def test_lost_after_three_seconds_it_counts_down_and_ends(joint):
    m = joint().until(3.0)
    y = m.state('angle')
    assert y.reserve is None and y.remaining_s > 3.0 and y.reserve_deviation < 0.001
    m.isolate('angle')
    before = m.state('angle').remaining_s
    m.until(5.0, lambda t: 99.0)
    y = m.state('angle')
    assert (y.source, y.grade) == ('virtual', 'temporary') and y.deviation < 0.002
    assert abs(m.error()) <= 2 * y.deviation
    assert y.remaining_s == pytest.approx(before - 2.0, abs=0.1)
    m.until(5.0 + y.remaining_s - 0.1, lambda t: 99.0)
    assert m.state('angle').source == 'virtual' and abs(m.error()) <= 3 * 0.002
    m.until(0.01 * m.k + 0.2, lambda t: 99.0)
    y, sent = m.state('angle'), len(m.sent)
    assert y.source == 'none' and y.reason.fact('why').code == 'served its time'
    assert 'until its channel is believed again' in str(y.reason)
    m.engine.apply(replace(m.setup.live, max_deviation={'angle': 1.0, 'tacho': 0.0}))
    m.until(0.01 * m.k + 0.5, lambda t: 99.0)  # it does not come back by itself
    assert m.state('angle').source == 'none' and len(m.sent) == sent
    m.isolate()
    m.until(0.01 * m.k + 1.5)
    assert m.state('angle').source == 'real'
    m.isolate('angle')
    m.until(0.01 * m.k + 0.5, lambda t: 99.0)
    assert m.state('angle').source == 'virtual'
    assert abs(m.error()) <= 3 * m.state('angle').deviation


@pytest.mark.parametrize(('told', 'clean'), [(False, False), (True, True)])
def test_a_known_onset_goes_before_the_guard(joint, told, clean):
    m = joint()
    m.engine._bank._runs._begins = frozenset({320})  # no rehearsal is older than the fault
    m.until(3.0)
    m.until(3.8, lambda t: 0.5)  # sticks, and is isolated late
    m.isolate('angle', since=START + 3 * SECOND if told else 0)
    m.until(4.3, lambda t: 0.5)
    assert (abs(m.error()) <= 3 * m.state('angle').deviation) == clean


def test_a_fault_that_the_last_rehearsal_shows_is_not_in_the_free_run(joint):
    """It sticks for longer than the guard, and nobody says since when."""
    m = joint().until(3.0)
    m.until(3.8, lambda t: 0.5)
    m.isolate('angle')
    m.until(4.3, lambda t: 0.5)
    y = m.state('angle')
    assert y.source == 'virtual' and abs(m.error()) <= 3 * y.deviation < 0.006
    assert m.engine._bank.started(('angle',), 'angle') < START + 3 * SECOND


def test_why_it_does_not_serve_is_told_of_what_is_believed_now(joint):
    m = joint().until(3.0)
    m.isolate('angle', 'tacho')
    m.until(3.5)
    m.isolate('angle')
    m.until(3.6)
    assert m.state('angle').reason.fact('why').code != 'input isolated'  # the tacho is back


def test_while_the_sensor_is_silent_the_time_runs_already(joint):
    m = joint().until(3.0)
    left = m.state('angle').remaining_s
    for _ in range(100):
        m.k, m.now = m.k + 1, m.now + PERIOD
        m.hear(1, float(m.y[m.k, 1]))
        m.pass_time()
    assert m.state('angle').source == 'silent'
    assert m.state('angle').remaining_s == pytest.approx(left - 1.0, abs=0.1)


def test_a_forced_one_is_served_too_and_at_the_switch_there_is_no_step(joint):
    m = joint(time_constant=0.5).until(3.0)
    m.send(m.engine.force('angle'))
    m.until(4.0)
    y = m.state('angle')
    assert y.source == 'virtual' and y.switches == 1
    values = np.array([c.fields[0][1].value for c in m.sent])
    times = [round((c.time - START) / PERIOD) for c in m.sent]
    errors = values - m.x[times, 0]
    assert abs(errors[0]) < 4 * 0.0005 and np.abs(np.diff(errors)).max() < 0.0005


@pytest.mark.parametrize('size', [0.002, -0.002])
def test_a_small_fault_within_the_guard_makes_no_step_and_is_gone_soon(joint, size):
    """Nothing tells it from what the run may have drifted off by then, but the isolation."""
    m = joint(time_constant=0.5).until(3.0)
    m.until(3.3, lambda t: float(m.y[m.k, 0]) + size)
    last = float(m.y[m.k, 0]) + size
    m.isolate('angle')
    assert abs(m.sent[-1].fields[0][1].value - last) < 0.02 * 0.5 + 0.0005  # it has moved on
    assert abs(m.sent[-1].fields[0][1].offset) > 0.001
    m.until(3.41, lambda t: 99.0)
    assert abs(m.sent[-1].fields[0][1].offset) < 1.5 * 0.0005  # what the encoder's noise does
    assert abs(m.error()) <= 3 * m.state('angle').deviation


def test_one_that_no_limit_ends_is_not_forced(joint):
    m = joint(limit=0.0).until(3.0)
    with pytest.raises(CannotServe, match='^angle: cannot be forced; .* no limit says'):
        m.engine.force('angle')
    assert m.state('angle').source == 'real' and not m.state('angle').forced
    m.engine.apply(replace(m.setup.live, max_deviation={'angle': 0.002, 'tacho': 0.0}))
    m.send(m.engine.force('angle'))
    assert m.state('angle').source == 'virtual'


def test_when_another_run_is_the_surer_the_output_does_not_step(bench):
    """The free run drifts off, for its start was bad; the independent one takes over."""
    slow = bench.encoder(grade='exact', rate=100.0, noise=Noise(0.01, 0.01, False))
    slow = replace(slow, N=np.array([[-1.0]]), J=np.array([[0.0]]), B=np.array([[1.0]]),
                   inputs=('u',), Qu=np.zeros((1, 1)), Gu=(), eigenvalues=np.array([-1.0 + 0j]),
                   tracking=replace(slow.tracking, Qu=np.zeros((1, 1)), W=np.array([[1e-3]])))
    m = Joint(bench, slow, inputs=('u',), time_constant=0.5)
    m.engine.command('u', 1.0, m.now, m.now)

    def truth(t):
        return 1.0 - math.exp(-t)
    m.until(3.0, lambda t: truth(t) + 0.03)  # a bias that the model does not know
    m.isolate('angle')
    m.until(12.0, lambda t: 99.0)
    said = [(c.time, c.fields[0][1]) for c in m.sent]
    values = np.array([s.value for _, s in said])
    deviations = np.array([s.deviation for _, s in said])
    taken = int(np.flatnonzero(deviations[1:] < 0.85 * deviations[:-1])[0]) + 1
    assert m.engine._bank.run(('angle',), 'angle') == ''
    assert abs(said[taken][1].offset) > 0.003  # what a step would have been
    assert np.abs(np.diff(values)).max() < 0.002
    assert abs(values[-1] - truth(12.0)) < 1e-3 and m.state('angle').switches == 1
