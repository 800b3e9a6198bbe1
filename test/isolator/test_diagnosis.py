"""From alarms to who is blamed."""

import numpy as np

from vsensor_ros.isolator.diagnosis import ANEW, AT_ONCE, Diagnosis, FORGOTTEN, JUST
from vsensor_ros.isolator.recovery import Recovery

A, B, C, D = 1, 2, 4, 8
SUPPORTS = (A | B, B | C, C | A, C | D)
ALL = np.ones(4, dtype=bool)


def tell(diagnosis, time, *checks, direct=(), stepped=()):
    alarms = np.zeros(4, dtype=bool)
    alarms[list(checks)] = True
    diagnosis.update(time, alarms, ALL, direct, lambda: stepped)
    return diagnosis


def test_what_one_residual_checks_cannot_be_told_apart():
    diagnosis = tell(Diagnosis(SUPPORTS), 1.0, 0)
    assert not diagnosis.found and diagnosis.candidates == (A, B) and diagnosis.stands


def test_the_common_sensor_is_blamed_and_its_alarms_may_end():
    diagnosis = tell(tell(Diagnosis(SUPPORTS), 1.0, 0), 1.5, 2)
    assert diagnosis.found == {A: 1.5} and diagnosis.candidates == ()
    tell(diagnosis, 100.0)  # it holds
    assert diagnosis.found == {A: 1.5}


def test_a_second_fault_during_a_first():
    diagnosis = tell(Diagnosis(SUPPORTS), 1.0, 0, 2)
    tell(diagnosis, 20.0, 0, 2, 3)
    assert diagnosis.found == {A: 1.0} and diagnosis.candidates == (C, D)
    tell(diagnosis, 20.5, 0, 2, 3, direct=[D])
    assert diagnosis.found == {A: 1.0, D: 20.5}


def test_everything_at_once_blames_nobody_and_takes_back_what_was_said_just_before():
    diagnosis = tell(Diagnosis(SUPPORTS), 1.0, 0, 2)
    assert diagnosis.found == {A: 1.0}
    tell(diagnosis, 1.0 + 0.5 * AT_ONCE, 0, 1, 2, 3)
    assert diagnosis.model and not diagnosis.found and diagnosis.stands


def test_alarms_that_blamed_nobody_are_forgotten():
    diagnosis = tell(Diagnosis(SUPPORTS), 1.0, 0)
    tell(diagnosis, 1.0 + 0.9 * FORGOTTEN)
    assert diagnosis.stands
    tell(diagnosis, 1.1 + FORGOTTEN)
    assert not diagnosis.stands and diagnosis.candidates == ()


def test_who_is_forgiven_takes_its_conflicts_along():
    diagnosis = tell(Diagnosis(SUPPORTS), 1.0, 0, 2)
    assert diagnosis.forgive(A, 2.0, ALL) == [0, 2]
    assert not diagnosis.stands and not diagnosis.found


def test_a_sensor_comes_back_by_a_jump_and_stays_for_the_dwell():
    recovery = Recovery(dwell=2.0)
    deviations = [1.0] * 10 + [0.3] * 30
    told = [recovery.step(0.1 * k, d, True, True) for k, d in enumerate(deviations)]
    assert told.index(True) == 30
    slow = Recovery(dwell=2.0)  # as a model that errs hides a fault for a while
    assert not any(slow.step(0.1 * k, d, True, True)
                   for k, d in enumerate(np.linspace(1.0, 0.0, 100)))
    assert not any(Recovery(dwell=2.0).step(0.1 * k, 0.0, False, False) for k in range(100))
    hidden = Recovery(dwell=2.0)  # nobody sees it come back
    assert not any(hidden.step(0.1 * k, None, True, True) for k in range(100))


def test_what_blamed_the_model_blames_no_sensor_for_a_while_when_that_is_over():
    diagnosis = tell(Diagnosis(SUPPORTS), 1.0, 0, 1, 2, 3)
    assert diagnosis.excusable().tolist() == [0, 1, 2, 3]
    diagnosis.dismiss(2.0)
    assert not diagnosis.model and not diagnosis.stands
    tell(diagnosis, 3.0, 0, 2)
    assert diagnosis.model and not diagnosis.found and diagnosis.excusable().tolist() == [0, 2]
    tell(diagnosis, 4.0, direct=[D])
    assert set(diagnosis.found) == {D} and not diagnosis.excusable().size
    later = tell(Diagnosis(SUPPORTS), 1.0, 0, 1, 2, 3)
    tell(later, 2.0 + FORGOTTEN)
    assert not later.model and not later.stands
    tell(later, 3.0 + FORGOTTEN + ANEW, 0, 2)
    assert set(later.found) == {A} and not later.excusable().size


def test_a_blamed_sensor_excuses_nothing():
    diagnosis = tell(Diagnosis(SUPPORTS), 1.0, 0, 2)
    assert set(diagnosis.found) == {A} and not diagnosis.excusable().size


def test_who_steps_as_a_check_begins_to_alarm_is_blamed_if_the_checks_would_tell_it():
    assert tell(Diagnosis(SUPPORTS), 1.0, 0, stepped=[A]).found == {A: 1.0}
    for stepped in ([], [C], [A, B]):  # none, one that it does not read, and two
        assert tell(Diagnosis(SUPPORTS), 1.0, 0, stepped=stepped).candidates == (A, B)
    # whatever has D in it has C in it, too: no residual ever tells D
    assert tell(Diagnosis(SUPPORTS), 1.0, 3, stepped=[D]).candidates == (C, D)
    assert tell(Diagnosis(SUPPORTS), 1.0, stepped=[A]).stands is False
    late = tell(Diagnosis(SUPPORTS), 1.0, 0)
    assert not tell(late, 1.5 + JUST, 0, stepped=[A]).found
    seen = tell(Diagnosis(SUPPORTS), 1.0, 0)  # some samples behind the step
    assert tell(seen, 1.1, 0, stepped=[A]).found == {A: 1.1}
    # what has a reason already tells of nobody else
    assert tell(seen, 1.2, 0, 2, stepped=[C]).found == {A: 1.1}


def test_a_step_while_another_drifts_is_no_error_of_the_model():
    both = (A, B, A | B)
    for stepped, found in (([], {}), ([B], {A: 2.0, B: 2.0})):
        diagnosis = Diagnosis(both)
        diagnosis.update(2.0, np.ones(3, dtype=bool), np.ones(3, dtype=bool), (),
                         lambda stepped=stepped: stepped)
        assert diagnosis.found == found and diagnosis.model is not bool(stepped)
