from dataclasses import replace
import math

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from hypothesis import given, strategies as st
import pytest
from rclpy.serialization import deserialize_message

from vsensor_ros.engine import ChannelState, EngineState, Policy
from vsensor_ros.node.diagnostics import (
    channel_facts,
    describe,
    describe_loop,
    encode,
    Lately,
    MANY,
    Report,
    Scene,
    WINDOW,
)
from vsensor_ros.reason import Reason

OK, WARN, ERROR, STALE = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR,
                          DiagnosticStatus.STALE)
NAN = math.nan
REAL = ChannelState('y2', '/y2', 'rad', 'real', None, (), '', 1.5, 0.0, None, 0.0, 0, NAN, NAN,
                    0.0, False, NAN, NAN, NAN, None, False, 0, 0, {}, 100, None)
ENGINE = EngineState((), (), (), ticks=10, left_out=0, estimates=0, jumps={}, starts=0, still=0.0)
ISOLATED, CONVERGING = Reason('isolated'), Reason.of('converging', seconds=2.3)


@pytest.fixture
def virtual(plan):
    return replace(
        REAL, source='virtual', reason=ISOLATED, fault_set=('y2',), grade='exact',
        deviation=0.0213, switches=1, last_step=0.001, since_s=12.0, virtual_s=12.0,
        serves=plan['y2', 'y2'])


def scene(plan, *faulty, policy=Policy(), complaints=(), switches=0):  # noqa: B008
    return Scene('/cell/replacer', plan, {'y2': policy}, faulty, {'y2': complaints},
                 {'y2': switches})


def told(channel, where):
    report = describe(channel, where, {'y1', 'y2'})
    return report.level, report.message


def test_a_healthy_channel_needs_no_words(plan):
    assert told(REAL, scene(plan)) == (OK, 'real')


def test_a_virtual_one_says_of_what_how_good_and_what_to_do(plan, virtual):
    assert told(virtual, scene(plan, 'y2')) == (
        WARN, 'virtual (isolated), from y1, good to 0.021 rad; repair y2')
    assert told(replace(virtual, deviation=math.inf, grade='bounded'), scene(plan, 'y2')) == (
        WARN, 'virtual (isolated), from y1, but unknown inputs still disturb it; repair y2')
    assert told(replace(virtual, reason=Reason.of(
        'served by a superset', why=ISOLATED, exact=CONVERGING)), scene(plan, 'y2'))[
        1].endswith('rad; converging, 2.3 s more; repair y2')


@pytest.mark.parametrize('policy, since, remedy', [
    (Policy('automatic', 2.0), 1.2, 'y2 is healthy again since 1.2 s, returns after 2 s'),
    (Policy('hold', 2.0), 1.2,
     'y2 is healthy again; call /cell/replacer/y2/clear to give it back'),
    (Policy('latched', 2.0), 99.0,
     'y2 is healthy again, but latched; /cell/replacer/reset gives it back'),
])
def test_what_brings_a_sensor_back_that_is_healthy_again(plan, virtual, policy, since, remedy):
    level, message = told(replace(virtual, recovering_s=since), scene(plan, 'y2', policy=policy))
    assert level == WARN and message == f'virtual, from y1, good to 0.021 rad; {remedy}'
    nothing = replace(REAL, source='none', reason=Reason('start unknown'), recovering_s=since)
    _, message = told(nothing, scene(plan, 'y2', policy=policy))
    assert message == ('no valid source (it is not known when it has forgotten its start); '
                       + remedy)


def test_a_forced_one_says_how_it_is_released(plan, virtual):
    level, message = told(replace(virtual, forced=True), scene(plan, 'y2'))
    assert level == WARN
    assert message.endswith('; forced; /cell/replacer/y2/force with false releases it')
    waits = replace(REAL, forced=True, reason=Reason.of('force waits', why=CONVERGING))
    assert told(waits, scene(plan)) == (WARN, 'real; force waits: converging, 2.3 s more')


def test_no_valid_source(plan):
    nothing = replace(REAL, source='none', reason=Reason.of(
        'instead', why=CONVERGING, instead=Reason('stop')))
    assert told(nothing, scene(plan, 'y2')) == (
        ERROR, 'no valid source (converging, 2.3 s more; nothing goes out); repair y2')
    _, message = told(nothing, scene(plan, 'y2', 'y3'))
    assert message.endswith('repair y2, or make a design for {y2, y3}')


def test_a_healthy_one_in_a_message_that_cannot_go_out(plan):
    nothing = replace(REAL, source='none', reason=Reason('not newer'))
    assert told(nothing, scene(plan, 'y1', 'y3')) == (
        ERROR, 'healthy, but nothing goes out with it (not sent on: not newer than what went '
        'out); repair y1')


def test_silence_is_stale_and_nothing_else_is(plan, virtual):
    silent = replace(REAL, source='silent', reason=Reason.of('nothing comes', topic='/y2_raw'))
    assert told(silent, scene(plan)) == (
        STALE, 'nothing comes on /y2_raw; check the driver of y2')
    assert STALE not in {told(c, scene(plan, 'y2'))[0] for c in (
        REAL, virtual, replace(REAL, source='none'))}


def test_a_silent_driver_of_a_virtual_channel_is_said(plan, virtual):
    reason = Reason.of('both', first=ISOLATED, second=Reason.of('driver silent', seconds=4.0))
    assert told(replace(virtual, reason=reason), scene(plan, 'y2'))[1].endswith(
        'good to 0.021 rad; its driver has been silent for 4.0 s; repair y2')


def test_what_others_do_on_its_topics_and_whipsaw_are_warnings(plan, virtual):
    level, message = told(REAL, scene(plan, complaints=['/y2: /b/replacer publishes there too']))
    assert level == WARN and message == 'real; /y2: /b/replacer publishes there too'
    assert told(REAL, scene(plan, switches=MANY - 1)) == (OK, 'real')
    level, message = told(REAL, scene(plan, switches=MANY))
    assert level == WARN and f'switched {MANY} times in 60 s' in message
    assert 'sensors.y2.dwell' in message
    assert told(replace(virtual, source='none'), scene(plan, 'y2', switches=99))[0] == ERROR


def test_the_loop():
    report = describe_loop(ENGINE, 'active', 0, [])
    assert (report.level, report.message) == (OK, 'active')
    assert describe_loop(ENGINE, 'inactive', 0, []).message == 'inactive; nothing goes out'
    assert describe_loop(ENGINE, 'inactive', 0, []).level == WARN
    report = describe_loop(ENGINE, 'active', 7, ['/u1: /x uses the type A, this node B'])
    assert report.level == WARN and '7 ticks left out in 60 s' in report.message
    assert report.message.endswith('/u1: /x uses the type A, this node B')
    assert '/clock' in describe_loop(replace(ENGINE, ticks=0), 'active', 0, []).message
    report = describe_loop(replace(ENGINE, still=3.0), 'active', 0, [])
    assert report.level == WARN and 'stands still: no /clock since 3.0 s' in report.message
    report = describe_loop(ENGINE, 'active', 0, [], 12)
    assert report.level == WARN and '12 messages of isolation thrown away' in report.message


def test_facts(plan, virtual):
    where = scene(plan, 'y2')
    facts = channel_facts(replace(virtual, counts={Reason('not finite'): 3}), where, 99.0)
    assert facts['source'] == 'virtual' and facts['faulty sensors'] == 'y2'
    assert facts['grade'] == 'exact' and facts['order'] == 0 and facts['not finite'] == 3
    assert facts['readings [Hz]'] == '99'
    assert facts['since [s]'] == '12.0' and facts['deviation'] == '0.0213'


texts = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=9)


@given(st.lists(st.tuples(texts, st.sampled_from([OK, WARN, ERROR, STALE]), texts, texts,
                          st.dictionaries(texts, texts | st.integers(), max_size=3)), max_size=4),
       st.integers(0, 2**31 * 10**9 - 1))
def test_the_message_as_rclpy_reads_it(statuses, stamp):
    raw = encode([(name, Report(name, level, message, topic, 'real'), facts)
                  for name, level, message, topic, facts in statuses], stamp)
    expected = DiagnosticArray(status=[
        DiagnosticStatus(level=level, name=name, message=message, hardware_id=topic, values=[
            KeyValue(key=key, value=str(fact)) for key, fact in facts.items()])
        for name, level, message, topic, facts in statuses])
    expected.header.stamp.sec, expected.header.stamp.nanosec = divmod(stamp, 10**9)
    assert deserialize_message(raw, DiagnosticArray) == expected


@given(st.lists(st.tuples(st.floats(0.0, 30.0), st.integers(0, 3)), min_size=1, max_size=40))
def test_what_grew_lately(steps):
    """A counter's growth in the window, by its definition."""
    lately, now, count, history = Lately(), 0.0, 0, []
    for wait, more in steps:
        now, count = now + wait, count + more * bool(history)
        history.append((now, count))
        before = [c for t, c in history if now - t > WINDOW]
        assert lately.grown('y', count, now) == count - (before[-1] if before else 0)
    assert len(lately._seen['y']) <= 2 + sum(now - t <= WINDOW for t, _ in history)
