"""What is said of a topic, of what was seen and heard there."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from vsensor_ros.commissioning.findings import (
    COMMAND,
    FAIL,
    INPUT,
    ISOLATION,
    judge,
    judge_clock,
    logged,
    OUTPUT,
    Use,
    WARN,
    World,
)
from vsensor_ros.reason import Reason

RANGE, NUMBER = 'sensor_msgs/msg/Range', 'std_msgs/msg/Float64'
LACKING = Reason.of('not in the message', field='position[elbow]')


def party(node='/driver', kind=RANGE, mismatch=''):
    return SimpleNamespace(node=node, type=kind, mismatch=mismatch,
                           mend='change it there' if mismatch else '')


def said(found=100, nan=0, lack=None):
    return SimpleNamespace(found=found, nan=nan, lack=lack)


def sound(count=100, rate=100.0, age=(0.001, 0.001), **more):
    return SimpleNamespace(**{'count': count, 'rate': rate, 'age': age, 'unreadable': 0,
                              'longest': 0.02, 'returns': 0, 'repeated': 0, 'names': {}, **more})


DRIVER = party()


def use(role=INPUT, publishers=(DRIVER,), heard=None, field=None, listeners=(), path='range'):
    topic = {INPUT: '/y_raw', OUTPUT: '/y', COMMAND: '/u', ISOLATION: '/isolation'}[role]
    channels = {INPUT: {'y': path}, OUTPUT: {'y': path}, COMMAND: {'u': 'data'}}.get(role, {})
    return Use(topic, NUMBER if role == COMMAND else RANGE, role, channels, tuple(publishers),
               tuple(listeners), heard if heard is not None or role in (OUTPUT, ISOLATION)
               else sound(), {p: field or said() for p in channels.values()},
               '/y' if role == INPUT else '')


def world(**more):
    return World(**{'node': '/replacer', 'seconds': 5.0, 'topics': {}, 'used': frozenset(),
                    'max_age': {'y': 0.5}, 'isolates': False, 'simulated': False,
                    'clock_moves': False, 'clock_publishers': (), **more})


def findings(one, *others, **more):
    uses = {(u.topic, u.role): u for u in (one, *others)}
    return [(f.level, str(f)) for f in judge(one, uses, world(**more))]


def one(found):
    (level, text), = found
    return level, text


def test_what_is_well_is_not_mentioned():
    assert findings(use()) == findings(use(COMMAND, [party(kind=NUMBER)])) == []
    assert findings(use(ISOLATION)) == []
    assert findings(use(OUTPUT, (), listeners=[party('/rviz')]), use()) == []
    assert findings(use(OUTPUT, [party('/replacer')]), use()) == []  # it runs already
    assert judge_clock(world()) == judge_clock(
        world(simulated=True, clock_moves=True, clock_publishers=('/sim',))) == []


def test_a_misspelt_topic():
    level, text = one(findings(use(COMMAND, (), sound(0)), topics={'/U': NUMBER, '/y': RANGE}))
    assert (level, text) == (FAIL, 'u was never heard on /u; did you mean /U?')


def test_a_topic_that_another_sensor_has_is_not_proposed():
    level, text = one(findings(use(INPUT, (), sound(0)), topics={'/y2_raw': RANGE},
                               used=frozenset({'/y2_raw'})))
    assert level == FAIL and 'start its driver' in text and '/y2_raw' not in text


def test_a_driver_that_was_not_remapped_is_said_once():
    source, output = use(INPUT, (), sound(0)), use(OUTPUT, [party()])
    assert one(findings(source, output))[1].endswith('remap it there: --ros-args -r /y:=/y_raw')
    assert findings(output, source) == []


@pytest.mark.parametrize('other, words', [
    (party(kind=NUMBER), 'publishes std_msgs/msg/Float64 on /y_raw'),
    (party(mismatch='reliability'), 'does not fit (reliability)'),
])
def test_types_and_qos(other, words):
    level, text = one(findings(use(INPUT, [other], sound(0))))
    assert level == FAIL and words in text
    level, text = one(findings(use(OUTPUT, (), listeners=[other]), use()))
    assert level == FAIL and '/y' in text


def test_one_that_says_nothing():
    level, text = one(findings(use(INPUT, heard=sound(0))))
    assert level == FAIL and '/driver is there, but says nothing' in text


def test_a_missing_joint():
    heard = sound(names={'elbow1': None, 'wrist': None})
    level, text = one(findings(use(heard=heard, field=said(0, lack=LACKING),
                                   path='position[elbow]')))
    assert level == FAIL and text.endswith('did you mean position[elbow1]?')
    heard = sound(names={'elbow': None})  # but no position of it
    assert one(findings(use(heard=heard, field=said(0, lack=LACKING), path='position[elbow]')))[
        1].endswith('name a field that its messages have')
    heard = sound(names={f'joint{i}': None for i in range(9)})
    assert one(findings(use(heard=heard, field=said(0, lack=LACKING), path='position[elbow]')))[
        1].endswith('there are joint0, joint1, joint2, joint3, joint4, joint5 and 3 more')


@pytest.mark.parametrize('field, level', [(said(0, 100), FAIL), (said(90, 10), WARN)])
def test_nan(field, level):
    assert one(findings(use(field=field)))[0] == level


@pytest.mark.parametrize('age, spread, level, words', [
    (0.3, 0.001, WARN, '300 ms late'), (0.6, 0.001, FAIL, 'older than max_age (0.5 s)'),
    (-0.3, 0.001, FAIL, '300 ms ahead'), (1.7e9, 0.0, FAIL, 'of another clock'),
    (0.01, 0.4, WARN, 'uneven')])
def test_stamps(age, spread, level, words):
    said_level, text = one(findings(use(heard=sound(age=(age, spread)))))
    assert said_level == level and words in text


def test_stamps_of_another_clock_are_told_as_the_replacer_tells_it():
    level, text = one(findings(use(heard=sound(age=(1.7e9, 0.0))), now=1.7000001e9))
    assert level == FAIL and text.startswith(
        "/y_raw speaks, but its stamps are of another clock (1700000000 s behind this node's: "
        'time since boot, or of a simulation?); ')


def test_stamps_that_repeat_are_not_called_late():
    whole = sound(age=(0.5, 0.45), repeated=98)  # a message every 10 ms, a stamp every 1 s
    level, text = one(findings(use(heard=whole), max_age={'y': 2.0}))
    assert (level, text) == (
        WARN, 'the stamps on /y_raw repeat: 98 of 100 are that of the message before, so these '
        'readings are not used; stamp each when it is measured')
    assert one(findings(use(heard=whole)))[0] == FAIL  # silent in between
    assert one(findings(use(heard=sound(age=(3.0, 1.0), repeated=99))))[0] == FAIL
    assert one(findings(use(COMMAND, [party(kind=NUMBER)], whole)))[0] == WARN
    assert 'late' in one(findings(use(heard=sound(age=(0.3, 0.0), repeated=40))))[1]


def test_nothing_is_late_by_a_clock_that_stands_still():
    late = use(heard=sound(age=(-111.0, 5.0)))
    assert findings(late, simulated=True, clock_moves=False) == []
    assert one(findings(late, simulated=True, clock_moves=True))[0] == FAIL


def test_an_error_of_the_replacer_is_about_the_topics_that_it_names():
    topics = ['/y', '/y_raw', '/isolation', '/y']
    assert [(f.level, f.topics, str(f)) for f in logged([
        'the stamps on /y_raw are off', '/isolation: no sensor', 'all is lost',
        'Traceback (most recent call last):\n  here\nValueError: no'], topics)] == [
        (WARN, ('/y_raw',), 'the stamps on /y_raw are off'),
        (WARN, ('/isolation',), '/isolation: no sensor'), (WARN, (), 'all is lost'),
        (WARN, (), 'ValueError: no')]


def test_a_command_of_another_clock_is_a_warning():
    assert one(findings(use(COMMAND, [party(kind=NUMBER)], sound(age=(1.7e9, 0.0)))))[0] == WARN
    assert one(findings(use(COMMAND, [party(kind=NUMBER)], sound(age=(-0.3, 0.0)))))[0] == WARN


def test_a_sensor_that_is_slower_than_its_silence():
    level, text = one(findings(use(heard=sound(rate=1.0, longest=1.1))))
    assert level == FAIL and text.endswith('raise max_age to 3 or so')
    assert one(findings(use(heard=sound(longest=0.7))))[0] == WARN


def test_two_publishers():
    both = [party('/a'), party('/b')]
    assert one(findings(use(INPUT, both, sound(returns=50)))) == (
        FAIL, '/a and /b publish on /y_raw in turn, both y; end one, give it a topic of its own, '
        'or choose one with sensors.y.publisher')
    numbers = [party('/a', NUMBER), party('/b', NUMBER)]
    assert one(findings(use(COMMAND, numbers, sound(returns=50)))) == (
        FAIL, '/a and /b publish on /u in turn, both u; end one, give it a topic of its own, or '
        'choose one with commands.u.publisher')
    assert one(findings(use(INPUT, both)))[0] == WARN  # one may be quiet
    assert findings(use(INPUT, both, sound(returns=50), said(50, lack=LACKING))) == []
    assert '/a (2 times)' in one(findings(use(INPUT, [party('/a'), party('/a')])))[1]


def test_a_publisher_that_was_chosen():
    both = replace(use(INPUT, [party('/a'), party('/b')], sound(returns=50)), chosen={'y': '/a'})
    assert findings(both) == []
    level, text = one(findings(replace(both, publishers=(party('/b'),))))
    assert level == FAIL and '/a was chosen, and does not publish on /y_raw' in text


def test_an_output_that_is_taken():
    level, text = one(findings(use(OUTPUT, [party('/old')]), use()))
    assert level == FAIL and '/old publishes on /y already' in text
    assert '2 nodes called /replacer' in one(findings(
        use(OUTPUT, [party('/replacer'), party('/replacer')]), use()))[1]


def test_no_isolation():
    level, text = one(findings(use(ISOLATION, ()), topics={'/robot/isolation': RANGE}))
    assert level == FAIL and text.endswith('did you mean /robot/isolation?')
    assert one(findings(use(ISOLATION, ()), isolates=True))[0] == WARN


@pytest.mark.parametrize('more, level, words', [
    ({'simulated': True}, FAIL, 'nobody publishes /clock'),
    ({'simulated': True, 'clock_publishers': ('/sim',)}, FAIL, '/clock of /sim stands still'),
    ({'clock_publishers': ('/sim',)}, WARN, '/sim publishes /clock, but use_sim_time is false')])
def test_the_clock(more, level, words):
    finding, = judge_clock(world(**more))
    assert finding.level == level and words in str(finding)
