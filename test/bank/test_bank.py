"""The bank in time: start, late and missing readings, commands, clocks, overflow."""

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vsensor_ros.bank import Bank
from vsensor_ros.observers import Design, VirtualSensor
from vsensor_ros.reason import Reason

MS = 1_000_000
KEY = (('y1',), 'y1')


@pytest.fixture
def filter_of(bench):
    """One virtual sensor a name, z' = -z + reading, of channel `vi` that only itself fails."""
    def build(*reads, **more):
        names = tuple(dict.fromkeys(reads))
        sensors = []
        for i, name in enumerate(reads):
            v = bench.virtual_sensor([[-1.0]], [[1.0 if s == name else 0.0 for s in names]],
                                     healthy=names, fault_set=(f'v{i}',), **more)
            sensors.append(v)
        virtual = tuple(f'v{i}' for i in range(len(reads)))
        return bench.design(*sensors, names=(*virtual, *names), inputs=more.get('inputs', ()))
    return build


def test_starts_when_what_it_needs_is_there(filter_of):
    bank = Bank(filter_of('a', 'b', z0=[3.0]), 100)
    assert bank.time is None
    assert str(bank.why_not(('v0',), 'v0')) == 'no reading of a yet'
    bank.advance(0)
    assert bank.time is None
    bank.take('a', 0, 1.0)
    bank.advance(10 * MS)
    assert bank.time == 10 * MS
    assert bank.started(('v0',), 'v0') == 0
    assert bank.estimate(('v0',), 'v0') == pytest.approx(1 + 2 * np.exp(-0.01), abs=1e-12)
    assert str(bank.why_not(('v0',), 'v0')) == 'converging, 4.6 s more'
    assert bank.estimate(('v1',), 'v1') is None
    assert str(bank.why_not(('v1',), 'v1')) == 'no reading of b yet'
    bank.take('b', 20 * MS, 1.0)
    bank.advance(30 * MS)
    assert bank.started(('v1',), 'v1') == 20 * MS
    assert bank.estimate(('v1',), 'v1') == pytest.approx(1 + 2 * np.exp(-0.01), abs=1e-12)


def test_starts_from_readings_where_the_design_says_so(bench):
    v = bench.virtual_sensor([[-1.0]], [[0.0]], z0=[1.0], z0_gain=[[2.0]])
    bank = Bank(bench.design(v), 100)
    bank.take('y1', 0, 9.0)
    bank.advance(20 * MS)
    assert str(bank.why_not(*KEY)) == 'no reading of y2 yet'
    bank.take('y2', 20 * MS, 5.0)
    bank.advance(30 * MS)
    assert bank.estimate(*KEY) == pytest.approx(11 * np.exp(-0.01), abs=1e-12)


def test_waits_for_the_first_command_then_holds_it_however_old(bench):
    v = bench.virtual_sensor([[-1.0]], [[0.0]], B=[[1.0, 0.0]], P=[[0.0, 1.0]],
                             Gz=[[[0.0]], np.zeros((0, 1))], Gy=[[[0.0]], np.zeros((0, 1))],
                             texts=['w1 * idle', 'sin(used)'], inputs=('u', 'used'))
    d = Design('t', '0', ('x1',), ('u', 'used'), ('y1', 'y2'), {}, None, {KEY: v})
    bank = Bank(d, 100)
    bank.take('u', 0, 1.0)
    bank.advance(10 * MS)
    assert str(bank.why_not(*KEY)) == 'no command of used yet'
    bank.take('used', 10 * MS, 0.5)
    for now in range(20, 12_000, 10):
        bank.advance(now * MS)
    assert bank.estimate(*KEY) == pytest.approx(1 + np.sin(0.5), abs=1e-4)


def test_a_command_acts_from_its_stamp(bench):
    v = bench.virtual_sensor([[-8.0]], [[0.0]], B=[[1.0]], inputs=('u',))
    e = []
    for rate in (50, 100, 200):
        bank = Bank(bench.design(v, inputs=('u',)), rate)
        bank.take('u', 0, 0.0)
        bank.take('u', 83_456_789, 1.0)  # between two grid times
        for k in range(rate // 2 + 1):
            bank.advance(k * bank.period)
        truth = (1 - np.exp(-8 * (0.5 - 0.083456789))) / 8
        e.append(abs(bank.estimate(*KEY) - truth))
    assert max(e) < 2e-6
    assert e[2] < e[0] / 8


def test_a_late_command_is_still_applied_at_its_stamp(bench):
    v = bench.virtual_sensor([[-8.0]], [[0.0]], B=[[1.0]], inputs=('u',))
    banks = [Bank(bench.design(v, inputs=('u',)), 100) for _ in range(2)]
    for late, bank in zip((0, 150), banks):
        bank.take('u', 0, 0.0)
        for now in range(0, 500, 10):
            if now == 200 + late:
                bank.take('u', 200 * MS, 1.0)
            bank.advance(now * MS)
    assert banks[0].estimate(*KEY) == banks[1].estimate(*KEY) > 0.1


@pytest.mark.slow
@settings(deadline=None, max_examples=15)
@given(data=st.data())
def test_when_readings_arrive_does_not_matter_once_they_have(bench, data):
    """Delay each channel's readings at will, in order: the final state is the same, bit by bit."""
    d = bench.design(bench.tank((4.0, 1.0)), inputs=('u1', 'u2'))
    prompt, late = Bank(d, 100), Bank(d, 100)
    period = {'y2': data.draw(st.integers(3, 60)), 'u1': data.draw(st.integers(3, 200)),
              'u2': 500, 'y1': 7}
    queue = []
    for name, every in period.items():
        arrival = 0
        for stamp in range(0, 800, every):
            stamp_ns = stamp * MS + (data.draw(st.integers(0, 2 * MS)) if stamp else 0)
            arrival = max(arrival, stamp + data.draw(st.integers(0, 150))) if stamp else 0
            queue.append((arrival, name, stamp_ns, 0.5 + 0.3 * np.sin(stamp / 150)))
    for now in range(0, 1010, 10):
        for arrival, name, stamp, value in queue:
            if arrival > now - 10 and arrival <= now:
                assert late.take(name, stamp, value) is None
            if stamp > (now - 10) * MS and stamp <= now * MS:
                assert prompt.take(name, stamp, value) is None
        late.advance(now * MS)
        prompt.advance(now * MS)
    assert late.estimate(*KEY) is not None
    assert late.estimate(*KEY) == prompt.estimate(*KEY)
    assert late.started(*KEY) == prompt.started(*KEY) == 0


@pytest.mark.parametrize(('every', 'jitter', 'delay'), [
    (10, 0.0, 0), (37, 0.0, 0), (3, 0.0, 0), (10, 4.0, 0), (10, 0.0, 35), (23, 9.0, 20)])
def test_readings_slower_faster_jittered_and_late(bench, every, jitter, delay):
    """Second order in the spacing of readings, whatever it is; held to now, redone on arrival."""
    rng = np.random.default_rng(3)
    v = bench.virtual_sensor([[-2.0]], [[2.0]])
    bank = Bank(bench.design(v), 100)
    stamps = [0.0, *(t + jitter * rng.random() for t in range(every, 3000, every))]
    for now in range(0, 3000, 10):
        while stamps and stamps[0] + delay <= now:
            stamp = stamps.pop(0)
            assert bank.take('y2', int(stamp * MS), np.sin(3e-3 * stamp)) is None
        bank.advance(now * MS)
        truth = solve_ivp(lambda t, z: -2 * z + 2 * np.sin(3 * t), (0, now * 1e-3 + 1e-12), [0.0],
                          rtol=1e-9, atol=1e-11).y[0, -1] if now % 500 == 490 else None
        if truth is not None:
            spacing = max(every + jitter, 10.0) * 1e-3
            held = (every + jitter + delay) * 1e-3 if every > 10 or delay or jitter else 0.01
            assert abs(bank.estimate(*KEY) - truth) < 9 / 8 * spacing**2 + 2 * 3 / 2 * held**2


def test_rollback_makes_good_what_holding_did(bench, reference):
    """Late readings of the tank at 100 Hz, against the reference's figures for a gap."""
    t = np.arange(1501) / 100
    x, z = bench.tank_truth((4, 1), t, (lambda t: 0.5 + 0.3 * np.sin(t), lambda t: 0.2))
    truth, late = z[0] - z[1], range(800, 850)
    bank = Bank(bench.design(bench.tank((4, 1)), inputs=('u1', 'u2')), 100, max_age=1.0)
    e = np.zeros(len(t))
    for k in range(len(t)):
        bank.take('u1', k * bank.period, 0.5 + 0.3 * np.sin((k + 0.5) / 100))
        bank.take('u2', k * bank.period, 0.2)
        for j in range(800, 851) if k == 850 else [] if k in late else [k]:
            bank.take('y2', j * bank.period, x[2, j])
        bank.advance(k * bank.period)
        e[k] = abs(bank.estimate(*KEY) - truth[k])
    assert 1e-5 < e[840:850].max() < 5e-3
    assert e[850] < reference['runtime']['late_measurements_tank_100Hz']['gap_500ms'][
        'hold_then_rollback']['at_recovery']


def test_no_step_is_done_twice_for_nothing(filter_of):
    bank, steps = Bank(filter_of('a', 'b'), 100), []
    inner = bank._step
    bank._step = lambda *args: steps.append(1) or inner(*args)
    for now in range(0, 100, 10):
        for name in ('a', 'b'):
            bank.take(name, now * MS, 1.0)
        bank.advance(now * MS)
    assert len(steps) == 9  # on the grid and in time: nothing provisional
    for _ in range(5):
        bank.advance(99 * MS)
    assert len(steps) == 9
    bank.take('a', 95 * MS, 2.0)  # changes what was not integrated yet
    bank.advance(99 * MS)
    assert len(steps) == 9


def test_a_silent_sensor_stops_only_those_that_read_it(filter_of):
    bank = Bank(filter_of('a', 'b', z0=[3.0]), 100, max_age=0.2)
    alone = Bank(filter_of('a', 'b', z0=[3.0]), 100, max_age=0.2)
    for now in range(0, 1500, 10):
        for each in (bank, alone):
            each.take('a', (now - 3) * MS + 3 * MS * (now == 0), np.sin(now / 300))
        if now <= 500 or now >= 1200:
            bank.take('b', now * MS, 1.0)
        for each in (bank, alone):
            each.advance(now * MS)
        assert bank.estimate(('v0',), 'v0') == alone.estimate(('v0',), 'v0') is not None
        if 700 < now < 1200:
            assert bank.estimate(('v1',), 'v1') is None
            said = str(bank.why_not(('v1',), 'v1')).split()
            assert said[:3] + said[4:] == ['b', 'silent', 'for', 's']
            assert float(said[3]) == pytest.approx((now - 500) / 1000, abs=0.051)
        else:
            assert bank.estimate(('v1',), 'v1') is not None
            assert str(bank.why_not(('v1',), 'v1')).startswith('converging')
    assert bank.started(('v1',), 'v1') == 1200 * MS


def test_refuses_and_counts_what_is_no_reading(filter_of):
    bank = Bank(filter_of('a'), 100)
    assert bank.take('a', 10 * MS, 1.0) is None
    bank.advance(10 * MS)
    for stamp, value, reason in (
            (20, float('nan'), 'not finite'), (20, float('inf'), 'not finite'),
            (20, -float('inf'), 'not finite'), (10, 1.0, 'duplicate stamp'),
            (9, 1.0, 'stamp runs backwards'), (9_000, 1.0, 'stamp ahead of the clock')):
        assert str(bank.take('a', stamp * MS, value)) == reason
    assert bank.refused == {('a', Reason.of(code)): count for code, count in {
        'not finite': 3, 'duplicate stamp': 1, 'stamp runs backwards': 1,
        'ahead of the clock': 1}.items()}
    assert bank.take('a', 20 * MS, 1.0) is None
    with pytest.raises(KeyError):
        bank.take('nobody', 30 * MS, 1.0)


def test_a_stamp_a_little_ahead_shuts_a_sensor_out_for_no_longer(filter_of):
    bank = Bank(filter_of('a'), 100, max_age=5.0)
    for now in range(0, 1000, 10):
        bank.take('a', now * MS, 1.0, now * MS)
        bank.advance(now * MS)
    assert str(bank.take('a', 1150 * MS, 55.0, 1000 * MS)) == 'stamp ahead of the clock'
    assert bank.take('a', 1090 * MS, 1.0, 1000 * MS) is None
    assert bank.take('a', 1100 * MS, 1.0, 1100 * MS) is None
    assert bank.refused == {('a', Reason.of('ahead of the clock')): 1}


def test_a_stamp_from_the_future_before_the_first_tick_does_no_harm(filter_of):
    bank = Bank(filter_of('a'), 100)
    bank.take('a', 10**18, 1.0)
    bank.advance(0)
    assert bank.refused['a', Reason.of('ahead of the clock')] == 1
    for now in range(0, 100, 10):
        assert bank.take('a', now * MS, 1.0) is None
        bank.advance(now * MS)
    assert bank.estimate(('v0',), 'v0') is not None
    assert 80 * MS < bank.time <= 90 * MS


def test_a_clock_set_back_resets(filter_of):
    bank = Bank(filter_of('a', z0=[3.0]), 100)
    for now in range(5000, 6000, 10):
        bank.take('a', now * MS, 1.0)
        bank.advance(now * MS)
    bank.advance(100 * MS)
    assert bank.jumps == {'backwards': 1}
    assert bank.time is None
    assert bank.estimate(('v0',), 'v0') is None
    assert str(bank.why_not(('v0',), 'v0')) == 'no reading of a yet'
    for now in range(110, 200, 10):
        assert bank.take('a', now * MS, 1.0) is None
        bank.advance(now * MS)
    assert bank.estimate(('v0',), 'v0') == pytest.approx(1 + 2 * np.exp(-0.08), abs=1e-12)


def test_a_clock_far_ahead_restarts_without_integrating_the_gap(filter_of):
    bank, steps = Bank(filter_of('a', z0=[3.0]), 100), []
    for now in range(0, 100, 10):
        bank.take('a', now * MS, 1.0)
        bank.advance(now * MS)
    inner = bank._step
    bank._step = lambda *args: steps.append(1) or inner(*args)
    bank.advance(3_600_000 * MS)
    assert bank.jumps == {'forwards': 1}
    assert len(steps) < 200
    assert bank.time == 3_600_000 * MS
    assert str(bank.why_not(('v0',), 'v0')) == 'a silent for 3599.9 s'
    bank.take('a', 3_600_010 * MS, 1.0)
    bank.advance(3_600_010 * MS)
    assert bank.started(('v0',), 'v0') == 3_600_010 * MS


def test_what_becomes_infinite_starts_anew_and_harms_nobody(bench):
    bad = bench.virtual_sensor([[-1.0]], [[0.0]], P=[[1.0]], Gz=[[[0.0]]], Gy=[[[1.0]]],
                               texts=['exp(w1)'], fault_set=('y1',))
    good = bench.virtual_sensor([[-1.0]], [[1.0]], fault_set=('y3',))
    both = Bank(bench.design(bad, good, names=('y1', 'y2', 'y3')), 100)
    alone = Bank(bench.design(good, names=('y1', 'y2', 'y3')), 100)
    for now in range(0, 300, 10):
        for bank in (both, alone):
            bank.take('y2', now * MS, 5000.0 if now == 150 else 1.0)
            bank.advance(now * MS)
        assert both.estimate(('y3',), 'y3') == pytest.approx(
            alone.estimate(('y3',), 'y3'), rel=1e-13)
        value = both.estimate(*KEY)
        assert value is None if now == 150 else 0 <= value < 1e10
    assert both.restarts == {KEY: 1}
    assert both.started(*KEY) == 160 * MS
    assert not alone.restarts


def test_a_static_virtual_sensor_follows_its_readings_at_once(bench):
    v = bench.virtual_sensor(np.zeros((0, 0)), np.zeros((0, 1)), Q=[[2.0]])
    bank = Bank(bench.design(v), 100)
    bank.take('y2', 0, 1.0)
    bank.take('y2', 20 * MS, 2.0)
    for now, expected in ((0, 2.0), (10, 3.0), (20, 4.0), (30, 4.0)):
        bank.advance(now * MS)
        assert bank.estimate(*KEY) == pytest.approx(expected, abs=1e-12)


def test_a_discrete_plant_runs_at_its_sample_time(bench):
    v = bench.virtual_sensor([[0.5]], [[1.0]], B=[[1.0]], inputs=('u',), sample_time=1.0)
    d = bench.design(v, inputs=('u',))
    for rate in (100.0, 0.99):
        with pytest.raises(ValueError, match='sample time'):
            Bank(d, rate)
    bank, z = Bank(d, 1.0), 0.0
    start = 1_700_000_000_370_000_000
    for k in range(50):
        now = start + k * 1000 * MS
        if k:
            z = 0.5 * z + np.sin(k - 1) + np.cos(k - 1)
        assert bank.take('y2', now, np.sin(k)) is None
        assert bank.take('u', now, np.cos(k)) is None
        bank.advance(now + 40 * MS)
        assert bank.time == now
        assert bank.estimate(*KEY) == pytest.approx(z, abs=1e-12)


@pytest.mark.parametrize('rate', [0.0, -1.0, float('nan'), float('inf')])
def test_refuses_a_rate_that_is_none(filter_of, rate):
    with pytest.raises(ValueError, match='rate'):
        Bank(filter_of('a'), rate)


def test_what_was_not_designed_has_a_reason(bench, filter_of):
    refusal = bench.Refusal('y1', ('y1',), 'mode 0 is hidden')
    bank = Bank(Design('t', '0', ('x1',), (), ('y1', 'y2'), {}, None, {KEY: refusal}), 100)
    bank.take('y2', 0, 1.0)
    bank.advance(10 * MS)
    assert bank.estimate(*KEY) is None
    assert str(bank.why_not(*KEY)) == 'mode 0 is hidden'
    assert 'no design' in str(bank.why_not(('y2',), 'y2'))
    assert isinstance(bench.tank((1, 4)), VirtualSensor)
