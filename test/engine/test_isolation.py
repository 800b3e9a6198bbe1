import re

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hypothesis import given, strategies as st
import pytest
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from vsensor_ros.engine.isolation import (
    Allowance,
    from_statuses,
    from_text,
    LARGEST,
    may_name_one,
    MOST_STATUSES,
    names_one,
    names_one_in_text,
    PER_SECOND,
    Said,
    TOO_LARGE,
    TOO_MUCH,
)
from vsensor_ros.engine.isolation_names import Names, Wrong

SENSORS = ('y1', 'y2', 'y3')
NAMES = Names.of(SENSORS)
OK, WARN, ERROR, STALE = b'\x00', b'\x01', b'\x02', b'\x03'
SECOND = 10**9  # ns


def statuses(*pairs, names=NAMES, shared=True):
    """Understand (name, level) or (name, level, hardware_id)."""
    return from_statuses([(*pair, '')[:3] for pair in pairs], names, shared)


def by_sensor(said):
    """Return what is said of each sensor by its own name."""
    assert all(sensor == name for sensor, name in said.faulty)
    return {sensor: faulty for (sensor, _), faulty in said.faulty.items()}


def test_levels():
    said = statuses(('y1', ERROR), ('y2', STALE), ('y3', OK))
    assert by_sensor(said) == {'y1': True, 'y2': True, 'y3': False} and not said.problems


def test_absence_is_not_recovery_and_warn_changes_nothing():
    assert statuses() == Said({})
    assert by_sensor(statuses(('y1', OK), ('y2', WARN), ('y3', WARN))) == {'y1': False}


def test_others_names_are_passed_over():
    assert statuses(('tank', ERROR), ('motor', ERROR)) == Said({})


def test_names_that_are_no_sensors_on_a_topic_of_the_isolation():
    said = statuses(('Y1', ERROR), ('tank: y2', OK), ('motor', OK), ('pump', WARN),
                    ('knee', STALE), shared=False)
    assert said == Said({}, strangers={'Y1': True, 'tank: y2': False, 'knee': True})


def test_what_ends_like_a_sensor_is_no_stranger_to_be_passed_over_on_a_shared_topic():
    said = statuses(('isolator: y2', ERROR), ('/robot/y1', OK), ('isolator: y22', ERROR),
                    ('motor', ERROR))
    assert said == Said({}, strangers={'isolator: y2': True, '/robot/y1': False})


@pytest.mark.parametrize('levels, faulty', [
    ((ERROR, OK), True), ((OK, ERROR), True), ((OK, STALE, OK), True), ((OK, OK), False),
    ((WARN, ERROR, WARN), True), ((OK, WARN), None), ((WARN, OK), None)])
def test_of_several_statuses_of_one_name_the_worst_counts(levels, faulty):
    said = statuses(*(('y1', level) for level in levels))
    assert by_sensor(said) == ({} if faulty is None else {'y1': faulty})


def test_an_impossible_level_is_a_problem():
    said = statuses(('y1', b'\x07'), ('y2', ERROR), ('y3', b''))
    assert by_sensor(said) == {'y2': True} and len(said.problems) == 2


def test_a_sensor_is_known_by_the_hardware_and_by_the_names_it_was_given():
    names = Names.of(SENSORS, ['isolator: level 2=y2', 'motor_*: velocity=y3',
                               'hardware_id=SN-7[45]=y1', ''])
    said = statuses(('isolator: level 2', ERROR), ('motor_left: velocity', ERROR),
                    ('motor_left: current', ERROR), ('imu: frequency', OK, 'SN-74'),
                    ('imu: noise', STALE, 'SN-75'), ('imu: noise', STALE, 'SN-76'),
                    ('pump', ERROR, 'y3'), ('y1', OK, 'y2'), names=names)
    assert said.faulty == {
        ('y2', 'isolator: level 2'): True, ('y3', 'motor_left: velocity'): True,
        ('y1', 'imu: frequency'): False, ('y1', 'imu: noise'): True, ('y3', 'pump'): True,
        ('y1', 'y1'): False}  # its name counts before its hardware


def test_one_entry_may_name_each_sensor():
    names = Names.of(SENSORS, ['isolator: *=*', 'hardware_id=sensor-*=*', 'driver: y2='])
    said = statuses(('isolator: y1', ERROR), ('isolator: y4', ERROR), ('q', OK, 'sensor-y3'),
                    ('driver: y2', ERROR), names=names, shared=False)
    assert said == Said({('y1', 'isolator: y1'): True, ('y3', 'q'): False},
                        strangers={'isolator: y4': True})


@pytest.mark.parametrize('entries, problem, mend', [
    (['isolator: y2'], "'isolator: y2' is not NAME=SENSOR", "write it like 'isolator: y2=y2'"),
    (['=y2'], "'=y2' is not NAME=SENSOR", 'write it like'),
    (['hardware_id==y2'], 'is not NAME=SENSOR', 'write it like'),
    (['isolator: level=y22'], "is for 'y22', which is not a sensor", 'did you mean y2?'),
    (['isolator: level=knee'], "is for 'knee', which is not", 'name one of y1, y2, y3'),
    (['*=y2'], "'*=y2' is for every name there is", 'give a part of the name'),
    (['?[ab]*=y2'], 'is for every name there is', 'give a part of the name'),
    (['a*b*=*'], 'does not say which part', "as in 'isolator: *=*'"),
    (['isolator=*'], 'does not say which part', "as in 'isolator: *=*'"),
    (['y1=y2'], "gives 'y1' to y2, but it is that of y1 already", 'give a name to one sensor'),
    (['a=y1', 'a='], "gives 'a' to nobody, but it is that of y1", 'give a name to one sensor'),
    (['x' * 201 + '=y1'], 'has a name of 201 characters', 'at most 200'),
    ([f'{i}=y1' for i in range(1001)], 'has 1001 entries', 'at most 1000'),
    ([f'{i}*=y1' for i in range(51)], 'has 51 patterns', 'at most 50')])
def test_an_entry_that_cannot_be_used_is_refused(entries, problem, mend):
    with pytest.raises(Wrong) as caught:
        Names.of(SENSORS, entries)
    assert problem in caught.value.problem and mend in caught.value.mend
    assert len(f'{caught.value.problem} {caught.value.mend}') < 600


@pytest.mark.parametrize('name, meant', [
    ('isolator: y2', 'y2'), ('/robot/Y3', 'y3'), ('my y1 here', 'y1'), ('tank: y22', 'y2'),
    ('isolator: y_1', 'y1'), ('limb[3]: y3', 'y3'), ('knee', None), ('', None),
    ('y' * 10**6, None)])
def test_a_stranger_is_told_with_the_sensor_that_was_meant(name, meant):
    told = NAMES.tell(name)
    assert NAMES.nearest(name) == meant and 'is not a sensor' in told and len(told) < 600
    assert (f'did you mean {meant}' in told) == (meant is not None)
    if meant is not None:  # and the mend that is told works
        entry = re.search("add '(.*)' to", told).group(1)
        assert Names.of(SENSORS, [entry]).find(name) == meant
        assert Names.of(SENSORS, [re.search("not, '(.*)'", told).group(1)]).find(name) == ''


def test_text_is_the_complete_set():
    for text in ('y1,y3', 'y1 y3', ' y3,\ty1\n', 'y1, y3,,'):
        assert by_sensor(from_text(text, NAMES)) == {'y1': True, 'y2': False, 'y3': True}
    assert by_sensor(from_text('', NAMES)) == {'y1': False, 'y2': False, 'y3': False}


def test_a_text_may_use_the_names_that_were_given():
    names = Names.of(SENSORS, ['imu_left=y2', 'motor_*=y3', 'pump='])
    assert by_sensor(from_text('imu_left, motor_7 pump', names)) == {
        'y1': False, 'y2': True, 'y3': True}


def test_unknown_names_are_said_and_remove_no_fault():
    said = from_text('y1 elbow y22', NAMES)
    assert by_sensor(said) == {'y1': True} and set(said.strangers) == {'elbow', 'y22'}
    assert said.problems == ('so no sensor is taken as healthy',)
    assert by_sensor(from_text('["y3"]', NAMES)) == {}


def test_an_unreasonable_text_changes_nothing():
    said = from_text('y1 ' * 10**5, NAMES)
    assert not said.faulty and said.problems


def test_statuses_beyond_reason_are_not_looked_at():
    most = [('motor', OK)] * (MOST_STATUSES - 1) + [('y1', ERROR)]
    assert statuses(*most) == statuses(('y1', ERROR))
    said = statuses(*most, ('y2', ERROR))
    assert by_sensor(said) == {'y1': True} and str(MOST_STATUSES) in said.problems[0]


@given(st.lists(st.tuples(st.text(max_size=200) | st.sampled_from(SENSORS),
                          st.binary(max_size=2) | st.integers(-9, 9),
                          st.text(max_size=9)), max_size=30), st.booleans())
def test_garbage_names_no_other_sensor_and_is_told_in_few_words(garbage, shared):
    said = from_statuses(garbage, NAMES, shared)
    assert {sensor for sensor, _ in said.faulty} <= set(SENSORS)
    assert len(said.problems) <= 12 and all(len(p) < 600 for p in said.problems)
    assert all(len(NAMES.tell(name)) < 600 for name in said.strangers)


@given(st.sets(st.sampled_from(SENSORS)))
def test_both_ways_agree_when_all_is_said(faulty):
    said = statuses(*((name, ERROR if name in faulty else OK) for name in SENSORS))
    assert said == from_text(' '.join(sorted(faulty)), NAMES)


def flood(allowance, size, rate, seconds):
    """Return how many messages of a steady flood are read."""
    admitted = 0
    for i in range(round(rate * seconds)):
        allowance, reason = allowance.admit(size, SECOND + round(i * SECOND / rate))
        admitted += reason is None
    return admitted


@pytest.mark.parametrize('size', [100, 10_000, LARGEST])
def test_a_flood_is_read_at_the_rate_that_is_allowed(size):
    counted = max(size, 1024)  # so that small ones are bounded in number
    rate = 3 * PER_SECOND / counted
    # what was saved up, and ten seconds of refilling
    assert flood(Allowance(), size, rate, 10.0) == pytest.approx(11 * PER_SECOND / counted, abs=1)


def test_what_an_isolation_says_at_its_rate_is_always_read():
    assert flood(Allowance(), 2000, 100.0, 20.0) == 2000


def test_a_message_that_is_too_large_costs_nothing():
    allowance, reason = Allowance(time=SECOND).admit(LARGEST + 1, SECOND)
    assert reason == TOO_LARGE and allowance.left == PER_SECOND
    for _ in range(PER_SECOND // LARGEST):
        allowance, reason = allowance.admit(LARGEST, SECOND)
        assert reason is None
    assert allowance.admit(1, SECOND)[1] == TOO_MUCH


def raw(*names, hardware_id=''):
    return serialize_message(DiagnosticArray(status=[
        DiagnosticStatus(name=name, message='of y1 it says', hardware_id=hardware_id)
        for name in names]))


def test_a_sensor_is_found_in_the_bytes_by_its_whole_name():
    names = Names.of(['y1', 'y2'])
    assert names_one(raw('other', 'y1'), names)
    assert names_one(raw('other', hardware_id='y2'), names)
    assert not names_one(raw('y11', 'xy1', 'replacer: y1'), names)
    assert may_name_one(raw('xy1'), names) and not may_name_one(raw('y11', 'tank'), names)
    assert names_one(b'\0\0\0\0\0\0\0\3y1\0', names)  # big endian
    for text in ('', ' , ', 'y1'):
        assert names_one_in_text(serialize_message(String(data=text)), names)
    assert not names_one_in_text(serialize_message(String(data='q')), names)


@pytest.mark.parametrize('entry, name, hardware_id', [
    ('isolator: level=y1', 'isolator: level', ''), ('isolator: *=*', 'isolator: y2', ''),
    ('motor_*: velocity=y1', 'motor_left: velocity', ''), ('level[123]=y1', 'level2', ''),
    ('hardware_id=SN-74=y1', 'imu', 'SN-74'), ('hardware_id=SN-7?=y1', 'imu', 'SN-74'),
    ('größe=y1', 'größe', '')])
def test_names_that_were_given_are_found_in_the_bytes(entry, name, hardware_id):
    names = Names.of(['y1', 'y2'], [entry])
    assert names.find(name, hardware_id)
    message = raw('other', name, hardware_id=hardware_id)
    assert names_one(message, names) and may_name_one(message, names)
    assert not may_name_one(raw('other', 'tank', 'SN74'), names)
