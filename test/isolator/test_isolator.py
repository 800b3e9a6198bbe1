"""Each kind of fault is named right on a machine that moves; what is not a fault is not."""

import numpy as np
import pytest
from three_sensors import Machine, NOISE, of, PERIOD, RESIDUALS

from vsensor_ros.bad_input import BadInput
from vsensor_ros.isolator import Isolator, Settings
from vsensor_ros.isolator.diagnosis import PASSES
from vsensor_ros.observers import Residual


def frozen(machine):
    last = {}

    def stuck(reading, time, random):
        return last.setdefault('is', reading)
    return stuck


FAULTS = {
    'bias': lambda reading, time, random: reading + 0.2,
    'drift': lambda reading, time, random: reading + 0.02 * time,
    'noise': lambda reading, time, random: reading + 10 * NOISE * random.standard_normal(),
    'drop-out': lambda reading, time, random: np.nan,
}


@pytest.mark.parametrize('kind', FAULTS)
def test_a_fault_is_named_with_its_onset_and_size(machine, kind):
    began = machine.tick * PERIOD
    verdict = machine.run(20.0, of('b', FAULTS[kind]))
    (fault,) = verdict.faults
    assert (verdict.state, verdict.faulty, fault.kind) == ('isolated', ('b',), kind)
    early = 7.0 if kind == 'noise' else 1.5  # its window of 64 samples holds the onset
    assert began - early < fault.onset * 1e-9 < began + 1.5
    assert began < fault.found * 1e-9 < began + 8.0
    if kind == 'bias':
        assert fault.size == pytest.approx(0.2, abs=0.03)
        assert str(fault.reason(verdict.time)).startswith(
            'b: bias, began about 19.9 s ago, now +0.')
    elif kind == 'drift':
        assert fault.size == pytest.approx(0.4, abs=0.04)
        assert str(fault.reason(verdict.time)).endswith(f'now {fault.size:+.3g} rad/s')


def test_a_stuck_sensor_is_found_by_its_repeats(machine):
    began = machine.tick * PERIOD
    verdict = machine.run(20.0, of('c', frozen(machine)), until=lambda v: v.faults)
    assert verdict.faults[0].kind == 'stuck' and verdict.faulty == ('c',)
    assert verdict.time * 1e-9 < began + 1.0
    assert verdict.faults[0].onset * 1e-9 == pytest.approx(began, abs=0.2)


def test_repeats_of_a_fault_are_no_habit(machine):
    """What repeated until it was found does not make the next time harder to find."""
    for _ in range(2):
        machine.run(5.0, of('c', frozen(machine)), until=lambda v: v.faults)
        machine.run(1.0)
        machine.isolator.clear('c')
        machine.run(30.0)
    channels = machine.isolator.watch.channels
    assert channels.repeats[2] == channels.again[2] == 0
    began = machine.tick * PERIOD
    verdict = machine.run(20.0, of('c', frozen(machine)), until=lambda v: v.faults)
    assert verdict.faulty == ('c',) and verdict.time * 1e-9 < began + 1.0


def test_spikes_are_told_and_blame_nobody(machine):
    told = []

    def spikes(reading, time, random):
        return reading + (3.0 if random.random() < 0.1 else 0.0)
    machine.run(60.0, of('a', spikes), until=lambda v: told.append(v) and False)
    assert {v.state for v in told} <= {'healthy', 'suspected'}
    assert any('spikes' in str(reason) for v in told for reason in v.reasons)


def test_two_that_share_a_residual_are_both_named_and_neither_blamed():
    lone = Machine(RESIDUALS[:1])
    lone.run(360.0)
    verdict = lone.run(5.0, of('a', FAULTS['bias']))
    assert verdict.state == 'suspected' and verdict.faults == ()
    assert verdict.candidates == (('a',), ('b',))
    assert 'a or b is faulty' in str(verdict.reasons[0])


def test_everything_at_once_is_the_model(machine):
    verdict = machine.run(5.0, estimates=all_wrong)
    assert verdict.state == 'model' and verdict.faulty == ()


def all_wrong(readings):
    return readings + np.array([0.5, -0.5, 0.5])


def test_a_model_that_errs_again_and_again_is_told_a_few_times_only(machine):
    said = []
    for _ in range(12):
        said.append(machine.run(8.0, estimates=lambda readings: (
            readings + 0.4 * (all_wrong(readings) - readings))).state)
        machine.isolator.clear('a')
        machine.run(20.0)
    assert set(said) == {'model', 'healthy'}  # a part of the residuals alarms no sensor
    assert said[0] == 'model' and said[-3:] == ['healthy'] * 3
    machine.run(310.0)
    verdict = machine.run(8.0, of('b', lambda reading, time, random: reading + 5.0))
    assert verdict.faulty == ('b',)


def test_a_fault_soon_after_the_model_was_blamed_is_found_and_never_taught(machine):
    assert machine.run(4.0, estimates=all_wrong).state == 'model'
    assert machine.run(30.0).state == 'healthy'
    biased = of('b', lambda reading, time, random: reading + 20 * NOISE)
    assert machine.run(PASSES + 5.0, biased).faulty == ('b',)
    for _ in range(4):
        machine.isolator.clear('b')
        assert machine.run(PASSES + 5.0, biased).faulty == ('b',)


def test_who_clears_the_model_many_times_hides_no_large_error(machine):
    said = []
    for _ in range(12):
        said.append(machine.run(4.0, estimates=all_wrong).state)
        machine.isolator.clear('b')
        machine.run(20.0)
    assert set(said) == {'model'}


def test_a_model_that_errs_no_more_is_learnt_from(machine):
    thresholds = machine.isolator.watch.detector.thresholds.copy()
    assert machine.run(4.0, estimates=all_wrong).state == 'model'
    assert machine.run(100.0).state == 'healthy'
    wider = machine.isolator.watch.detector.thresholds - thresholds
    assert wider.min() > -1e-9 and 0.0 < wider.max() < 0.5


@pytest.mark.parametrize('bias, faulty', [(0.08, ()), (0.25, ('b',))])
def test_while_it_learns_faults_beyond_eight_times_the_designed_noise_are_found(bias, faulty):
    machine = Machine()
    machine.run(50.0, motion=0.1)
    verdict = machine.run(10.0, of('b', lambda reading, time, random: reading + bias), motion=0.1)
    assert verdict.faulty == faulty


def test_an_alarm_that_falls_silent_for_want_of_samples_teaches_nothing(machine):
    assert machine.run(4.0, estimates=all_wrong).state == 'model'
    for _ in range(150):  # no virtual sensor runs, for longer than an alarm is remembered
        machine.tick += 1
        readings = np.sin(machine.phase) + NOISE * machine.random.standard_normal(3)
        verdict = machine.isolator.step(machine.tick * round(PERIOD * 1e9), readings,
                                        np.full(3, np.nan))
    assert verdict.state == 'healthy'
    assert machine.run(4.0, estimates=all_wrong).state == 'model'
    assert np.isneginf(machine.isolator.watch.detector.taught).all()


def test_a_sensor_that_is_cleared_while_faulty_is_found_again_and_teaches_nothing(machine):
    for _ in range(8):
        verdict = machine.run(20.0, of('b', FAULTS['bias']), until=lambda v: v.faults)
        assert verdict.faulty == ('b',)
        machine.isolator.clear('b')
    assert np.isneginf(machine.isolator.watch.detector.taught).all()


def test_a_suspicion_that_passes_teaches_nothing():
    lone = Machine(RESIDUALS[:1])
    lone.run(360.0)
    assert lone.run(5.0, of('a', FAULTS['bias'])).state == 'suspected'
    assert lone.run(100.0).state == 'healthy'
    assert np.isneginf(lone.isolator.watch.detector.taught).all()


def test_nothing_is_learnt_while_something_is_wrong(machine):
    machine.run(5.0, of('b', FAULTS['bias']), until=lambda v: v.faults)
    machine.run(1.0)
    detector, channels = machine.isolator.watch.detector, machine.isolator.watch.channels
    before = detector.learnt.copy(), detector.maxima.count.copy(), channels.samples.copy()
    machine.run(60.0, of('b', FAULTS['bias']))
    after = detector.learnt, detector.maxima.count, channels.samples
    assert not machine.isolator.learning
    assert all((one == other).all() for one, other in zip(before, after))
    machine.isolator.clear('b')
    assert machine.run(60.0).state == 'healthy'
    assert (detector.learnt > before[0]).all()


def test_a_fault_holds_until_it_is_cleared_and_long_windows_do_not_remember_it(machine):
    machine.run(30.0, of('b', FAULTS['bias']))
    assert machine.run(60.0).faulty == ('b',)
    machine.isolator.clear('b')
    told = []
    machine.run(100.0, until=lambda v: told.append(v.state) and False)
    assert set(told) == {'healthy'}


def test_a_sensor_that_came_back_is_believed_again_if_that_is_wanted(machine):
    machine.isolator.settings = Settings(recovery='return', dwell=5.0)
    assert machine.run(30.0, of('b', FAULTS['bias'])).faulty == ('b',)
    assert machine.run(3.0).faulty == ('b',)
    assert machine.run(10.0).faulty == ()


def test_a_second_fault_during_a_first(machine):
    machine.run(20.0, of('b', FAULTS['bias']))

    def both(readings, time, random):
        return of('c', FAULTS['drop-out'])(of('b', FAULTS['bias'])(readings, time, random),
                                           time, random)
    assert machine.run(10.0, both).faulty == ('b', 'c')


def test_motion_beyond_what_was_learnt_is_allowed_for():
    def model(readings):  # estimates that err by 2 % of the motion, as they did when healthy
        return 1.02 * readings[[1, 2, 0]]
    machine = Machine()
    machine.run(360.0, estimates=model)
    told = []
    machine.run(150.0, estimates=model, motion=3.0, until=lambda v: told.append(v.state) and False)
    assert set(told) == {'healthy'}


def test_motion_that_is_faster_than_what_was_learnt_is_allowed_for():
    machine, told = Machine(), set()

    def run(seconds, speed, fault=None):
        def estimates(readings):  # they err by the speed
            return readings[[1, 2, 0]] + 0.03 * speed * np.cos(machine.phase)
        return machine.run(seconds, fault, estimates, speed=speed,
                           until=lambda v: fault is None and told.add(v.state))
    run(400.0, 1.0)
    told.clear()
    for speed in (1.3, 1.7, 2.2, 3.0):
        run(20.0, speed)
    run(100.0, 3.0)
    assert told == {'healthy'}
    assert run(20.0, 3.0, of('b', lambda reading, time, random: reading + 1.0)).faulty == ('b',)


def test_a_residual_that_its_own_channel_corrects_is_not_widened_by_how_far_that_goes():
    """An angle that goes round and round, by the innovation that a speed predicts."""
    tracked = Residual('angle without angle', ('angle',), 'angle', ('speed', 'angle'), (-0.5, 0.0),
                       NOISE, 6 * NOISE)
    isolator = Isolator(Settings(), ('speed', 'angle'), [tracked], PERIOD)
    random, told = np.random.default_rng(0), []
    for k in range(5000):
        error = NOISE * random.standard_normal(3) + [0.0, 0.0, 0.1 * (k >= 4500)]
        speed, angle = np.sin(0.2 * k * PERIOD), 3.0 * k * PERIOD + error[1]
        told.append(isolator.step(k * round(PERIOD * 1e9), np.array([speed + error[0], angle]),
                                  np.array([angle - error[2]])).state)
    assert set(told[:4500]) == {'healthy'} and set(told[4520:4600]) == {'suspected'}


def test_what_is_not_confirmed_is_not_looked_at(machine):
    wild = np.array([9.0, 0.0, 0.0])
    for k in range(100):
        verdict = machine.isolator.step((machine.tick + k) * 10**8, wild, wild[[1, 2, 0]], False)
    assert verdict.state == 'healthy'
    assert machine.run(5.0).state == 'healthy'


def test_a_jump_of_time_starts_the_windows_anew(machine):
    machine.tick += 1000
    machine.run(0.3)
    assert machine.isolator.watch.detector.filled.max() == 3
    assert machine.run(60.0).state == 'healthy'


def test_off_says_nothing():
    machine = Machine(mode='off')
    machine.run(10.0, of('b', FAULTS['bias']))
    assert machine.isolator.watch.detector.learnt.sum() == 0


def test_faults_that_are_too_small_to_be_found_are_said(machine):
    least = machine.isolator.smallest()['b']
    assert 0.0 < least < 0.1
    for wanted, said in ((0.5 * least, 1), (2.0 * least, 0)):
        machine.isolator.settings = Settings(smallest_fault={'b': wanted})
        assert len(machine.isolator.too_small()) == said


@pytest.mark.parametrize('settings, key', [
    ({'mode': 'yes'}, 'mode'), ({'recovery': 'never'}, 'recovery'),
    ({'false_alarms_per_day': 0.0}, 'false_alarms_per_day'),
    ({'model_error': 10.0}, 'model_error'), ({'model_error': float('nan')}, 'model_error'),
    ({'smallest_fault': {'b': -1.0}}, 'smallest_fault.b'),
    ({'smallest_fault': {'z': 1.0}}, 'smallest_fault')])
def test_wrong_settings_are_refused_in_one_line(settings, key):
    with pytest.raises(BadInput) as refused:
        Isolator(Settings(**settings), ('a', 'b', 'c'), RESIDUALS, PERIOD)
    assert refused.value.key == key


@pytest.mark.parametrize('wild', [np.inf, -np.inf, 1e308])
def test_numbers_beyond_use_are_no_readings(machine, wild):
    """Once they are nothing; for good the sensor has dropped out."""
    with np.errstate(all='raise'):
        once = machine.run(20.0, of('a', lambda reading, s, random: wild if s == 1.0 else reading))
        assert once.state == 'healthy'
        for_good = machine.run(20.0, of('a', lambda reading, s, random: wild))
    assert [(f.sensor, f.kind) for f in for_good.faults] == [('a', 'drop-out')]
