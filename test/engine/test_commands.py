"""From when a command counts: its stamp, or its arrival where the stamp cannot be true."""

from hypothesis import given, strategies as st
import pytest

from vsensor_ros.bank import Bank, End
from vsensor_ros.engine.clock import Clock
from vsensor_ros.engine.commands import BEHIND, Commands, NEAR
from vsensor_ros.engine.intake import Intake
from vsensor_ros.reason import Reason

MS = 1_000_000
NOW = 10**18
SECOND = 10**9


class Rig:
    """A bank with one command, and what takes it."""

    def __init__(self, bench, simulated=False):
        v = bench.virtual_sensor([[-3.0]], [[0.0]], B=[[3.0]], inputs=('u',))
        self.clock = Clock(10 * SECOND, simulated)
        self.clock.look(NOW)
        self.bank = Bank(bench.design(v, inputs=('u',)), 100,
                         command_ends={'u': End(0.5, only_periodic=True)})
        self.intake = Intake(self.bank, self.clock)
        self.commands = Commands(('u',), self.bank, self.clock, self.intake)

    def take(self, lead, arrival=0, value=1.0):
        """Take a command that comes so long [ns] after NOW, stamped so much ahead of that."""
        self.clock.look(NOW + arrival)
        stamp = None if lead is None else NOW + arrival + lead
        self.commands.take('u', value, stamp, NOW + arrival)

    @property
    def times(self):
        """From when commands count, after NOW."""
        return [stamp - NOW for stamp in self.bank._told.samples['u'].stamps]

    @property
    def state(self):
        state, = self.commands.states({})
        return state

    def warnings(self):
        return [str(remark.what) for remark in self.intake.remarks()]


@pytest.fixture
def make_rig(bench):
    return lambda **more: Rig(bench, **more)


@pytest.mark.parametrize(('lead', 'counts'), [
    (None, 0), (0, 0), (-3 * MS, -3 * MS), (-NEAR, -NEAR), (-NEAR - 1, 0),
    (-BEHIND, 0), (-BEHIND - 1, 0), (2 * MS, 0), (NEAR, 0), (NEAR + 1, 0), (300 * MS, 0),
    (-5 * SECOND, 0), (1234 * SECOND - NOW, 0), (10**6 * SECOND, 0)])
def test_a_stamp_counts_where_it_can_be_true(make_rig, lead, counts):
    r = make_rig()
    r.take(lead)
    assert r.times == [counts]
    foreign = lead is not None and not -BEHIND <= lead <= NEAR
    assert (r.state.trouble is not None) == foreign == bool(r.warnings())
    assert r.state.from_arrival == foreign


def test_in_simulated_time_a_stamp_may_be_ahead_by_a_step(make_rig):
    r = make_rig(simulated=True)
    r.take(5 * MS)
    assert r.times == [5 * MS]
    r.take(300 * MS, 10 * MS)
    assert r.times == [5 * MS, 10 * MS]
    r.take(-800 * MS, 900 * MS)  # it runs fast
    assert r.times == [5 * MS, 10 * MS, 100 * MS] and r.state.trouble is None


def test_before_simulated_time_has_begun_a_stamp_is_all_there_is(bench):
    r = Rig(bench, simulated=True)
    r.clock.now = 0
    r.commands.take('u', 1.0, NOW + 7, 1)
    assert r.times == [7]
    r.commands.take('u', 2.0, None, 1)
    assert r.times == [7]
    r.commands.take('u', 1.0, NOW + 3600 * SECOND, 1)  # by the clock on the wall
    r.bank.advance(NOW + 10 * MS)
    r.take(0, 10 * MS)
    assert r.times == [7, 10 * MS]


@pytest.mark.parametrize('leads', [
    [0, -10 * MS, -20 * MS, -30 * MS],  # one and the same stamp
    [0, -30 * MS, -60 * MS, -90 * MS],  # backwards
    [-30 * MS, -50 * MS, -30 * MS, -50 * MS]])  # those of two who disagree
def test_a_stamp_that_is_not_later_is_no_time(make_rig, leads):
    r = make_rig()
    for k, lead in enumerate(leads):
        r.take(lead, 10 * k * MS, float(k))
    assert r.times == sorted(r.times) and not r.bank.refused and not r.warnings()
    assert r.times[-1] >= -20 * MS
    assert r.bank._told.samples['u'].values[-1] == 3.0  # what came last counts


@given(leads=st.lists(st.tuples(st.integers(0, 50 * MS), st.integers(-SECOND, SECOND)),
                      min_size=1, max_size=40))
def test_what_came_later_never_counts_earlier_and_nothing_is_refused(bench, leads):
    r, arrival, before = Rig(bench), 0, -SECOND
    for wait, lead in leads:
        arrival += wait
        r.take(lead, arrival, float(arrival))
        assert before <= r.times[-1] <= arrival
        assert r.times[-1] >= arrival - NEAR or r.times[-1] == before
        assert r.bank._told.samples['u'].values[-1] == arrival
        before = r.times[-1]
    assert not r.bank.refused


def test_another_clock_is_said_once_and_stays_to_be_seen(make_rig):
    r = make_rig()
    for k in range(20):
        r.take(300 * MS, 20 * k * MS)
    said, = r.warnings()
    assert said == 'u: its stamps are 0.3 s ahead of the clock of this node, so it counts from ' \
        'its arrival; mend the clock of who commands it'
    assert r.state.lead == pytest.approx(0.3) and r.state.from_arrival == 20
    assert str(r.state.trouble) == said
    r.take(-5 * MS, 400 * MS)  # which is mended
    assert r.state.trouble is None and r.state.from_arrival == 20 and not r.warnings()
    r.take(-7 * SECOND, 420 * MS)
    assert '7 s behind the clock' in r.warnings()[0]


def test_a_stamp_since_boot_is_said_to_be_of_another_kind(make_rig):
    r = make_rig()
    r.take(1234 * SECOND - NOW)
    assert 'of another kind than the clock of this node' in r.warnings()[0]


@pytest.mark.parametrize('value', [float('nan'), Reason('unreadable'), Reason.of(
    'too short', field='data[3]')])
def test_what_cannot_be_used_is_said_and_ends_what_would_hold(make_rig, value):
    r = make_rig()
    r.take(None)
    r.take(None, 10 * MS, value)
    assert 'so the last one is not used' in str(r.state.trouble)
    r.bank.advance(NOW + 500 * MS)
    assert r.state.lack is None
    r.bank.advance(NOW + 520 * MS)
    assert str(r.state.lack) == 'nothing of u could be used for 0.5 s'
    r.take(None, 530 * MS)
    assert r.state.trouble is None and r.state.lack is None


def test_a_message_of_other_joints_is_no_command(make_rig):
    r = make_rig()
    r.take(None)
    r.take(None, 10 * MS, Reason.of('not in the message', field='position[a]'))
    r.bank.advance(NOW + 60 * SECOND)
    assert r.state.trouble is None and r.state.lack is None


def test_after_a_jump_of_the_clock_all_begins_anew(make_rig):
    r = make_rig()
    r.take(0, 100 * MS)
    r.bank.reset()
    r.commands.forget()
    r.clock.now = 0
    r.take(0, -50 * MS)
    assert r.times == [-50 * MS]


def test_one_stamp_from_far_away_harms_no_other(make_rig):
    r = make_rig()
    for k, lead in enumerate([-5 * MS, 3600 * SECOND, -5 * MS, -3600 * SECOND, -5 * MS]):
        r.take(lead, 10 * k * MS)
    assert r.times == [-5 * MS, 10 * MS, 15 * MS, 30 * MS, 35 * MS]


def test_the_clock_may_have_been_looked_at_long_before(bench):
    r = Rig(bench)
    r.take(None)
    # more than the bank accepts ahead of its clock: the loop did not get to look
    r.commands.take('u', 2.0, None, NOW + 400 * MS)
    assert r.times == [0, 400 * MS] and not r.intake.counts()


def test_a_command_that_is_stamped_no_more_has_no_lead(bench):
    r = Rig(bench)
    r.take(20 * MS)
    r.take(None, arrival=10 * MS)
    state, = r.commands.states({})
    assert state.lead != state.lead  # NaN
