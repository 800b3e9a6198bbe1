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
    MOST_STATUSES,
    names_one,
    names_one_in_text,
    PER_SECOND,
    TOO_LARGE,
    TOO_MUCH,
)

SENSORS = ('y1', 'y2', 'y3')
OK, WARN, ERROR, STALE = b'\x00', b'\x01', b'\x02', b'\x03'
SECOND = 10**9  # ns


def test_levels():
    said = from_statuses([('y1', ERROR), ('y2', STALE), ('y3', OK)], SENSORS, frozenset({'y3'}))
    assert said.faulty == {'y1', 'y2'} and not said.problems


def test_absence_is_not_recovery_and_warn_changes_nothing():
    known = frozenset({'y1', 'y2'})
    assert from_statuses([], SENSORS, known).faulty == known
    assert from_statuses([('y1', OK), ('y2', WARN), ('y3', WARN)], SENSORS, known).faulty == {'y2'}


def test_others_names_are_passed_over():
    said = from_statuses([('replacer: y1', ERROR), ('motor', ERROR)], SENSORS, frozenset())
    assert said.faulty == frozenset() and not said.problems


def test_names_that_are_no_sensors_on_a_topic_of_the_isolation():
    statuses = [('Y1', ERROR), ('tank: y2', STALE), ('motor', OK), ('pump', WARN)]
    said = from_statuses(statuses, SENSORS, frozenset({'y3'}), shared=False)
    assert said.faulty == {'y3'}
    assert said.problems == ("'Y1' is not a sensor; did you mean y1?",
                             "'tank: y2' is not a sensor; did you mean y2?")


def test_the_last_word_counts():
    said = from_statuses([('y1', ERROR), ('y1', OK)], SENSORS, frozenset())
    assert said.faulty == frozenset()


def test_an_impossible_level_is_a_problem():
    said = from_statuses([('y1', b'\x07'), ('y2', ERROR), ('y3', b'')], SENSORS, frozenset())
    assert said.faulty == {'y2'} and len(said.problems) == 2


def test_text_is_the_complete_set():
    for text in ('y1,y3', 'y1 y3', ' y3,\ty1\n', 'y1, y3,,'):
        assert from_text(text, SENSORS, frozenset({'y2'})).faulty == {'y1', 'y3'}
    assert from_text('', SENSORS, frozenset({'y2'})).faulty == frozenset()


def test_unknown_names_are_said_and_remove_no_fault():
    said = from_text('y1 elbow y22', SENSORS, frozenset({'y3'}))
    assert said.faulty == {'y1', 'y3'} and len(said.problems) == 3
    assert any('did you mean y2' in p for p in said.problems)
    assert any(p.endswith('there are y1, y2, y3') for p in said.problems)
    assert from_text('["y3"]', SENSORS, frozenset({'y3'})).faulty == {'y3'}


def test_an_unreasonable_text_changes_nothing():
    known = frozenset({'y2'})
    said = from_text('y1 ' * 10**5, SENSORS, known)
    assert said.faulty == known and said.problems
    assert len(from_text('a b c d e f g h', SENSORS, known).problems) == 7


def test_statuses_beyond_reason_are_not_looked_at():
    most = [('motor', OK)] * (MOST_STATUSES - 1) + [('y1', ERROR)]
    assert from_statuses(most, SENSORS, frozenset()) == from_statuses(
        [('y1', ERROR)], SENSORS, frozenset())
    said = from_statuses([*most, ('y2', ERROR)], SENSORS, frozenset())
    assert said.faulty == {'y1'} and str(MOST_STATUSES) in said.problems[0]


@given(st.lists(st.tuples(st.text(max_size=200) | st.sampled_from(SENSORS),
                          st.binary(max_size=2) | st.integers(-9, 9)), max_size=30), st.booleans())
def test_garbage_names_no_other_sensor_and_is_told_in_few_words(statuses, shared):
    said = from_statuses(statuses, SENSORS, frozenset(), shared)
    assert said.faulty <= set(SENSORS)
    assert len(said.problems) <= 12 and all(len(p) < 600 for p in said.problems)


@given(st.sets(st.sampled_from(SENSORS)), st.sets(st.sampled_from(SENSORS)))
def test_both_ways_agree_when_all_is_said(faulty, before):
    statuses = [(name, ERROR if name in faulty else OK) for name in SENSORS]
    assert from_statuses(statuses, SENSORS, frozenset(before)).faulty == faulty
    assert from_text(' '.join(sorted(faulty)), SENSORS, frozenset(before)).faulty == faulty


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


def test_a_sensor_is_found_in_the_bytes_by_its_whole_name():
    def raw(*names):
        return serialize_message(DiagnosticArray(
            status=[DiagnosticStatus(name=name, message='of y1 it says') for name in names]))

    assert names_one(raw('other', 'y1'), ['y1', 'y2'])
    assert not names_one(raw('y11', 'xy1', 'replacer: y1'), ['y1', 'y2'])
    assert names_one(b'\0\0\0\0\0\0\0\3y1\0', ['y1'])  # big endian
    for text in ('', ' , ', 'y1'):
        assert names_one_in_text(serialize_message(String(data=text)), ['y1'])
    assert not names_one_in_text(serialize_message(String(data='q')), ['y1'])
