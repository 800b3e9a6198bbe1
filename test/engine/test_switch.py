"""Who serves each channel, fault by fault."""

from dataclasses import replace

import pytest

from vsensor_ros.engine import CannotServe, Decision, Policy, Source, Switch
from vsensor_ros.observers import Design, Refusal
from vsensor_ros.reason import Reason

NAMES = ('a', 'b', 'c')
SECOND = 1_000_000_000


@pytest.fixture(scope='module')
def build(bench):
    """Make a design of the entries named '<fault set>/<channel>', '-' before those refused."""
    def serve(key, channel):
        healthy = tuple(s for s in NAMES if s not in key)
        v = bench.virtual_sensor([[-1.0]], [[1.0] * len(healthy)], fault_set=key, healthy=healthy)
        return replace(v, channel=channel)

    def build(text):
        entries = {}
        for word in text.split():
            key, channel = word.lstrip('-').split('/')
            key = tuple(key)
            entries[key, channel] = Refusal(channel, key, f'{channel} cannot be seen') \
                if word.startswith('-') else serve(key, channel)
        return Design('test', '0', ('x1',), (), NAMES, {}, None, entries)
    return build


ALL = 'a/a b/b c/c ab/a ab/b ac/a ac/c bc/b bc/c'


class Run:
    """A switch, a clock [s], the virtual sensors that are not ready, and how sure all are."""

    def __init__(self, design, **policies):
        self.switch, self.now, self.unready = Switch.of(design, policies), 0.0, {}
        self.close = ()  # to their limits
        self.deviations, self.converging = {}, ()  # of 1 those not named; by deviation, too
        self.switches = [0] * len(NAMES)  # how often each channel was given to another
        self._served = self._servers()

    def __getattr__(self, event):
        def happen(*arguments):
            if event == 'with_policies':
                self.switch = self.switch.with_policies(*arguments)
            else:
                self.switch = getattr(self.switch, event)(*arguments, round(self.now * SECOND))
            return self.decide()
        return happen

    def decide(self, after=0.0):
        self.now += after
        self.switch = self.switch.decide(round(self.now * SECOND), self)
        self._count()
        return self.shown

    def ready(self, key, s):
        return f'{"".join(key)}/{s}' not in {*self.unready, *self.converging}

    def converges(self, key, s):
        return f'{"".join(key)}/{s}' in self.converging

    def deviation(self, key, s):
        return self.deviations.get(f'{"".join(key)}/{s}', 1.0)

    def why_not(self, key, s):
        if self.converges(key, s):
            return Reason.of('converging', seconds=1.5)
        return (lack := self.unready.get(f'{"".join(key)}/{s}')) and Reason.of(
            'refused', text=lack)

    def why_not_again(self, key, s):
        return self.why_not(key, s) or (f'{"".join(key)}/{s}' in self.close or None) and \
            Reason.of('refused', text='close to its limit')

    @property
    def shown(self):
        """Who serves each channel: '' itself, 'ab' the virtual one for {a, b}, '!' nobody."""
        def show(d):
            return '!' if d.source is Source.NONE else ''.join(d.fault_set)
        return [show(self.switch.decisions[s]) for s in NAMES]

    def why(self, name):
        return str(self.switch.decisions[name].reason or '')

    def _servers(self):
        return [(self.switch.decisions[s].source, self.switch.decisions[s].fault_set)
                for s in NAMES]

    def _count(self):
        before, self._served = self._served, self._servers()
        self.switches = [n + (a != b) for n, a, b in zip(self.switches, before, self._served)]


def test_the_exact_set_serves_each_channel(build):
    run = Run(build(ALL))
    assert run.shown == ['', '', '']
    assert run.isolate('a') == ['a', '', ''] and run.why('a') == 'isolated'
    run.now = 3.0
    assert run.isolate('ab') == ['ab', 'ab', '']
    assert run.switch.decisions['b'] == Decision(Source.VIRTUAL, ('a', 'b'), Reason('isolated'))
    assert run.switches == [2, 1, 0]


@pytest.mark.parametrize('first', ['a', 'b', 'ab'])
@pytest.mark.parametrize('back', ['a', 'b', 'ab'])
def test_a_second_fault_and_recoveries_in_any_order(build, first, back):
    run = Run(build(ALL))
    run.isolate(first)
    run.decide(1.0)
    assert run.isolate('ab') == ['ab', 'ab', '']
    run.decide(1.0)
    rest = ''.join(sorted(set('ab') - set(back)))
    assert run.isolate(rest) == ['ab', 'ab', '']
    assert run.decide(1.9) == ['ab', 'ab', '']
    assert run.decide(0.1) == [s if s == rest else '' for s in NAMES]
    run.isolate('')
    assert run.decide(2.0) == ['', '', ''] and not run.switch.faulty


def test_a_superset_serves_until_the_exact_set_is_ready(build):
    run = Run(build('a/a abc/a ab/a ac/a'))
    run.unready = {'a/a': 'converging, 2.3 s more', 'ab/a': 'b silent for 1.0 s'}
    assert run.isolate('a') == ['ac', '', '']  # smallest that is ready
    assert run.why('a') == 'isolated; converging, 2.3 s more'
    del run.unready['ab/a']
    assert run.decide(0.1) == ['ac', '', '']  # as good as the one that serves
    run.unready = {}
    assert run.decide(0.1) == ['a', '', ''] and run.switches == [2, 0, 0]


def test_the_surest_serves(build):
    run = Run(build(ALL))
    run.deviations = {'a/a': 0.1, 'ab/a': 0.09, 'ac/a': 0.3}
    assert run.isolate('a') == ['a', '', '']  # the smaller one, unless another is a fifth better
    run = Run(build(ALL))
    run.deviations = {'a/a': 0.1, 'ab/a': 0.06, 'ac/a': 0.03}
    assert run.isolate('a') == ['ac', '', '']
    assert run.why('a') == 'isolated; the design for a is good to 0.1 only'


def test_who_is_ready_first_with_a_bad_estimate_waits_for_nobody_but_gives_way(build):
    run = Run(build('a/a ab/a'))
    run.unready, run.deviations = {'a/a': 'no start known'}, {'ab/a': 0.17}
    assert run.isolate('a') == ['ab', '', '']
    run.unready, run.converging = {}, ('a/a',)
    assert run.decide(0.1) == ['ab', '', '']  # 1: what is left of its start
    run.deviations['a/a'] = 0.16
    assert run.decide(0.01) == ['a', '', '']  # though it still converges
    assert run.why('a') == 'isolated; converging, 1.5 s more'
    run.unready = {'ab/a': 'c silent for 1.0 s'}
    assert run.decide(1.0) == ['a', '', '']
    run.converging = ()
    assert run.decide(1.0) == ['a', '', ''] and run.switches == [2, 0, 0]
    assert run.why('a') == 'isolated'


def test_nobody_that_still_converges_serves_where_nobody_is_ready_or_known(build):
    run = Run(build('a/a ab/a'))
    run.unready, run.converging = {'ab/a': 'c silent for 1.0 s'}, ('a/a',)
    assert run.isolate('a') == ['!', '', '']
    run.unready, run.deviations = {}, {'ab/a': float('inf')}
    assert run.decide(0.1) == ['ab', '', '']  # may be surer than it knows
    run.converging = ()
    assert run.decide(0.1) == ['a', '', '']


def test_deviations_that_come_and_go_do_not_whip_the_output(build):
    run = Run(build('a/a ab/a'))
    run.deviations = {'a/a': 0.1, 'ab/a': 0.11}
    run.isolate('a')
    for i in range(100):  # a reading that comes late now and then
        run.deviations['a/a'] = 0.3 if i % 4 == 0 else 0.1
        run.decide(0.1)
    assert run.shown == ['a', '', ''] and run.switches == [1, 0, 0]
    run.deviations['a/a'] = 0.3
    run.decide(0.01)
    assert run.decide(0.49) == ['a', '', ''] and run.decide(0.01) == ['ab', '', '']
    run.deviations['a/a'] = 0.109  # no worse, and reads more
    assert run.decide(0.01) == ['ab', '', ''] and run.decide(0.5) == ['a', '', '']
    run.deviations['ab/a'] = 0.08
    run.decide(0.01)
    run.now = 0.0
    assert run.decide() == ['a', '', '']  # a clock that was set back
    assert run.decide(0.5) == ['ab', '', '']


def test_a_temporary_one_that_served_its_time_does_not_come_back(build):
    design = build('a/a ab/a')
    design.entries[('a',), 'a'] = replace(design['a', 'a'], grade='temporary')
    run = Run(design)
    run.deviations = {'ab/a': 2.0}
    assert run.isolate('a') == ['a', '', '']
    run.unready = {'a/a': 'too uncertain'}
    assert run.decide(1.0) == ['ab', '', '']
    run.unready = {}
    assert run.decide(100.0) == ['ab', '', '']
    assert run.why('a') == 'isolated; it has served its time, until its channel is believed again'
    run.isolate('')
    assert run.decide(2.0) == ['', '', ''] and run.isolate('a') == ['a', '', '']


def test_a_force_waits_for_the_better_one_that_converges(build):
    run = Run(build('a/a ab/a'))
    run.converging, run.deviations = ('a/a',), {'ab/a': 0.17}
    assert run.force('a') == ['', '', '']  # the live one is better than either
    assert run.why('a').startswith('force waits: converging, 1.5 s more')
    run.converging = ()
    assert run.decide(1.5) == ['ab', '', '']  # by its deviation
    run.converging = ('a/a',)
    assert run.decide(1.5) == ['ab', '', ''] and run.switch.forced == {'a'}


def test_no_set_is_served_by_a_design_for_a_smaller_one(build):
    run = Run(build('a/a b/b -c/c'))
    assert run.isolate('ab') == ['!', '!', '']
    assert run.why('a') == 'no design for the loss of a, b'
    assert run.isolate('c')[2] == '!'
    assert run.why('c') == ('no design for the loss of '
                            'a (healthy again, believed after 2 s without a fault), '
                            'b (healthy again, believed after 2 s without a fault), c')
    assert run.decide(2.0) == ['', '', '!'] and run.why('c') == 'c cannot be seen'


def test_the_reason_names_what_the_next_best_lacks_and_is_kept_up_to_date(build):
    run = Run(build('-a/a ab/a'))
    run.unready = {'ab/a': 'converging, 2.0 s more'}
    run.isolate('a')
    assert run.why('a') == 'a cannot be seen; that for a, b: converging, 2.0 s more'
    run.unready = {'ab/a': 'converging, 1.0 s more'}
    before = run.switch
    run.decide(0.9)
    assert run.switch is before  # no churn
    run.decide(0.1)
    assert run.why('a').endswith('1.0 s more') and run.switches == [1, 0, 0]


def test_none_until_ready_and_again_when_readiness_is_lost(build):
    run = Run(build('a/a'))
    run.unready = dict.fromkeys(['a/a', 'ab/a'], 'c silent for 1.0 s')
    assert run.isolate('a') == ['!', '', '']
    run.unready = {}
    assert run.decide(1.0) == ['a', '', '']
    run.unready = dict.fromkeys(['a/a', 'ab/a'], 'c silent for 1.0 s')
    assert run.decide(1.0) == ['!', '', '']
    run.unready = {}
    assert run.decide(1.0) == ['!', '', ''] and run.why('a').startswith(
        'ready again for 0.0 s, serves after 2.0 s')
    assert run.decide(1.9) == ['!', '', '']
    assert run.decide(0.1) == ['a', '', ''] and run.switches == [4, 0, 0]


@pytest.mark.parametrize('dwell', [0.0, 0.3])
def test_who_is_good_enough_by_turns_does_not_whip_the_output(build, dwell):
    run = Run(build('a/a'), a=Policy(dwell=dwell))
    run.isolate('a')
    for _ in range(50):
        run.unready = {'a/a': 'too uncertain'}
        run.decide(0.2)
        run.unready = {}
        run.decide(0.2)
    assert run.shown == ['!', '', ''] and run.switches == [2, 0, 0]
    run.close = ('a/a',)
    assert run.decide(60.0) == ['!', '', ''] and run.why('a') == 'close to its limit'
    run.close = ()
    assert run.decide(1.0) == ['!', '', '']
    assert run.why('a') == 'ready again for 0.0 s, serves after 0.5 s'
    assert run.decide(0.5) == ['a', '', ''] and run.switches == [3, 0, 0]


def test_who_never_served_in_this_fault_serves_at_once(build):
    run = Run(build('a/a ab/a'))
    run.isolate('a')
    run.unready = dict.fromkeys(['a/a', 'ab/a'], 'c silent for 1.0 s')
    assert run.decide(1.0) == ['!', '', '']
    run.unready = {'a/a': 'c silent for 1.0 s'}
    assert run.decide(0.1) == ['ab', '', '']
    run.unready = {}
    run.isolate('')
    assert run.decide(2.0) == ['', '', '']
    assert run.isolate('a') == ['a', '', '']  # another fault


def test_readiness_that_flickers_when_nobody_else_could_serve(build):
    run = Run(build('a/a'))
    run.isolate('a')
    for i in range(240):  # 2 Hz
        run.unready = {'a/a': 'too uncertain'} if i % 2 == 0 else {}
        run.decide(0.25)
    assert run.shown == ['!', '', ''] and run.switches == [2, 0, 0]
    assert run.decide(2.0) == ['a', '', ''] and run.switches == [3, 0, 0]


def test_readiness_that_flickers_does_not_whip_the_output(build):
    run = Run(build('a/a ab/a'))
    run.isolate('a')
    for i in range(60):  # 0.3 s with, 0.3 s without
        run.unready = {'a/a': 'too uncertain'} if i % 2 == 0 else {}
        run.decide(0.3)
    assert run.shown == ['ab', '', ''] and run.switches == [2, 0, 0]
    run.decide(1.9)
    assert run.shown == ['ab', '', '']
    run.decide(0.2)
    assert run.shown == ['a', '', ''] and run.switches == [3, 0, 0]


@pytest.mark.parametrize('period', [1.0, 0.01, 0.0])  # of the fault; the switch looks each 0.1 s
def test_a_fault_that_toggles_makes_one_switch(build, period):
    run = Run(build(ALL))
    for _ in range(40):
        run.switch = run.switch.isolate('a', round(run.now * SECOND))
        run.now += period / 2
        run.switch = run.switch.isolate('', round(run.now * SECOND))
        run.now += period / 2
        run.decide(0.1)
        assert run.shown == ['a', '', ''] and run.switches == [1, 0, 0]
    run.decide(1.8 - period / 2)
    assert run.shown == ['a', '', '']
    assert run.decide(0.2) == ['', '', ''] and run.switches == [2, 0, 0]


def test_a_fault_of_no_length_is_nothing_without_a_dwell(build):
    run = Run(build(ALL), a=Policy(dwell=0.0))
    run.switch = run.switch.isolate('a', 0)
    assert run.isolate('') == ['', '', ''] and run.switches == [0, 0, 0]


def test_hold_waits_for_clear(build):
    run = Run(build(ALL), a=Policy('hold'))
    run.isolate('a')
    with pytest.raises(ValueError, match='^a: isolation still reports it faulty; repair it'):
        run.clear('a')
    run.isolate('')
    assert run.decide(1e4) == ['a', '', '']
    assert run.why('a') == 'healthy again, held until cleared'
    assert run.clear('a') == ['', '', '']
    before = run.switch
    assert run.clear('a') == ['', '', ''] and run.switch is before


def test_latched_waits_for_reset(build):
    run = Run(build(ALL), a=Policy('latched'), b=Policy('hold'))
    run.isolate('ab')
    run.isolate('')
    run.decide(1e4)
    with pytest.raises(ValueError, match='^a: is latched; reset'):
        run.clear('a')
    assert run.shown == ['ab', 'ab', ''] and run.why('a') == 'latched until reset'
    assert run.reset() == ['', '', '']
    run.isolate('a')
    assert run.reset() == ['a', '', '']  # what isolation says stays


def test_policies_may_change_while_a_sensor_waits(build):
    run = Run(build(ALL), a=Policy('latched'))
    run.isolate('a')
    run.isolate('')
    run.decide(5.0)
    assert run.with_policies({'a': Policy(dwell=6.0)}) == ['a', '', '']
    assert run.with_policies({'a': Policy(dwell=5.0)}) == ['', '', '']
    with pytest.raises(KeyError, match='z: no such sensor'):
        run.with_policies({'z': Policy()})


def test_silence_counts_where_the_policy_says_so(build):
    run = Run(build(ALL), a=Policy(silent_is_faulty=True))
    assert run.silence('ab') == ['a', '', ''] and run.why('a') == 'silent'
    run.now = 1.0
    with pytest.raises(ValueError, match='^a: is still silent'):
        run.clear('a')
    assert run.silence('b') == ['a', '', '']
    assert run.decide(1.9) == ['a', '', ''] and run.decide(0.1) == ['', '', '']
    loud = Policy(silent_is_faulty=True)
    assert run.with_policies({'b': loud}) == ['', 'b', '']
    assert run.with_policies({}) == ['', '', '']  # the sensor itself is silent, and said to be


def test_silent_and_reported_is_faulty_until_both_have_passed(build):
    run = Run(build(ALL), a=Policy(silent_is_faulty=True))
    run.isolate('a')
    run.silence('a')
    run.isolate('')
    assert run.decide(5.0) == ['a', '', '']
    run.silence('')
    assert run.decide(1.9) == ['a', '', ''] and run.decide(0.1) == ['', '', '']


def test_force_and_release(build):
    run = Run(build(ALL), a=Policy('latched'))
    assert run.force('a') == ['a', '', ''] and run.why('a') == 'forced'
    assert run.switch.faulty == {'a'} == run.switch.forced and not run.switch.reported
    with pytest.raises(ValueError, match='^a: is forced; release it'):
        run.clear('a')
    assert run.isolate('b') == ['ab', 'ab', '']  # a test of both
    assert run.release('a') == ['', 'b', '']  # it never failed: no latch
    run.force('a')
    run.isolate('ab')
    assert run.release('a') == ['ab', 'ab', '']  # it did


def test_a_force_that_no_virtual_sensor_could_serve_is_refused(build):
    run = Run(build('a/a b/b ac/a'))
    with pytest.raises(ValueError, match='^c: cannot be forced; no virtual sensor is designed '
                       'that could speak for c without c$'):
        run.force('c')
    run.isolate('b')
    with pytest.raises(ValueError, match='could speak for a without a, b$'):
        run.force('a')
    run.isolate('c')
    with pytest.raises(ValueError, match='could speak for a without a, b, c$'):
        run.force('a')  # b is not believed yet
    run.decide(3.0)
    assert run.force('a') == ['ac', '', '!']  # c has none either way


def test_a_force_that_would_wait_for_ever_is_refused(build):
    run, forever = Run(build('a/a ab/a b/b c/c ac/a ac/c')), Reason('no limit')

    def force(*never):
        run.switch.force('a', 0, lambda key, s:
                         forever if f'{"".join(key)}/{s}' in never else None)
    run.unready = {'a/a': 'converging'}
    force('a/a', 'ac/a')  # ab/a may serve yet
    with pytest.raises(CannotServe, match='^a: cannot be forced; nobody could speak for a without '
                       'a: it would serve for a time only, and no limit says for how long$') as e:
        force('a/a', 'ab/a', 'ac/a')
    assert (e.value.channel, e.value.reason) == ('a', forever)
    run.isolate('c')
    with pytest.raises(CannotServe, match='nobody could speak for c without a, c: '):
        force('ac/c')
    force('c/c', 'ac/c')  # c has none either way


def test_a_force_that_would_take_the_virtual_sensor_of_another_is_refused(build):
    run = Run(build('a/a b/b ab/a'))
    run.isolate('b')
    with pytest.raises(ValueError, match='could speak for b without a, b$'):
        run.force('a')
    assert run.decide() == ['', 'b', '']


def test_a_force_waits_until_a_virtual_sensor_is_ready(build):
    run = Run(build('a/a'))
    run.unready = {'a/a': 'converging, 2.3 s more'}
    assert run.force('a') == ['', '', ''] and not run.switch.faulty
    assert run.why('a') == 'force waits: converging, 2.3 s more'
    run.unready = {}
    assert run.decide(0.01) == ['a', '', '']
    run.unready = {'a/a': 'c silent for 0.6 s'}
    assert run.decide(1.0) == ['', '', '']
    assert run.why('a') == 'force ended: c silent for 0.6 s' and not run.switch.forced
    run.unready = {}
    assert run.decide(1.0) == ['', '', ''] and run.switches == [2, 0, 0]
    assert run.why('a').startswith('force ended')
    assert run.reset() == ['', '', ''] and run.why('a') == ''


def test_a_force_that_waits_does_not_end_one_that_serves(build):
    run = Run(build('a/a c/c ac/a ac/c'))
    run.unready = dict.fromkeys(['a/a', 'ac/a', 'ac/c'], 'converging')
    assert run.force('c') == run.force('a') == ['', '', 'c']
    del run.unready['a/a']
    assert run.decide() == ['', '', 'c'] and run.why('a') == 'force waits: converging'
    run.unready = {}
    assert run.decide() == ['ac', '', 'ac']


def test_a_force_that_waited_in_vain_leaves_no_note(build):
    run = Run(build('a/a'))
    run.unready = {'a/a': 'converging'}
    run.force('a')
    assert run.release('a') == ['', '', ''] and run.why('a') == ''


def test_a_force_ends_when_a_fault_needs_the_sensor(build):
    run = Run(build('a/a b/b ab/a ab/b'))
    run.unready = {'ab/b': 'converging, 1.0 s more'}
    run.force('a')
    assert run.isolate('b') == ['', 'b', '']
    assert run.why('a') == 'force ended: b: converging, 1.0 s more'
    run = Run(build('a/a b/b'))
    run.force('a')
    assert run.isolate('b') == ['', 'b', '']
    assert run.why('a') == 'force ended: no design for the loss of a (forced), b'


def test_a_clock_set_back_delays_a_recovery_by_the_dwell_at_most(build):
    run = Run(build(ALL))
    run.now = 1000.0
    run.isolate('a')
    run.isolate('')
    run.now = 500.0
    assert run.decide() == ['a', '', '']
    assert run.decide(1.9) == ['a', '', ''] and run.decide(0.1) == ['', '', '']
    run = Run(build(ALL))
    run.switch = run.switch.isolate('a', 1000 * SECOND).isolate('', 1000 * SECOND)
    run.now = 10.0  # before anyone looked
    assert run.decide() == ['a', '', ''] and run.decide(2.0) == ['', '', '']


def test_wanted_functionals_are_no_sensors(build):
    design = build(ALL)
    design.entries[('a',), 'v'] = replace(design['a', 'a'], channel='v')
    run = Run(replace(design, wanted=('v',)))
    assert run.isolate('a') == ['a', '', ''] and set(run.switch.decisions) == set(NAMES)
    with pytest.raises(KeyError, match='v: no such sensor'):
        run.force('v')


def test_nothing_new_is_the_same_switch(build):
    run = Run(build(f'{ALL} abc/a abc/b abc/c'), c=Policy(silent_is_faulty=True))
    for event in ((), ('isolate', 'a'), ('silence', 'c'), ('force', 'b')):
        if event:
            getattr(run, event[0])(event[1])
            assert getattr(run.switch, event[0])(event[1], 99) is run.switch
        before = run.switch
        run.decide()
        assert run.switch is before
    assert run.switch.release('a', 99) is run.switch
    quiet = Switch.of(run.switch.design, {})
    assert quiet.clear('a', 1) is quiet.reset(1) is quiet.with_policies({}) is quiet


@pytest.mark.parametrize('event', ['isolate', 'silence', 'force', 'release', 'clear'])
def test_an_unknown_name_is_not_taken(build, event):
    with pytest.raises(KeyError, match='z: no such sensor'):
        getattr(Switch.of(build(ALL), {}), event)('z', 0)
    with pytest.raises(KeyError, match='z: no such sensor'):
        Switch.of(build(ALL), {'z': Policy()})


@pytest.mark.parametrize('wrong', [
    {'recovery': 'never'}, {'dwell': -1.0}, {'dwell': float('nan')}, {'dwell': float('inf')}])
def test_a_policy_that_is_none_is_refused(wrong):
    with pytest.raises(ValueError, match=f'^{next(iter(wrong))}: .*{next(iter(wrong.values()))}'):
        Policy(**wrong)
