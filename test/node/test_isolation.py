from hypothesis import given, strategies as st

from vsensor_ros.node.isolation import from_statuses, from_text

SENSORS = ('y1', 'y2', 'y3')
OK, WARN, ERROR, STALE = b'\x00', b'\x01', b'\x02', b'\x03'


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
    assert said.faulty == {'y3'} and len(said.problems) == 2
    assert 'Y1' in said.problems[0] and 'tank: y2' in said.problems[1]


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
    assert from_text('["y3"]', SENSORS, frozenset({'y3'})).faulty == {'y3'}


def test_an_unreasonable_text_changes_nothing():
    known = frozenset({'y2'})
    said = from_text('y1 ' * 10**5, SENSORS, known)
    assert said.faulty == known and said.problems
    assert len(from_text('a b c d e f g h', SENSORS, known).problems) == 7


@given(st.sets(st.sampled_from(SENSORS)), st.sets(st.sampled_from(SENSORS)))
def test_both_ways_agree_when_all_is_said(faulty, before):
    statuses = [(name, ERROR if name in faulty else OK) for name in SENSORS]
    assert from_statuses(statuses, SENSORS, frozenset(before)).faulty == faulty
    assert from_text(' '.join(sorted(faulty)), SENSORS, frozenset(before)).faulty == faulty
