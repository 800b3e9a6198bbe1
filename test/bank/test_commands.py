"""Commands that come no more: what counts then, when it is redone, and who stops."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Bank, End
from vsensor_ros.bank.commands import Command, PERIODIC

MS = 1_000_000
KEY = (('y1',), 'y1')
TIMES = st.lists(st.integers(0, 10**6), min_size=1, max_size=30, unique=True).map(sorted)
ENDS = st.sampled_from([None, End(1e-4), End(1e-4, 7.0), End(1e-4, -2.0, only_periodic=True)])


def filled(stamps, values, end=None, least=1):
    command = Command(end, least)
    for stamp, value in zip(stamps, values):
        assert command.take(stamp, value)
    return command


def truth(stamps, values, end, time):
    """Tell from the definition what counts at a time, and whether anything does."""
    before = [i for i, s in enumerate(stamps) if s <= time]
    if not before:
        return None, False
    i = before[-1]
    gaps = np.diff(stamps[max(0, i - PERIODIC):i + 1])
    age = None if end is None else round(end.max_age * 1e9)
    mortal = age is not None and (not end.only_periodic or (
        len(gaps) == PERIODIC and max(gaps) <= age))
    if not mortal or time - stamps[i] < age:
        return values[i], False
    return (values[i], time - stamps[i] > age) if end.value is None else (end.value, False)


@given(TIMES, ENDS, st.integers(-10, 10**6 + 2 * 10**5))
def test_a_value_holds_until_the_next_or_its_end(stamps, end, time):
    values = [float(np.sin(s)) for s in stamps]
    command = filled(stamps, values, end)
    assert (command.held(time), command.stopped(time)) == truth(stamps, values, end, time)


@given(TIMES, ENDS, st.integers(0, 10**6))
def test_forgetting_changes_no_later_value(stamps, end, before):
    values = [float(s % 7) for s in stamps]
    whole, less = filled(stamps, values, end), filled(stamps, values, end)
    less.forget(before)
    for time in range(before, 10**6 + 200_000, 33_331):
        assert less.held(time) == whole.held(time)
        assert less.stopped(time) == whole.stopped(time)
        assert less.over(time, time + 10**5) == whole.over(time, time + 10**5)


@given(TIMES, ENDS, st.integers(0, 10**6 + 10**5), st.integers(1, 2 * 10**5))
def test_over_a_step_mean_and_first_moment_are_kept(stamps, end, start, length):
    values = [float(np.cos(s)) for s in stamps]
    command, stop = filled(stamps, values, end), start + length
    first, last, mean = command.over(start, stop)
    if command.held(start) is None:
        assert (first, last, mean) == (0.0, 0.0, 0.0)
        return
    ends = [s + round(end.max_age * 1e9) for s in stamps] if end is not None else []
    edges = [start, *sorted(s for s in {*stamps, *ends} if start < s < stop), stop]
    pieces = [(a, b, truth(stamps, values, end, a)[0]) for a, b in zip(edges, edges[1:])]
    area = sum((b - a) * v for a, b, v in pieces) / length
    moment = sum(v * ((b - start) ** 2 - (a - start) ** 2) / 2 for a, b, v in pieces) / length**2
    assert mean == pytest.approx(area, abs=1e-12)
    assert (first + last) / 2 == pytest.approx(area, abs=1e-12)
    assert first / 6 + last / 3 == pytest.approx(moment, abs=1e-12)
    if len({value for _, _, value in pieces}) == 1:
        assert first == last == pieces[0][2]


def test_memory_is_bounded_whatever_comes():
    command = filled(range(200_000), [0.0] * 200_000, End(1.0))
    assert len(command.stamps) <= 2**16
    for k in range(1000):
        command.spoil(300_000 + k)
    assert len(command._unusable) == 1


# ------------------------------------------------------------- a plant of first order, v' = 3(u-v)

@pytest.fixture
def make_bank(bench):
    v = bench.virtual_sensor([[-3.0]], [[0.0]], B=[[3.0]], inputs=('u',))

    def make(end=None, rate=100):
        return Bank(bench.design(v, inputs=('u',)), rate,
                    command_ends={} if end is None else {'u': end})
    return make


def drive(bank, start, stop, every=50, value=0.7):
    """Command a value every so many ms from start on, and advance to the stop."""
    for now in range(start, stop, 10):
        if every and (now - start) % every == 0:
            assert bank.take('u', now * MS, value) is None
        bank.advance(now * MS)


def answer(t, u=0.7, v=0.0):
    return u + (v - u) * np.exp(-3.0 * t)


@pytest.mark.parametrize('max_age', [0.5, 0.5037])
@pytest.mark.parametrize('value', [0.0, -0.2])
def test_from_the_end_on_the_given_value_counts(make_bank, max_age, value):
    bank = make_bank(End(max_age, value))
    drive(bank, 0, 2001)  # the last one at 2 s
    assert bank.estimate(*KEY) == pytest.approx(answer(2.0), abs=1e-9)
    drive(bank, 2010, 2491, every=None)
    assert bank.estimate(*KEY) == pytest.approx(answer(2.49), abs=1e-9)
    drive(bank, 2500, 4001, every=None)
    at_end = answer(2.0 + max_age)
    expected = answer(2.0 - max_age, value, at_end)
    assert bank.estimate(*KEY) == pytest.approx(expected, abs=1e-6)
    assert bank.started(*KEY) == 0 and bank.lack('u') is None
    drive(bank, 4010, 5001)  # and the command is back
    assert bank.estimate(*KEY) == pytest.approx(
        answer(0.99, 0.7, answer(0.01, value, expected)), abs=1e-6)


def test_without_a_value_what_reads_it_stops_and_starts_anew(make_bank):
    bank = make_bank(End(0.5))
    drive(bank, 0, 3001)
    assert bank.ready(*KEY)
    drive(bank, 3010, 3501, every=None)
    assert bank.ready(*KEY) and bank.why_not(*KEY) is None
    drive(bank, 3510, 3801, every=None)
    assert not bank.ready(*KEY) and bank.estimate(*KEY) is None
    assert str(bank.why_not(*KEY)) == \
        'u ended 0.8 s ago; commands.u.at_end says what counts then'
    drive(bank, 3810, 3911)
    assert bank.started(*KEY) == 3810 * MS and str(bank.why_not(*KEY)).startswith('converging')
    assert bank.estimate(*KEY) == pytest.approx(answer(0.1), abs=1e-9)
    drive(bank, 3920, 8001)
    assert bank.ready(*KEY)


@pytest.mark.parametrize(('count', 'every', 'ends'), [
    (1, 50, False), (PERIODIC, 50, False), (PERIODIC + 1, 50, True), (PERIODIC + 1, 500, True),
    (3 * PERIODIC, 510, False)])
def test_by_default_only_what_came_periodically_ends(make_bank, count, every, ends):
    bank = make_bank(End(0.5, only_periodic=True))
    drive(bank, 0, (count - 1) * every + 10, every)
    drive(bank, count * every, count * every + 20_000, every=None)
    assert (bank.estimate(*KEY) is None) == ends
    assert (bank.lack('u') is not None) == ends


def test_without_an_end_it_holds_for_ever(make_bank):
    bank = make_bank()
    drive(bank, 0, 2001)
    drive(bank, 2010, 60_001, every=None)
    assert bank.estimate(*KEY) == pytest.approx(0.7, abs=1e-12)


@pytest.mark.parametrize('useless', [np.nan, np.inf, None])
def test_what_cannot_be_used_ends_a_value_that_would_hold(make_bank, useless):
    bank = make_bank(End(0.5, only_periodic=True))
    bank.take('u', 0, 0.7)
    drive(bank, 0, 5001, every=None)
    for now in range(5010, 5401, 10):  # it comes again and again: the first counts
        if useless is None:
            bank.spoil('u', now * MS)
        else:
            assert str(bank.take('u', now * MS, useless)) == 'not finite'
        bank.advance(now * MS)
    assert bank.ready(*KEY)
    drive(bank, 5410, 5521, every=None)
    assert bank.estimate(*KEY) is None
    assert str(bank.why_not(*KEY)) == 'nothing of u could be used for 5.5 s'
    bank.take('u', 5530 * MS, 0.7)
    drive(bank, 5530, 9001, every=None)
    assert bank.started(*KEY) == 5530 * MS and bank.ready(*KEY)


def test_what_cannot_be_used_now_and_then_does_no_harm(make_bank):
    bank = make_bank(End(0.5, only_periodic=True))
    for k in range(100):
        bank.take('u', k * 50 * MS, np.nan if k % 5 == 4 else 0.7)
        bank.advance(k * 50 * MS)
    assert bank.started(*KEY) == 0
    assert bank.estimate(*KEY) == pytest.approx(answer(99 * 0.05), abs=1e-9)


def test_one_that_never_comes_has_ended_from_the_start(bench):
    v = bench.virtual_sensor([[-3.0]], [[1.0]], B=[[3.0]], inputs=('u',))
    bank = Bank(bench.design(v, inputs=('u',)), 100, command_ends={'u': End(0.2, 0.5)})
    for now in range(0, 1201, 10):
        bank.take('y2', now * MS, 0.0)
        bank.advance(now * MS)
        if now == 190:
            assert str(bank.why_not(*KEY)) == 'no command of u yet'
    assert bank.started(*KEY) == 200 * MS
    assert bank.estimate(*KEY) == pytest.approx(answer(1.0, 0.5), abs=1e-9)


@settings(max_examples=15)
@given(data=st.data())
def test_when_commands_arrive_does_not_matter_once_they_have(bench, data):
    """Delay them at will: start, state and readiness are the same in the end, bit by bit."""
    v = bench.virtual_sensor([[-3.0]], [[0.5]], B=[[3.0]], inputs=('u',))
    end = data.draw(st.sampled_from([End(0.1), End(0.1, 0.2), End(0.1, only_periodic=True),
                                     End(0.0437, -1.0, only_periodic=True)]))
    d = bench.design(v, inputs=('u',))
    prompt, late = (Bank(d, 100, command_ends={'u': end}) for _ in range(2))
    stamp, arrival, queue = 0, 0, []
    while stamp < 900:
        if stamp:
            arrival = max(arrival, stamp + data.draw(st.integers(0, 150)))
        queue.append((arrival, 'u', stamp * MS, 0.5 + 0.3 * np.sin(stamp / 150)))
        stamp += data.draw(st.sampled_from([7, 13, 20, 30, 95, 105, 160]))
    queue += [(t, 'y2', t * MS, np.cos(t / 100)) for t in range(0, 1100, 10)]
    for now in range(0, 1110, 10):
        for arrives, name, at, value in queue:
            if now - 10 < arrives <= now:
                late.take(name, at, value)
            if (now - 10) * MS < at <= now * MS:
                prompt.take(name, at, value)
        late.advance(now * MS)
        prompt.advance(now * MS)
    for ask in ('estimate', 'started', 'ready', 'why_not'):
        assert getattr(late, ask)(*KEY) == getattr(prompt, ask)(*KEY), ask


def test_who_does_not_need_a_command_goes_on_when_it_ends(bench):
    needs = bench.virtual_sensor([[-3.0]], [[0.0]], B=[[3.0]], inputs=('u',))
    not_at_all = bench.virtual_sensor([[-1.0]], [[1.0]], fault_set=('y3',), inputs=('u',))
    bank = Bank(bench.design(needs, not_at_all, names=('y1', 'y2', 'y3'), inputs=('u',)), 100,
                command_ends={'u': End(0.2)})
    bank.take('u', 0, 1.0)
    for now in range(0, 2001, 10):
        bank.take('y2', now * MS, 0.4)
        bank.advance(now * MS)
    assert bank.estimate(*KEY) is None
    assert bank.started(('y3',), 'y3') == 0
    assert bank.estimate(('y3',), 'y3') == pytest.approx(0.4 * (1 - np.exp(-2.0)), abs=1e-9)


@pytest.mark.parametrize(('ends', 'problem'), [
    ({'v': End()}, 'v is no command'), ({'u': End(0.0)}, '0.0 is not a time in s'),
    ({'u': End(np.nan)}, 'nan is not a time in s'), ({'u': End(1.0, np.inf)}, 'inf is not a')])
def test_refuses_an_end_that_is_none(bench, ends, problem):
    v = bench.virtual_sensor([[-3.0]], [[0.0]], B=[[3.0]], inputs=('u',))
    with pytest.raises(BadInput, match=problem):
        Bank(bench.design(v, inputs=('u',)), 100, command_ends=ends)
