"""A relay while nothing has failed; what is composed is newer, and so is what follows it."""

import math
from pathlib import Path
import sys

import pytest

sys.path.append(str(Path(__file__).parent))
from machine import ABSENT, Machine, PERIOD, SECOND

from vsensor_ros.engine import Engine, Forward
from vsensor_ros.reason import Reason

LATE = 300_000_000  # ns by which messages of a late driver come after their stamps
NOT_NEWER = Reason('not newer')


def y1(time):
    """Return the truth; y2 is twice as much."""
    return math.sin(2e-9 * (time - 1000 * SECOND))


def stuck(m, i):
    return 999 * SECOND


def batches(m, i):
    return m.now - i % 10 * PERIOD


def whole_seconds(m, i):
    return m.now // SECOND * SECOND


def backwards(m, i):
    return m.now - i * PERIOD // 2


def alternating(m, i):
    return m.now - i % 2 * 10 * SECOND


def far_ahead(m, i):
    return m.now + (i % 7 == 0) * 100 * SECOND


@pytest.mark.parametrize('stamp', [
    stuck, batches, whole_seconds, backwards, alternating, far_ahead])
@pytest.mark.parametrize('shared', [False, True])
def test_healthy_messages_go_on_whatever_their_stamps(bench, shared, stamp):
    m = Machine(bench, shared)
    values = (1.5, 3.0) if shared else (1.5,)
    for i in range(200):
        m.pass_time(1)
        assert m.hear(0, *values, stamp=stamp(m, i)) == Forward({})
    y = m.state('y1')
    assert (y.source, y.reason) == ('real', None) and NOT_NEWER not in y.counts


def test_what_is_composed_is_newer_than_what_went_out_but_for_mistakes(bench):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    m.hear(1, 3.0, stamp=m.now + 5_000_000)
    m.hear(1, 3.0, stamp=m.now - SECOND)  # late
    m.hear(1, 3.0, stamp=m.now + 3600 * SECOND)  # a mistake
    m.isolate('y2')
    assert [c.stamp for c in m.sent] == [m.now + 5_000_001]
    m.step(1.5, 99.0, 5)
    assert [c.stamp for c in m.sent[1:]] == [m.now - i * PERIOD for i in range(4, -1, -1)]


@pytest.mark.parametrize('offset', [-3600 * SECOND, 3600 * SECOND])
def test_what_is_composed_follows_a_clock_that_was_set(bench, offset):
    m = Machine(bench)
    m.step(1.5, 3.0, 20)
    for _ in range(5):
        m.pass_time(1)
        m.hear(0, 1.5)
        assert m.hear(1, 3.0, stamp=m.now + offset) == Forward({})
    m.isolate('y2')
    m.step(1.5, 99.0, 3)
    assert [c.stamp - offset for c in m.sent[-3:]] == [m.now - i * PERIOD for i in (2, 1, 0)]
    said = [str(remark.what) for remark in m.engine.remarks()]
    assert sum('they step back there now' in text for text in said) == (offset < 0)
    assert sum('the stamps on /y2_raw are' in text for text in said) == 1


def failed_over(bench, **more):
    """Return a machine that has just given back both joints of one message."""
    m = Machine(bench, shared=True, **more)
    m.step(1.5, 3.0, 20)
    m.isolate('y2')
    m.step(1.5, 99.0, 20)
    m.isolate()
    return m, m.sent[-1].stamp


def test_what_follows_is_newer_joint_by_joint(bench):
    m, last = failed_over(bench)
    assert m.hear(0, 1.5, 3.0, stamp=last) == NOT_NEWER
    assert m.hear(0, 1.5, ABSENT, stamp=last) == NOT_NEWER
    assert m.state('y1').counts[NOT_NEWER] == 2 and m.state('y2').counts[NOT_NEWER] == 1
    for name, count in (('y1', 2), ('y2', 1)):  # healthy and heard, but not all went on
        told = m.state(name)
        assert told.source == 'real'
        assert str(told.reason) == \
            f'{count} of its messages in 5 s not sent on: not newer than what went out'
    for values in ((1.5, ABSENT), (ABSENT, 3.0), (1.5, ABSENT), (ABSENT, 3.0)):
        assert m.hear(0, *values, stamp=last + 1) == Forward({})  # of one stamp, joint by joint
    m.pass_time(600)
    m.step(1.5, 3.0, 2)
    assert m.state('y1').reason is None


def test_what_was_composed_is_not_followed_by_anything_older_for_a_while(bench):
    m, last = failed_over(bench)
    for _ in range(100):
        m.step(1.5, 3.0)
        assert m.hear(0, 1.5, 3.0, stamp=last - SECOND) == NOT_NEWER
    m.pass_time(450)
    assert m.hear(0, 1.5, 3.0, stamp=last - SECOND) == Forward({})  # a relay again


@pytest.mark.parametrize('healthy', [1, 100, 1000])  # periods since the fault
def test_a_reset_after_a_failover_is_believed_soon(bench, healthy):
    m, _ = failed_over(bench)
    m.step(1.5, 3.0, healthy)
    lost = 0
    for _ in range(200):
        m.pass_time(1)
        lost += m.hear(0, 1.5, 3.0, stamp=m.now - 100 * SECOND) == NOT_NEWER
    assert lost <= 51  # max_age
    assert m.hear(0, 1.5, 3.0, stamp=m.now - 100 * SECOND) == Forward({})
    assert any('they step back there now' in str(r.what) for r in m.engine.remarks())


def test_a_reset_during_a_fault_is_believed_when_it_can_be_no_backlog(bench):
    m, _ = failed_over(bench)
    lost = 0
    for _ in range(700):
        m.pass_time(1)
        lost += m.hear(0, 1.5, 3.0, stamp=m.now - 100 * SECOND) == NOT_NEWER
    assert 490 <= lost <= 501


def test_a_second_fault_is_newer_than_what_was_live_between(bench):
    m, _ = failed_over(bench)
    m.hear(0, 1.5, 3.0, stamp=m.now + 30_000_000)
    m.isolate('y2')
    before = len(m.sent)
    m.step(1.5, 99.0, 10)
    assert [c.stamp for c in m.sent[before:]] == [m.now - i * PERIOD for i in range(6, -1, -1)]


def test_what_waits_to_be_newer_is_said_at_once(bench):
    m = Machine(bench, shared=True)
    m.step(1.5, 3.0, 20)
    m.hear(0, 1.5, 3.0, stamp=m.now + 200_000_000)
    m.isolate('y2')
    m.step(1.5, 99.0, 5)
    assert not m.sent and m.state('y1').source == 'real'
    assert 'not newer than what went out' in str(m.state('y1').reason)
    assert m.state('y1').counts[NOT_NEWER] >= 5


# ---------------------------------------------------------------------------- a late driver

class LateMachine(Machine):
    """Its one driver sends both sensors LATE after their stamps, every so many periods."""

    def __init__(self, bench, every=1, **more):
        super().__init__(bench, shared=True, **more)
        self.every, self.went, self.fault = every, [], 0.0
        self.count = 0

    def run(self, periods, jitter=lambda i: 0):
        for _ in range(periods):
            self.now += PERIOD
            self.count += 1
            if self.count % self.every == 0:
                stamp = self.now - LATE - jitter(self.count)
                verdict = self.hear(0, y1(stamp), 2.0 * y1(stamp) + self.fault, stamp=stamp,
                                    token=stamp)
                if isinstance(verdict, Forward):
                    self.went.append((stamp, stamp, y1(stamp), 2.0 * y1(stamp) + self.fault))
            self.pass_time()

    def send(self, made):
        super().send(made)
        for c in made:
            (_, one), (_, two) = c.fields
            self.went.append((c.stamp, c.template, one, two.value))


def check(went, within=2e-3):
    stamps = [stamp for stamp, *_ in went]
    assert all(b > a for a, b in zip(stamps, stamps[1:]))
    for stamp, template, one, two in went:
        assert stamp == template  # its own, and the rest of the message is of that time
        assert one == y1(stamp)
        assert two == pytest.approx(2.0 * y1(stamp), abs=within)
    return stamps


@pytest.mark.parametrize('every', [1, 2, 10])
def test_a_late_driver_keeps_its_stamps_and_leaves_no_hole(bench, every):
    m = LateMachine(bench, every)
    m.run(400)
    m.fault = 99.0
    m.isolate('y2')
    m.run(200)
    assert m.state('y2').source == 'virtual'
    m.fault = 0.0
    m.isolate()  # what it said just before is not believed
    m.run(100)
    stamps = check(m.went)
    assert len(m.sent) >= 190 // every and m.state('y1').reason is None
    assert all(b - a == every * PERIOD for a, b in zip(stamps, stamps[1:]))  # none is lost
    assert m.state('y2').source == 'real' and NOT_NEWER not in m.state('y2').counts


def test_lateness_that_varies(bench):
    m = LateMachine(bench)
    m.run(400, lambda i: i * 7919 % 9_000_000)
    m.fault = 99.0
    m.isolate('y2')
    m.run(200, lambda i: i * 7919 % 9_000_000)
    check(m.went, 0.01)  # what a quarter of a period changes: between ticks readings are held
    assert len(m.sent) >= 195


def test_what_a_late_driver_is_computed_from_is_complete(bench):
    m = LateMachine(bench)
    m.run(400)
    m.isolate('y2')
    m.run(100)
    deviation = m.sent[-1].fields[1][1].deviation
    assert deviation < 1e-3  # nothing that it reads is held for as long as it is late


def test_while_a_late_driver_pauses_nothing_is_stamped_anew(bench):
    m = LateMachine(bench)
    m.run(400)
    m.isolate('y2')
    m.run(50)
    before = len(m.sent)
    m.every = 10**9
    m.run(40)
    assert len(m.sent) <= before + 1  # what had come before
    m.every = 1
    m.run(20)
    assert [c.stamp for c in m.sent[-10:]] == [m.now - LATE - i * PERIOD for i in range(9, -1, -1)]
    check(m.went)


def test_a_late_driver_that_stops_is_spoken_for_on_its_own_time(bench):
    m = Machine(bench)

    def run(periods, late=True):
        for _ in range(periods):
            m.now += PERIOD
            m.hear(0, y1(m.now))
            if late:
                m.hear(1, 2.0 * y1(m.now - LATE), stamp=m.now - LATE)
            m.pass_time()
    run(400)
    m.isolate('y2')
    run(50)
    before = len(m.sent)
    run(45, late=False)
    assert len(m.sent) <= before + 1
    run(40, late=False)
    said = m.sent[-20:]
    newest = m.now - LATE + PERIOD  # its messages come before the clock moves
    assert [c.stamp for c in said] == [newest - i * PERIOD for i in range(19, -1, -1)]
    assert all(c.fields[0][1].value == pytest.approx(2.0 * y1(c.stamp), abs=2e-3) for c in said)


def test_a_little_late_is_as_ever(bench):
    m = Machine(bench)
    for _ in range(100):
        m.now += PERIOD
        m.hear(0, 1.5)
        m.hear(1, 3.0, stamp=m.now - 15_000_000)
        m.pass_time()
    m.isolate('y2')
    m.step(1.5, 99.0, 5)
    assert [c.stamp for c in m.sent[-5:]] == [m.now - i * PERIOD for i in range(4, -1, -1)]


def test_another_failure_needs_the_bank_as_of_now(bench):
    """What is late holds up no other: y1 comes at once, y2 is late and fails first."""
    m = Machine(bench)

    def run(periods):
        for _ in range(periods):
            m.now += PERIOD
            m.hear(0, y1(m.now))
            m.hear(1, 2.0 * y1(m.now - LATE), stamp=m.now - LATE)
            m.pass_time()
    run(400)
    m.isolate('y2')
    run(50)
    said = m.sent[-1]
    assert said.stamp == m.now - LATE
    assert said.fields[0][1].value == pytest.approx(2.0 * y1(said.stamp), abs=2e-3)
    m.isolate()
    run(400)
    m.isolate('y1')
    run(50)
    said = m.sent[-1]
    assert said.stream == 0 and said.stamp == m.now  # from readings that are late
    assert said.fields[0][1].value == pytest.approx(y1(m.now - LATE), abs=2e-3)


# -------------------------------------------------------------------------- a stopped clock

@pytest.mark.parametrize('began', [False, True])
def test_a_clock_that_stands_still_withholds_nothing(bench, began):
    m = Machine(bench)
    if began:
        m.step(1.5, 3.0, 20)
    else:
        m.engine = Engine(m.setup)
        m.engine.activate()
    stamp = m.now
    for _ in range(500):
        stamp += PERIOD
        message = m.hear(1, 3.0, stamp=stamp)
        assert message == Forward({})
    assert m.state('y2').source == 'real' and m.state('y2').reason is None
    assert NOT_NEWER not in m.state('y2').counts
    if began:
        assert m.state('y2').counts[Reason('ahead of the clock')] > 400
    m.now = stamp + PERIOD
    m.step(1.5, 3.0, 20)
    m.isolate('y2')
    m.step(1.5, 99.0, 5)
    assert m.sent and m.sent[-1].stamp == m.now


def test_what_is_composed_no_more_while_the_clock_stands_still_is_not_well(bench):
    m = Machine(bench, shared=True)
    m.step(1.5, 3.0, 20)
    m.isolate('y2')
    m.step(1.5, 99.0, 5)
    assert m.state('y1').source == 'real'
    for i in range(5):
        assert m.hear(0, 1.5, 99.0, stamp=m.now + i * PERIOD) is None
    y1, y2 = m.engine.snapshot(1e-9 * m.now + 3.0).channels
    for told in (y1, y2):  # one is healthy, but its messages do not go on
        assert told.source == 'none' and math.isnan(told.value)
        assert str(told.reason).startswith('the clock stands still')
    m.step(1.5, 99.0)
    assert m.state('y1').source == 'real'


def test_a_clock_that_was_looked_at_a_while_ago_refuses_no_reading(bench):
    m = Machine(bench, simulated=False)
    m.step(1.5, 3.0, 20)
    for i in range(1, 30):  # all in one round, which takes long
        at = m.now + i * PERIOD
        assert m.hear(1, 3.0, stamp=at, received=at) == Forward({})
    assert not m.state('y2').counts
