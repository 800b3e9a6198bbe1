"""An engine that isolates by itself, on a simulated machine: nobody else tells who failed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import design, load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Residuals
from vsensor_ros.bank.readings import Samples
from vsensor_ros.engine import (
    Engine,
    IsolationReport,
    Live,
    Policy,
    Setup,
    StreamPlan,
    together,
)
from vsensor_ros.isolator import Settings
from vsensor_ros.simulate import simulate

CONFIG = Path(__file__).parents[2] / 'config'
PERIOD = 10_000_000
START = 1000 * 10**9
SENSORS = ('y1', 'y2', 'y3')


@pytest.fixture(scope='module')
def found():
    """Return a design that tells of each of three sensors of x' = -x + u."""
    return design(three(), isolate=True)


@pytest.fixture(scope='module')
def servo():
    """Return the plant and a design of it that tells of two of its three sensors."""
    plant = load_plant(CONFIG / 'servo' / 'plant.yaml')
    return plant, design(plant, isolate=True)


@pytest.fixture(scope='module')
def servo_run(servo):
    """Return 12 s of the servo: its voltage, its states, and what healthy sensors say."""
    plant, _ = servo
    t = np.arange(1201) / 100
    u = 3.0 * np.sin(0.9 * t)
    x = simulate(plant, t, u[:, None], np.zeros((len(t), 1)), [0.0, 1.0, 0.0])
    return u, x, x + np.random.default_rng(1).normal(0.0, 0.005, x.shape)


def three():
    return Plant.from_matrices(
        [[-1.0]], [[1.0]], [[1.0], [2.0], [3.0]], states=['x'], inputs=['u'],
        sensors=list(SENSORS), noise=[0.01] * 3)


class Run:
    """An engine beside that plant, in which sensors fail."""

    def __init__(self, design, mode='act', late=0, **settings):
        self.engine = Engine(Setup(
            design, 100.0, dict.fromkeys(SENSORS, 0.5), 10.0,
            tuple(StreamPlan((s,), f'/{s}_raw', f'/{s}', True) for s in SENSORS), True,
            Live('stop', 0.0, dict.fromkeys(SENSORS, Policy(dwell=0.0)),
                 dict.fromkeys(SENSORS, 0.0)), isolator=Settings(mode, **settings)))
        self.rng, self.now, self.x, self.late = np.random.default_rng(1), START, 1.5, late
        self.waiting, self.sent, self.said = [], [], []
        self.engine.look(self.now, 0.0)
        self.engine.activate()

    def go_on(self, seconds, fault=lambda readings, time: readings):
        """Let time pass; fault: what the drivers say instead, None of one: nothing."""
        for k in range(round(100 * seconds)):
            u = 1.5 + np.sin(2.0 * (self.now + PERIOD - START) * 1e-9)
            readings = fault(self.x * np.arange(1.0, 4.0) + self.rng.normal(0.0, 0.01, 3), k / 100)
            # a step of the command is held over the period: this is exact
            self.x = u + (self.x - u) * np.exp(-0.01)
            self.step('u', u, readings)

    def step(self, command, value, readings):
        """Let a period pass, at the beginning of which this was commanded and read."""
        self.now += PERIOD
        self.engine.look(self.now, self.now * 1e-9)
        self.engine.command(command, value, self.now - PERIOD, self.now - PERIOD)
        self.waiting.append((self.now - PERIOD, readings))
        while len(self.waiting) > self.late:
            stamp, values = self.waiting.pop(0)
            for i, reading in enumerate(values):
                if reading is not None:
                    message = Message(stamp, (float(reading),))
                    self.engine.judge(i, message, 'message')
                    self.engine.learn(i, message, self.now)
        for at in self.engine.ticks():
            for made in self.engine.tick(at):
                self.sent.append(made)
                self.engine.done(made)
        self.said += self.engine.remarks()

    def channel(self, name):
        return next(c for c in self.engine.snapshot(self.now * 1e-9).channels if c.name == name)


class Message:
    foreign = False

    def __init__(self, stamp, values):
        self.stamp, self.values = stamp, values


def biased(readings, time):
    return readings + np.array([0.0, 0.5, 0.0])


@pytest.mark.parametrize('late', [0, 5])
def test_who_is_biased_is_replaced_and_the_onset_known(found, late):
    run = Run(found, late=late)
    run.go_on(15.0)
    assert run.engine.verdict.state == 'healthy' and not run.sent
    began = run.now
    run.go_on(0.3 + 0.01 * late, biased)
    fault, = run.engine.verdict.faults
    assert fault.sensor == 'y2' and abs(fault.onset - began) < 0.1e9
    assert run.channel('y2').source == 'virtual'
    assert run.channel('y2').isolated_by == ('isolator',)
    # what goes out is the truth, not what the sensor says
    run.go_on(1.0, biased)
    (_, said), = run.sent[-1].fields
    assert said.value == pytest.approx(2.0 * run.x, abs=0.05 + 0.05 * late)
    assert any('y2: ' in str(r.what) and 'began about' in str(r.what) for r in run.said)


def test_sizes_of_faults_are_not_known_any_more_when_the_clock_has_jumped(found):
    run = Run(found)
    run.go_on(5.0)
    own = run.engine._own
    assert own.sizes.time is not None
    own.restart()
    assert own.sizes.time is None


def test_a_drift_counts_from_its_onset_not_from_when_it_was_found(found):
    run = Run(found)
    run.go_on(15.0)
    run.go_on(3.0, lambda readings, time: readings + np.array([0.0, 0.5 * time, 0.0]))
    fault, = run.engine.verdict.faults
    assert run.channel('y2').isolated_s > (run.now - fault.found) * 1e-9 + 0.1
    early, late = IsolationReport({'y2': 0}, frozenset()), IsolationReport({'y2': 5}, frozenset())
    assert together(early, late).faulty == together(late, early).faulty == {'y2': 5}


def test_an_observer_says_nothing_before_it_has_forgotten_its_start(servo):
    _, servo = servo
    slow = Residuals(servo.isolating(), servo.isolability.residuals, 100.0,
                     dict.fromkeys(servo.sensors, 0.5))
    said = []
    for k in range(1500):
        for name in servo.sensors:
            slow.take(name, START + k * PERIOD, 0.0)
        slow.take('voltage', START + k * PERIOD, 0.0)
        said += [estimates for _, _, estimates in slow.at_least(1, START + k * PERIOD)]
    assert np.isnan(said[5]).any() and np.isfinite(said[-1]).all()


def test_what_has_read_a_faulty_sensor_suspects_nobody_when_that_is_cleared(servo, servo_run):
    """The observer of the servo's current reads the velocity, and forgets a bias in seconds."""
    _, found = servo
    u, x, said = servo_run
    run, states = Run(found), []
    for k in range(len(x)):
        run.step('voltage', u[k], said[k] + [0.0, 1.8 * (500 <= k < 700), 0.0])
        verdict = run.engine.verdict
        if k == 700:
            assert verdict.faulty == ('y2',)
        elif k == 740:
            run.engine.clear('y2')
        elif k > 740:
            states.append((verdict.state, verdict.candidates))
    assert set(states) == {('healthy', ())}


def test_the_onset_of_what_was_always_wrong_is_the_start(servo, servo_run):
    """So that nothing goes on from readings that were as wrong before it was found."""
    _, found = servo
    u, x, said = servo_run
    run = Run(found)
    for k in range(501):
        run.step('voltage', u[k], said[k] + [0.0, 1.8, 0.0])
    fault, = run.engine.verdict.faults
    assert fault.sensor == 'y2' and fault.kind == 'bias' and fault.onset <= START + 2 * PERIOD
    assert fault.size == pytest.approx(1.8, abs=0.1)
    (_, sent), = run.sent[-1].fields
    assert sent.value == pytest.approx(x[500, 1], abs=0.05)


def test_a_clear_forgets_what_all_residuals_have_felt_of_the_fault(found):
    """No residual alarmed of that, which its readings alone showed; the next one is dated anew."""
    run = Run(found)
    run.go_on(15.0)
    frozen = []

    def freeze(readings, time):
        frozen.append(readings[1])
        return [readings[0], frozen[0], readings[2]]
    run.go_on(0.15, freeze)
    assert [f.kind for f in run.engine.verdict.faults] == ['stuck']
    watch = run.engine._own._isolator.watch
    felt = watch.supports[:, SENSORS.index('y2')]
    assert (watch.detector.filled[felt] > 0).any()
    run.engine.clear('y2')
    assert (watch.detector.filled[felt] == 0).all() and watch.detector.filled[~felt].all()


def test_it_is_blamed_until_cleared_by_whom_it_is(found):
    run = Run(found)
    run.go_on(15.0)
    run.go_on(1.0, biased)
    run.engine.isolate(IsolationReport({'y2': 0}, frozenset({'y2'})))
    assert run.channel('y2').isolated_by == ('isolation', 'isolator')
    run.go_on(1.0)
    with pytest.raises(ValueError, match='still reports it faulty'):
        run.engine.clear('y2')  # others say so, too
    assert run.channel('y2').isolated_by == ('isolation',)
    run.engine.isolate(IsolationReport({}, frozenset({'y2'})))
    run.go_on(0.1)
    assert run.channel('y2').source == 'real' and run.engine.verdict.state == 'healthy'


def test_a_reset_forgets_whom_it_blamed(found):
    run = Run(found)
    run.go_on(15.0)
    run.go_on(1.0, biased)
    run.go_on(0.5)
    assert run.channel('y2').source == 'virtual'
    run.engine.reset()
    run.go_on(0.1)
    assert run.channel('y2').source == 'real'


def test_a_reset_believes_the_model_again_and_learns_from_it(found):
    run = Run(found)
    run.go_on(15.0)
    run.go_on(1.0, lambda readings, time: readings + np.array([0.5, -0.5, 0.5]))
    assert run.engine.verdict.state == 'model'
    before = run.engine._own._isolator.watch.detector.thresholds.copy()
    run.engine.reset()
    assert run.engine.verdict.state == 'healthy'
    assert (run.engine._own._isolator.watch.detector.thresholds >= 1.4 * before).all()


def test_advice_replaces_nobody(found):
    run = Run(found, 'advise')
    run.go_on(15.0)
    run.go_on(1.0, biased)
    assert run.engine.verdict.faulty == ('y2',)
    assert run.channel('y2').source == 'real' and not run.sent


def test_what_freezes_is_stuck_though_stamps_are_off_the_grid(found):
    run = Run(found)
    run.now += PERIOD // 3
    run.go_on(15.0)
    frozen = []

    def freeze(readings, time):
        frozen.append(readings[1])
        return [readings[0], frozen[0], readings[2]]
    run.go_on(0.3, freeze)
    assert [(f.sensor, f.kind) for f in run.engine.verdict.faults] == [('y2', 'stuck')]


def test_who_falls_silent_has_dropped_out_after_its_max_age(found):
    run = Run(found)
    run.go_on(15.0)
    run.go_on(0.45, lambda readings, time: [readings[0], None, readings[2]])
    assert run.engine.verdict.state == 'healthy'
    run.go_on(0.2, lambda readings, time: [readings[0], None, readings[2]])
    assert [(f.sensor, f.kind) for f in run.engine.verdict.faults] == [('y2', 'drop-out')]
    assert run.channel('y2').source == 'virtual'


def test_a_jump_of_the_clock_blames_nobody(found):
    run = Run(found)
    run.go_on(15.0)
    run.now += 20 * 10**9
    run.go_on(5.0)
    assert run.engine.verdict.state == 'healthy' and run.channel('y2').source == 'real'


def test_a_second_fault_is_found_beside_the_first(found):
    run = Run(design(three(), isolate=True, up_to=2))  # one fault at a time is not enough
    run.go_on(15.0)
    run.go_on(2.0, biased)
    run.go_on(2.0, lambda readings, time: readings + np.array([-0.5, 0.5, 0.0]))
    assert set(run.engine.verdict.faulty) == {'y1', 'y2'}
    assert run.channel('y1').source == run.channel('y2').source == 'virtual'


def test_a_design_without_residuals_is_refused_or_has_none(found):
    with pytest.raises(BadInput, match='designer --isolate'):
        Run(replace(found, isolability=None))
    assert Run(replace(found, isolability=None), 'off').engine.verdict is None


def test_a_clock_that_is_set_back_hours_blames_as_before(found):
    run = Run(found)
    run.go_on(15.0)
    run.now -= 3600 * 10**9
    run.go_on(15.0)
    assert run.engine.verdict.state == 'healthy'
    run.go_on(1.0, biased)
    assert run.engine.verdict.faulty == ('y2',)
    run.now -= 1800 * 10**9  # in the middle of the fault
    run.go_on(1.0, biased)
    assert run.engine.verdict.faulty == ('y2',) and run.channel('y2').source != 'real'
    run.engine.reset()
    run.go_on(15.0)
    assert run.engine.verdict.state == 'healthy' and run.channel('y2').source == 'real'


def test_what_was_learnt_goes_on_in_another_run(found, tmp_path):
    run, path = Run(found), tmp_path / 'record.json'
    run.go_on(15.0)
    run.engine.learnt().save(path, 'hash')
    again = Run(found)
    again.engine.go_on_from(path, 'hash')
    again.go_on(2.0)  # too short to learn that it does not repeat itself
    frozen = []

    def freeze(readings, time):
        frozen.append(readings[1])
        return [readings[0], frozen[0], readings[2]]
    again.go_on(0.3, freeze)
    assert [f.kind for f in again.engine.verdict.faults] == ['stuck']
    with pytest.raises(BadInput, match='another design'):
        again.engine.go_on_from(path, 'another')


def test_who_cannot_be_told_apart_is_suspected_and_nobody_replaced():
    plant = Plant.from_matrices([[-1.0]], [[1.0]], [[1.0], [2.0], [3.0]], D=[[1.0]],
                                states=['x'], inputs=['u'], sensors=list(SENSORS),
                                noise=[0.01] * 3)
    whole = design(plant, isolate=True)
    one = next(r for r in whole.isolability.residuals if len(r.support) == 2)
    run = Run(replace(whole, isolability=replace(
        whole.isolability, residuals=(one,), filters={})))
    run.go_on(15.0)
    run.go_on(1.0, lambda readings, time: readings + 0.5 * np.array(
        [name == one.support[0] for name in SENSORS]))
    assert run.engine.verdict.state == 'suspected' and not run.engine.verdict.faulty
    assert {s for names in run.engine.verdict.candidates for s in names} == set(one.support)
    assert all(run.channel(s).source == 'real' for s in SENSORS) and not run.sent
    assert any('the residuals that alarm do not tell which' in str(r.what) for r in run.said)
    run.now -= 3600 * 10**9  # suspicion ends after some time without an alarm, whatever the clock
    run.go_on(15.0)
    assert run.engine.verdict.state == 'healthy'


@pytest.mark.slow
def test_a_fault_too_small_to_be_found_is_told_once_enough_is_known(found, tmp_path):
    run, path = Run(found), tmp_path / 'record.json'
    run.go_on(310.0)
    run.engine.learnt().save(path, 'hash')
    again = Run(found, smallest_fault={'y1': 1e-6, 'y2': 1.0})
    again.engine.go_on_from(path, 'hash')
    again.go_on(0.5)
    said = [str(r.what) for r in again.said]
    assert any('y1: a fault of 1e-06 is not found' in text for text in said)
    assert not any('y2: a fault' in text for text in said)


def test_a_reading_that_does_not_change_is_the_same_between_its_samples():
    samples = Samples()
    for stamp in (0, 1000):
        samples.add(stamp, 0.1)
    assert {samples.interpolated(time, 2000) for time in range(0, 1000, 7)} == {0.1}
