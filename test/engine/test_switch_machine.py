"""The switch under random events, against a simple account of who is faulty."""

from dataclasses import fields, replace
from itertools import chain, combinations

from hypothesis import settings, strategies as st
from hypothesis.stateful import initialize, rule, RuleBasedStateMachine, run_state_machine_as_test
import pytest

from vsensor_ros.engine import Policy, Source, Switch
from vsensor_ros.observers import Design, Refusal
from vsensor_ros.reason import Reason

NAMES = ('a', 'b', 'c', 'd')
SECOND = 1_000_000_000
SETS = tuple(chain.from_iterable(combinations(NAMES, n) for n in range(1, 5)))
KEYS = tuple((key, s) for key in SETS for s in key)
SOME = st.frozensets(st.sampled_from(NAMES), max_size=3)
POLICY = st.builds(Policy, st.sampled_from(['automatic'] * 3 + ['hold', 'latched']),
                   st.sampled_from([0.0, 0.5, 2.0]), st.booleans())
POLICIES = st.fixed_dictionaries(dict.fromkeys(NAMES, POLICY))
SEEN = st.sampled_from([True, True, False])  # by a decision, at once
STEPS = st.sampled_from([0.0, 0.001, 0.4, 1.0, 1.6, 2.0, 5.0])


class Account:
    """What happened to one sensor, in order: (what, when); 'bad', 'well' or 'pardon'."""

    def __init__(self):
        self.log = [('pardon', 0)]
        self.was_bad = False

    def note(self, bad, now):
        if bad != self.was_bad:
            self.log.append(('bad' if bad else 'well', now))
        self.was_bad = bad

    def faulty(self, policy, now):
        """Tell whether it is not to be believed; once believed, it is until the next fault."""
        self.log = [(what, min(when, now)) for what, when in self.log]  # a clock set back
        what, when = self.log[-1]
        if what == 'well' and policy.recovery == 'automatic' and \
                now - when >= round(policy.dwell * SECOND):
            self.log.append(('pardon', now))
        return self.log[-1][0] != 'pardon'


class Machine(RuleBasedStateMachine):
    """Events at random times, looked at after each decision."""

    def __init__(self, serve):
        super().__init__()
        self.serve = serve

    @initialize(missing=st.frozensets(st.sampled_from(KEYS), max_size=24),
                refused=st.frozensets(st.sampled_from(KEYS), max_size=8), policies=POLICIES)
    def begin(self, missing, refused, policies):
        self.there = {*KEYS} - missing - refused
        entries = {key: self.serve(*key) if key in self.there else
                   Refusal(key[1], key[0], 'cannot be seen') for key in KEYS if key not in missing}
        self.design = Design('test', '0', ('x1',), (), NAMES, {}, None, entries)
        self.able = set(self.there)
        self.starting = set()  # of those that are not ready
        self.close = set()  # to their limits
        self.deviations = dict.fromkeys(self.there, 1.0)
        self.policies, self.now = policies, 1000 * SECOND
        self.switch = Switch.of(self.design, policies)
        self.accounts = {s: Account() for s in NAMES}
        self.reported = self.silent = frozenset()
        self.gone = {}  # who was given up in this fault, and since when it is good again
        self.better = {}  # by channel: who is ready beside who serves, and since when better

    # ------------------------------------------------------------------------------ events

    def happen(self, event, *arguments):
        """Let an event happen, twice: the second time nothing changes, nor does the old one."""
        before, old = self.switch, {f.name: _copy(getattr(self.switch, f.name))
                                    for f in fields(self.switch)}
        self.switch = getattr(before, event)(*arguments)
        assert getattr(self.switch, event)(*arguments) is self.switch
        assert {name: getattr(before, name) for name in old} == old

    def bad(self):
        for s, account in self.accounts.items():
            account.note(s in self.reported
                         or (s in self.silent and self.policies[s].silent_is_faulty), self.now)

    @rule(names=SOME, seen=SEEN)
    def isolate(self, names, seen):
        self.reported = names
        self.bad()
        self.happen('isolate', names, self.now)
        self.decide(seen)

    @rule(first=st.sampled_from(NAMES), second=st.sampled_from(NAMES))
    def isolate_two_more(self, first, second):
        self.reported |= {first, second}
        self.bad()
        ways = [self.switch.isolate(self.switch.reported | {s}, self.now)
                .isolate(self.reported, self.now) for s in (first, second)]
        ways = [self.look(w) for w in (*ways, self.switch.isolate(self.reported, self.now))]
        assert all(w.decisions == ways[0].decisions and w.faulty == ways[0].faulty
                   for w in ways)
        self.happen('isolate', self.reported, self.now)
        self.decide()

    @rule(names=SOME, seen=SEEN)
    def silence(self, names, seen):
        self.silent = names
        self.bad()
        self.happen('silence', names, self.now)
        self.decide(seen)

    @rule(name=st.sampled_from(NAMES), seen=SEEN)
    def force(self, name, seen):
        try:
            self.happen('force', name, self.now)
        except ValueError as error:
            assert str(error).startswith(f'{name}: cannot be forced')
            assert '\n' not in str(error) and name not in self.switch.forced
        self.decide(seen)

    @rule(name=st.sampled_from(NAMES), seen=SEEN)
    def release(self, name, seen):
        self.happen('release', name, self.now)
        self.decide(seen)

    @rule(name=st.sampled_from(NAMES), seen=SEEN)
    def clear(self, name, seen):
        account = self.accounts[name]
        waits = account.log[-1][0] == 'well'
        refused = account.was_bad or name in self.switch.forced or (
            waits and self.policies[name].recovery == 'latched')
        try:
            self.happen('clear', name, self.now)
            assert not refused
        except ValueError as error:
            assert refused and str(error).startswith(f'{name}: ') and '\n' not in str(error)
        if waits and not refused:
            account.log.append(('pardon', self.now))
        self.decide(seen)

    @rule(seen=SEEN)
    def reset(self, seen):
        self.happen('reset', self.now)
        self.gone, self.better = {}, {}
        for account in self.accounts.values():
            if account.log[-1][0] == 'well':
                account.log.append(('pardon', self.now))
        self.decide(seen)

    @rule(policies=POLICIES, seen=SEEN)
    def change_policies(self, policies, seen):
        self.policies = policies
        before = {s: a.was_bad for s, a in self.accounts.items()}
        self.bad()
        for s, account in self.accounts.items():
            if before[s] and not account.was_bad:  # its silence does not count any more
                account.log.append(('pardon', self.now))
        self.happen('with_policies', policies)
        self.decide(seen)

    @rule(keys=st.one_of(st.just(KEYS), st.lists(st.sampled_from(KEYS), min_size=4, max_size=16)),
          ready=st.sampled_from([False, False, True]), seen=SEEN)
    def change_readiness(self, keys, ready, seen):
        self.able = self.able | self.there & {*keys} if ready else self.able - {*keys}
        self.decide(seen)

    @rule(keys=st.lists(st.sampled_from(KEYS), max_size=16), seen=SEEN)
    def change_who_knows_how_it_starts(self, keys, seen):
        self.starting = self.there & {*keys}
        self.decide(seen)

    @rule(keys=st.one_of(st.just(()), st.lists(st.sampled_from(KEYS), max_size=16)), seen=SEEN)
    def change_who_is_close_to_its_limit(self, keys, seen):
        self.close = {*keys}
        self.decide(seen)

    @rule(keys=st.one_of(st.just(KEYS), st.lists(st.sampled_from(KEYS), min_size=1, max_size=16)),
          deviation=st.sampled_from([0.5, 0.7, 0.79, 0.81, 1.0, 1.3, float('inf')]), seen=SEEN)
    def change_deviations(self, keys, deviation, seen):
        self.deviations.update(dict.fromkeys(self.there & {*keys}, deviation))
        self.decide(seen)

    # ----------------------------------------------------------------------------- decisions

    def ready(self, key, s):
        return (key, s) in self.able

    def converges(self, key, s):
        return (key, s) in self.starting - self.able and self.deviations[key, s] < float('inf')

    def deviation(self, key, s):
        return self.deviations[key, s]

    def why_not(self, key, s):
        if (key, s) in self.able:
            return None
        return Reason.of('converging', seconds=1.0) if (key, s) in self.starting else \
            Reason.of('refused', text='not now')

    def why_not_again(self, key, s):
        return self.why_not(key, s) or (
            Reason.of('refused', text='not quite') if (key, s) in self.close else None)

    def look(self, switch):
        return switch.decide(self.now, self)

    @rule(step=STEPS, seen=SEEN)
    def pass_time(self, step, seen):
        self.now += round(step * SECOND)
        self.decide(seen)

    @rule(back=st.sampled_from([0.2, 3.0, 500.0]))
    def set_clock_back(self, back):
        self.now = max(0, self.now - round(back * SECOND))
        self.decide()

    def decide(self, seen=True):
        if not seen:
            return
        old = self.switch
        self.give_up(old)
        self.switch = new = self.look(old)
        self.gone = {(key, s): since for (key, s), since in self.gone.items()
                     if s in new.faulty}
        assert self.look(new) is new
        core = {s for s in NAMES if self.accounts[s].faulty(self.policies[s], self.now)}
        assert core <= new.faulty <= core | old.forced
        assert new.forced <= old.forced
        assert not new.recovering.keys() & new.failed
        for s in NAMES:
            self.check(s, old, new, core)
            self.check_reserve(s, new)
        self.check_forces(old, new, core)
        self.gone = {key: since for key, since in self.gone.items() if self.waits(*key)}
        self.better = {s: self.compare(s, new.decisions[s].fault_set, new.faulty)
                       for s in new.faulty if new.decisions[s].fault_set}

    def compare(self, s, present, faulty):
        """Note who else is ready, and since when it would be the better one."""
        before = {key: since and min(since, self.now)
                  for key, since in self.better.get(s, {}).items()}
        return {key: (before.get(key) or self.now) if self.beats(key, present, s) else None
                for key in self.may(faulty, s) - {present}}

    def beats(self, key, present, s):
        own, other = self.deviations[key, s], self.deviations[present, s]
        return own < 0.8 * other or (own <= other and len(key) < len(present))

    def give_up(self, old):
        for (key, s), since in self.gone.items():
            self.gone[key, s] = None if self.why_not_again(key, s) else \
                self.now if since is None else min(since, self.now)
        for s, d in old.decisions.items():
            if d.fault_set and old.faulty <= {*d.fault_set} and \
                    not (self.ready(d.fault_set, s) or self.converges(d.fault_set, s)):
                self.gone[d.fault_set, s] = None

    def waits(self, key, s):
        """Tell whether it was given up and has not been good for the dwell since."""
        since = self.gone.get((key, s))
        dwell = max(round(self.policies[s].dwell * SECOND), SECOND // 2)
        return (key, s) in self.gone and (since is None or self.now - since < dwell)

    def check(self, s, old, new, core):
        d, before = new.decisions[s], old.decisions[s]
        assert '\n' not in str(d.reason)
        may = self.may(new.faulty, s)
        stays = set(before.fault_set) >= new.faulty and not self.waits(before.fault_set, s) and (
            self.ready(before.fault_set, s) or self.converges(before.fault_set, s))
        if s not in new.faulty:
            assert (d.source, d.fault_set) == (Source.REAL, ())
        elif d.source is Source.VIRTUAL:
            assert (may or stays) and new.faulty <= {*d.fault_set} and d.reason
            assert not self.waits(d.fault_set, s)
        else:
            assert d.source is Source.NONE and d.fault_set == () and d.reason
            assert not may and not stays
            return
        if s in new.faulty:
            self.check_choice(s, before.fault_set if stays else None, d.fault_set, may)

    def check_choice(self, s, present, chosen, may):
        """Compare who serves with the others that may; present: who does, if it may go on."""
        if chosen not in may and chosen != present:
            assert self.converges(chosen, s) and any(
                self.beats(chosen, key, s) for key in may | {present} - {None})
        if present is None:  # anew: the best, or as good as that
            assert all(0.8 * self.deviations[chosen, s] <= self.deviations[key, s] for key in may)
        elif chosen != present:
            assert self.beats(chosen, present, s)
            if chosen in self.better.get(s, {}) and chosen in may:
                since = self.better[s][chosen]
                assert since is not None and self.now - since >= SECOND // 2
        else:
            for key in may - {present}:
                if self.beats(key, present, s):  # only just
                    assert key in self.better[s]
                    assert self.better[s][key] is None or \
                        self.now - self.better[s][key] < SECOND // 2

    def check_reserve(self, s, switch):
        """Compare what is told beforehand with what would happen."""
        failing = replace(switch.isolate(switch.reported | {s}, self.now), told=None)
        would = self.look(failing).decisions[s]
        told = switch.reserve(s, self.now, self)
        assert (told.source, told.fault_set) == (would.source, would.fault_set)
        assert told.source is Source.VIRTUAL or str(told.reason) == str(would.reason)

    def check_forces(self, old, new, core):
        for s in NAMES:
            if s not in core and s in new.faulty:  # honoured
                assert s in new.forced and new.decisions[s].source is Source.VIRTUAL
            elif s not in core and s in old.forced:  # waits, or ended if it served
                assert (s in new.forced) != (old.decisions[s].source is Source.VIRTUAL)
                assert str(new.decisions[s].reason).startswith('force ')
                everyone = new.faulty | {s}
                assert any(not self.may(everyone, c) for c in everyone) or any(
                    key in self.starting - self.able and everyone <= {*key[0]} and key[1] == s
                    for key in self.there)
        for s in core:  # nobody lost its virtual sensor to a force
            if new.decisions[s].source is Source.NONE:
                assert self.may(core, s, self.there) == self.may(new.faulty, s, self.there)

    def may(self, faulty, s, among=None):
        return {key for key, c in (self.able if among is None else among)
                if c == s and set(key) >= set(faulty)
                and (among is not None or not self.waits(key, s))}


def _copy(value):
    return dict(value) if isinstance(value, dict) else value


@pytest.fixture
def serve(bench):
    made = {}

    def serve(key, channel):
        if (key, channel) not in made:
            healthy = tuple(s for s in NAMES if s not in key)
            v = bench.virtual_sensor([[-1.0]], [[1.0] * len(healthy)], fault_set=key,
                                     healthy=healthy)
            made[key, channel] = replace(v, channel=channel)
        return made[key, channel]
    return serve


def test_any_events_at_any_times(serve):
    run_state_machine_as_test(lambda: Machine(serve), settings=settings(
        max_examples=50, stateful_step_count=40))


def test_of_who_was_given_up_only_what_it_is_without_interruption_counts(serve):
    """A shorter dwell does not make up for it: found by drawing at random."""
    machine, only = Machine(serve), [(('a',), 'a')]
    machine.begin({*KEYS} - {*only}, frozenset(), dict.fromkeys(NAMES, Policy(dwell=2.0)))
    machine.isolate(frozenset('a'), True)
    machine.change_readiness(only, False, True)
    machine.change_readiness(only, True, True)
    machine.pass_time(0.4, True)  # what is told of the reserve is of now, too
    machine.pass_time(0.6, True)
    machine.change_readiness(only, False, True)
    machine.change_policies(dict.fromkeys(NAMES, Policy(dwell=0.5)), True)
    machine.change_readiness(only, True, True)
    assert machine.switch.decisions['a'].source is Source.NONE
    machine.pass_time(0.6, True)
    assert machine.switch.decisions['a'].source is Source.VIRTUAL


def test_the_account_of_the_machine_is_right():
    account, policy = Account(), Policy(dwell=2.0)
    assert not account.faulty(policy, 0)
    account.note(True, 1 * SECOND)
    account.note(False, 2 * SECOND)
    assert account.faulty(policy, 4 * SECOND - 1) and not account.faulty(policy, 4 * SECOND)
