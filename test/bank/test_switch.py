"""Who serves each channel, whatever is reported in whatever order."""

from hypothesis import given, strategies as st
import pytest

from vsensor_ros.bank import Decision, Source, Switch
from vsensor_ros.virtual_sensor import Design, Refusal, VirtualSensor

NAMES = ('a', 'b', 'c')


@pytest.fixture(scope='module')
def switch(bench):
    # {a}: served; {b}: refused; {a, b}: a served, b refused; {c} and the rest: not designed
    def serve(channel, fault_set):
        healthy = tuple(s for s in NAMES if s not in fault_set)
        v = bench.virtual_sensor([[-1.0]], [[1.0] * len(healthy)], fault_set=fault_set,
                                 healthy=healthy)
        return VirtualSensor(**{**vars(v), 'channel': channel})
    entries = {(('a',), 'a'): serve('a', ('a',)),
               (('b',), 'b'): Refusal('b', ('b',), 'b cannot be seen'),
               (('a', 'b'), 'a'): serve('a', ('a', 'b')),
               (('a', 'b'), 'b'): Refusal('b', ('a', 'b'), 'b cannot be seen')}
    return Switch.of(Design('test', '0', ('x1',), (), NAMES, {}, None, entries))


def expected(design, faulty, channel):
    if channel not in faulty:
        return Decision(Source.REAL)
    fault_set = tuple(s for s in NAMES if s in faulty)
    entry = design.entries.get((fault_set, channel))
    if entry is None:
        return Decision(Source.NONE, (), 'no design for the faulty sensors '
                        + ', '.join(fault_set))
    if isinstance(entry, Refusal):
        return Decision(Source.NONE, (), entry.reason)
    return Decision(Source.VIRTUAL, fault_set)


EVENTS = st.lists(st.one_of(st.tuples(st.sampled_from(NAMES), st.booleans()),
                            st.frozensets(st.sampled_from(NAMES))), max_size=30)


@given(events=EVENTS)
def test_decisions_follow_the_exact_set_and_changes_are_counted(switch, events):
    faulty = set()
    switches, since = dict.fromkeys(NAMES, 0), dict.fromkeys(NAMES)
    old = {s: Decision(Source.REAL) for s in NAMES}
    for time, event in enumerate(events):
        before, picture = switch, (switch.faulty, dict(switch.decisions), dict(switch.switches))
        if isinstance(event, frozenset):
            switch, faulty = switch.isolate(event, time), set(event)
        else:
            name, is_faulty = event
            switch = switch.report(name, is_faulty, time)
            (faulty.add if is_faulty else faulty.discard)(name)
        assert (before.faulty, dict(before.decisions), dict(before.switches)) == picture
        new = {s: expected(switch.design, faulty, s) for s in NAMES}
        for s in NAMES:
            if new[s] != old[s]:
                switches[s] += 1
                since[s] = time
        old = new
        assert switch.faulty == faulty
        assert dict(switch.decisions) == new
        assert dict(switch.switches) == switches
        assert dict(switch.since) == since


def test_no_set_is_served_by_a_design_for_another(switch):
    assert switch.isolate(('a',), 0).decisions['a'] == Decision(Source.VIRTUAL, ('a',))
    both = switch.isolate(('b', 'a'), 0)
    assert both.decisions['a'] == Decision(Source.VIRTUAL, ('a', 'b'))
    assert both.decisions['b'] == Decision(Source.NONE, (), 'b cannot be seen')
    for faulty in (('c',), ('a', 'c'), ('a', 'b', 'c')):
        for name in faulty:
            decision = switch.isolate(faulty, 0).decisions[name]
            assert decision.source is Source.NONE
            assert ', '.join(faulty) in decision.reason


def test_an_unknown_name_is_not_taken(switch):
    for attempt in (lambda: switch.report('z', True, 0), lambda: switch.isolate(('a', 'z'), 0)):
        with pytest.raises(KeyError, match='z: no such sensor'):
            attempt()


def test_saying_it_again_changes_nothing(switch):
    first = switch.report('a', True, 5)
    assert first.report('a', True, 9) is first
    assert first.isolate(('a',), 9) is first
    assert first.since['a'] == 5
