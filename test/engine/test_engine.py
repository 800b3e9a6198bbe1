"""The engine, told of events without any node: what it forwards, says and shows."""

from dataclasses import replace
import math
from pathlib import Path
import sys

import pytest

sys.path.append(str(Path(__file__).parent))
from machine import ABSENT, faulty, Machine, PERIOD, Said, SECOND

from vsensor_ros.engine import (
    ANYBODYS,
    Engine,
    Forward,
    IsolationReport,
    Setup,
    StreamPlan,
    Substitute,
    together,
)
from vsensor_ros.reason import Reason


def test_the_healthy_go_on_as_they_came(bench):
    m = Machine(bench)
    assert m.step(1.5, 3.0, 20) == [Forward({}), Forward({})] and not m.sent
    assert m.state('y2').source == 'real' and m.state('y2').value == 3.0
    assert m.hear(1, 3.0) == Forward({})  # with the same stamp
    assert m.state('y2').counts == {Reason('duplicate stamp'): 1}


def test_a_failed_one_is_spoken_for_from_its_last_message(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    m.isolate('y2')
    assert m.step(2.0, 99.0, 5) == [Forward({}), None]
    last = m.sent[-1]
    assert last.stream == 1 and last.template == 'message' and last.stamp == m.now
    (index, said), = last.fields
    assert index == 0 and isinstance(said, Substitute) and said.fault_set == ('y2',)
    assert said.value == 4.0 and said.grade == 'exact' and said.interval is None
    y2 = m.state('y2')
    assert (y2.source, y2.value, y2.switches, str(y2.reason)) == ('virtual', 4.0, 1, 'isolated')
    assert m.state('y1').source == 'real' and m.state('y1').switches == 0
    m.isolate()
    assert m.step(2.0, 4.0) == [Forward({}), Forward({})] and m.state('y2').switches == 2


def test_the_others_of_its_message_stay_live(bench):
    m = Machine(bench, shared=True, without_estimate='nan')
    m.step(1.5, 3.0, 20)
    m.isolate('y2')
    m.step(2.0, 99.0, 2)
    (first, live), (second, said) = m.sent[-1].fields
    assert (first, live, second, said.value) == (0, 2.0, 1, 4.0)
    assert m.hear(0, ABSENT, 99.0, stamp=m.now + 1) is None
    for _ in range(60):  # all are silent
        m.pass_time(1)
    assert m.sent[-1].blank and m.sent[-1].fields[0] == (0, None)


def test_messages_of_others_pass_unless_they_may_be_of_the_failed(bench):
    m = Machine(bench, shared=True)
    m.step(1.5, 3.0, 20)
    other = Said(m.now + 1, (ABSENT, ABSENT), True)
    assert m.engine.failed_templates(0) is None
    assert m.engine.judge(0, other, 'other') == Forward({})
    m.isolate('y2')
    (number, template), = m.engine.failed_templates(0)
    assert template == 'message'
    assert m.engine.judge(0, other, 'other') == Forward({})  # of joints that are nobody's
    assert m.engine.judge(0, other, 'other', ANYBODYS) is None
    assert m.engine.judge(0, other, 'other', number) is None


def test_an_offset_dies_out_both_ways(bench):
    m = Machine(bench, time_constant=0.1)
    m.step(1.5, 3.25, 400)  # a quarter more than the model says
    m.isolate('y2')
    said = m.sent[-1].fields[0][1]
    assert said.value == pytest.approx(3.25) and said.offset == pytest.approx(0.25)
    m.step(1.5, 99.0, 100)
    assert m.sent[-1].fields[0][1].value == pytest.approx(3.0, abs=1e-3)
    m.isolate()
    changed = m.step(1.5, 3.25)[1].changed
    assert changed[0] == pytest.approx(3.25 - 0.25 * math.exp(-0.1), abs=0.03)


@pytest.mark.parametrize('instead, value', [('stop', None), ('nan', math.nan), ('hold', 3.0)])
def test_without_an_estimate(bench, instead, value):
    m = Machine(bench, without_estimate=instead)
    m.step(1.5, 3.0, 20)
    m.isolate('y1', 'y2')
    before = len(m.sent)
    m.step(9.0, 99.0, 3)
    y2 = m.state('y2')
    assert y2.source == 'none' and math.isnan(y2.value)
    assert y2.reason.code == 'instead' and y2.reason.fact('instead') == Reason(instead)
    assert y2.reason.fact('why').code == 'no design'
    if value is None:
        assert len(m.sent) == before
    else:
        said = m.sent[-1].fields[0][1]
        assert said.value == pytest.approx(value, nan_ok=True) and said.fault_set is None


def test_a_message_that_cannot_be_made_is_why_there_is_no_source(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    made = m.engine.isolate(faulty('y2'))
    m.engine.done(made[0], Reason.of('does not fit', value='1e99', field='range', type='float'))
    assert m.state('y2').source == 'none' and 'does not fit' in str(m.state('y2').reason)
    assert m.engine.snapshot(0.0).estimates == 0
    m.engine.done(made[0], Reason.of('not sent', text='out of memory'))
    assert m.state('y2').counts == {Reason.of('not sent', text='out of memory'): 1}
    m.pass_time(1)
    m.step(1.5, 3.0)
    assert m.state('y2').source == 'virtual'


def test_what_is_to_be_said_is_said_once(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    m.isolate('y2')
    said = [str(remark.what) for remark in m.engine.remarks()]
    assert said == ['faulty sensors: y2'] and m.engine.remarks() == []
    assert m.engine.changed() and not m.engine.changed()
    m.now -= 5 * SECOND
    m.pass_time()
    assert str(m.engine.remarks()[0].what).startswith('the clock jumped back by 5.0 s')
    state = m.engine.snapshot(0.0)
    assert state.jumps == {'backwards': 1} and state.starts == 1


def test_several_sources_of_isolation():
    one = IsolationReport({'y1': 5, 'y2': 7}, frozenset(('y1', 'y2', 'y3')))
    two = IsolationReport({'y2': 6}, frozenset(('y2', 'y4')))
    assert together(one, two) == IsolationReport(
        {'y1': 5, 'y2': 6}, frozenset(('y1', 'y2', 'y3', 'y4')))
    assert together() == IsolationReport({}, frozenset())


def test_since_when_isolation_says_so(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    m.engine.isolate(IsolationReport({'y2': m.now - SECOND}, frozenset(('y2',))))
    assert m.state('y2').isolated_s == pytest.approx(1.0)
    assert math.isnan(m.state('y1').isolated_s)


@pytest.mark.parametrize('rate, told', [(0.0, 'rate'), (math.nan, 'rate')])
def test_a_setup_that_will_not_do(bench, rate, told):
    m = Machine(bench)
    with pytest.raises(ValueError, match=told):
        Engine(Setup(m.engine._design, rate, {'y1': 0.5, 'y2': 0.5}, 10.0,
                     (StreamPlan(('y1',), '/a', '/b', True), StreamPlan(
                         ('y2',), '/c', '/d', True)), True, m.engine._stand_in.live))


def test_a_mistake_in_one_stream_ends_no_other(bench, monkeypatch):
    m = Machine(bench, without_estimate='nan')
    m.step(1.5, 3.0, 20)

    def stumble(*_):
        raise ZeroDivisionError
    m.isolate('y1', 'y2')
    monkeypatch.setattr(m.engine._streams[0], 'compose', stumble)
    m.step(9.0, 99.0, 5)
    assert [c.stream for c in m.sent[-5:]] == [1] * 5
    assert m.state('y1').counts == {Reason.of('mistake', error='ZeroDivisionError'): 5}
    assert any('stumble' in str(remark.what) for remark in m.engine.remarks())


def test_a_flood_drowns_nothing_that_is_said(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    m.isolate('y2')
    for _ in range(5000):
        m.hear(0, math.nan, stamp=5)
    said = [str(remark.what) for remark in m.engine.remarks()]
    assert said[0] == 'faulty sensors: y2' and len(said) == 3
    assert 'y1: not finite (5000 so far)' in said


def test_a_jump_of_the_clock_is_not_the_fault_of_isolation(bench):
    m = Machine(bench)
    early = Engine(Setup(m.engine._design, 100.0, {'y1': 0.5, 'y2': 0.5}, 10.0, (
        StreamPlan(('y1', 'y2'), '/a', '/b', True),), True, m.engine._stand_in.live))
    early.isolate(faulty('y2'))  # before any time is known
    early.look(1000 * SECOND, 0.0)
    early.look(1001 * SECOND, 0.0)
    assert early.snapshot(0.0).channels[1].isolated_s == pytest.approx(1.0, abs=1.1)
    m.step(1.5, 3.0, 20)
    m.engine.isolate(IsolationReport({'y2': m.now - SECOND}, frozenset(('y2',))))
    m.now -= 100 * SECOND
    m.pass_time()
    assert m.state('y2').isolated_s == pytest.approx(1.0)


def test_names_that_are_no_sensors_are_left_out(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    m.isolate('y2', 'y9')
    state = m.engine.snapshot(0.0)
    assert state.faulty == ('y2',) and state.spoken_of == ('y2',)


def test_every_snapshot_is_its_own(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 3)
    state = m.engine.snapshot(0.0)
    with pytest.raises(TypeError):
        state.jumps['backwards'] = 3
    with pytest.raises(TypeError):
        state.channels[0].counts[Reason('isolated')] = 3
    m.hear(0, math.nan, stamp=5)
    assert not state.channels[0].counts and m.state('y1').counts


def test_what_keeps_the_reserve_from_serving_is_told_before_the_fault(bench):
    m = Machine(bench)
    m.pass_time(1)
    assert m.state('y2').reserve.code == 'never seen'

    def only_y2(periods):
        for _ in range(periods):
            m.now += PERIOD
            m.hear(1, 3.0)
            m.pass_time()
    only_y2(20)
    assert str(m.state('y2').reserve) == 'no reading of y1 yet'
    m.step(1.5, 3.0, 20)
    assert m.state('y2').reserve is None and m.state('y1').reserve is None
    only_y2(60)
    assert m.state('y2').reserve.code == 'input silent'
    m.isolate('y2')  # and so it is
    y2 = m.state('y2')
    assert y2.source == 'none' and y2.reason.fact('why').code == y2.reserve.code == 'input silent'
    m.step(1.5, 99.0, 20)
    assert m.state('y2').source == 'virtual' and m.state('y2').reserve is None
    assert m.state('y1').reserve.code == 'no design'  # for both


def test_an_estimate_that_is_too_uncertain_is_no_reserve(bench):
    m = Machine(bench, max_deviation={'y1': 0.0, 'y2': 1e-9})
    m.step(1.5, 3.0, 20)
    assert m.state('y2').reserve.code == 'too uncertain' and m.state('y1').reserve is None


def test_who_would_speak_and_how_well_is_told_before_the_fault(bench):
    m = Machine(bench)
    assert m.engine.reserve('y2') is None
    m.step(1.5, 3.0, 20)
    fault_set, deviation = m.engine.reserve('y2')
    m.isolate('y2')
    m.step(1.5, 99.0)
    assert (m.state('y2').fault_set, m.state('y2').source) == (fault_set, 'virtual')
    assert m.state('y2').deviation == pytest.approx(deviation, rel=0.1)
    assert m.engine.reserve('y1') is None  # for both nothing is designed


def test_to_look_changes_nothing(bench):
    looked, other = Machine(bench), Machine(bench)
    for m in (looked, other):
        for i in range(40):
            m.step(1.5 + 0.01 * i, 3.0 + 0.02 * i)
            if m is looked:
                m.state('y1')
        m.isolate('y2')
        m.step(2.0, 99.0, 5)
    assert [c.fields for c in looked.sent] == [c.fields for c in other.sent]


def test_a_reserve_that_reads_no_sensor_is_ready_though_stamps_are_of_another_clock(bench):
    m = Machine(bench)
    alone = [bench.virtual_sensor([], [], Q=[], fault_set=('y1', 'y2'), healthy=(), channel=name)
             for name in ('y1', 'y2')]
    twice = bench.virtual_sensor([], [], Q=[[2.0]], fault_set=('y2',), healthy=('y1',))
    for more, ready in (((), False), (alone, True)):
        m.setup = replace(m.setup, design=bench.design(twice, *more))
        m.engine = Engine(m.setup)
        m.engine.look(m.now, 0.0)
        m.engine.activate()
        for _ in range(200):
            m.now += PERIOD
            m.hear(0, 1.5, stamp=m.now - 900 * SECOND)
            m.hear(1, 3.0)
            m.pass_time()
            m.engine.changed()  # as the node asks now and then
        y1, y2 = m.state('y1'), m.state('y2')
        assert (y1.source, y1.reason.code) == ('real', 'input of another clock')
        assert (y2.source, y2.reserve is None) == ('real', ready)
        m.isolate('y2')
        m.pass_time(1)
        served = m.state('y2')
        assert (served.source == 'virtual') == ready  # it was true
        if ready:
            assert served.fault_set == ('y1', 'y2')
