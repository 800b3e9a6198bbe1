"""Sensors that read commands directly, and wanted functionals that are no sensors."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from vsensor_ros import Plant
from vsensor_ros.bank import Bank
from vsensor_ros.engine import Source, Switch
from vsensor_ros.observers.kinds.functional.step import make_step
from vsensor_ros.simulate.simulate import readings, simulate

MS = 1_000_000
SECONDS = 2
SPRING, DRAG, DRIVE, SEEN, SPEED = 4.0, 0.5, 3.0, 0.7, 2.0


@pytest.fixture(scope='module')
def mass():
    """Make a mass on a spring that sees sin(p): an accelerometer, and p with a bit of u in it."""
    return Plant.from_matrices(
        [[0, 1], [-SPRING, -DRAG]], [0, DRIVE], [[-SPRING, -DRAG], [1, 0], [0, 1]], P=[0, -1],
        G=[[1, 0]], nonlinearities=['sin(w1)'], Cu=[DRIVE, SEEN, 0], initial=[0.5, -0.3],
        sensors=('a', 'p', 'v'))


@pytest.fixture
def observers(bench):
    """Write out by hand what stands in for v, read from p, and for a, static in p and v."""
    N, J = -(DRAG + SPEED), -SPRING - (DRAG + SPEED) * SPEED
    speed = bench.virtual_sensor(  # z = v - SPEED p
        [[N]], [[0.0, J]], B=[[DRIVE - J * SEEN]], P=[[-1.0]], Gz=[[[0.0]]], Gy=[[[0.0, 1.0]]],
        texts=['sin(w1)'], Q=[[0.0, SPEED]], fault_set=('v',), healthy=('a', 'p'), inputs=('u1',),
        Qu=np.array([[-SPEED * SEEN]]), Gu=(np.array([[-SEEN]]),), z0=[-0.3 - SPEED * 0.5])
    acceleration = bench.virtual_sensor(
        np.zeros((0, 0)), None, Q=[[-SPRING, -DRAG]], fault_set=('a',), healthy=('p', 'v'),
        inputs=('u1',), Qu=np.array([[DRIVE + SPRING * SEEN]]))
    return bench.design(speed, acceleration, names=('a', 'p', 'v'), inputs=('u1',))


def error(bench, mass, design, name, rate, command):
    """Run the bank on what the simulated sensors say; return the largest error of one."""
    t = np.arange(SECONDS * rate + 1) / rate
    u = command(t)[:, None]
    values = dict(zip(mass.sensors, readings(mass, t, simulate(mass, t, u), u).T))
    truth = values.pop(name)
    estimate = bench.run(Bank(design, rate), ((name,), name), rate, values,
                         {'u1': lambda at: u[int(at * rate), 0]})
    return np.abs(estimate - truth).max()


def test_a_command_that_a_sensor_reads_is_taken_out(bench, mass, observers):
    e = [error(bench, mass, observers, 'v', rate, np.ones_like) for rate in (50, 100, 200)]
    assert e[0] < 1e-4
    assert e[2] < e[1] / 3.7 < e[0] / 3.7**2  # readings are held on straight lines
    assert error(bench, mass, observers, 'a', 50, np.ones_like) < 1e-12


@pytest.mark.parametrize('command', [lambda t: np.sin(2 * t), lambda t: np.floor(2 * t) % 2.0],
                         ids=['moving', 'jumping'])
def test_commands_that_change_cost_half_a_step_of_what_the_reading_jumps(
        bench, mass, observers, command):
    # the reading jumps with the command at the end of a step; between, it is a straight line
    e = [error(bench, mass, observers, 'v', rate, command) for rate in (50, 100, 200)]
    gain = abs(-SPRING - (DRAG + SPEED) * SPEED) * SEEN / 2
    for rate, moving in zip((50, 100, 200), e):
        jumps = np.abs(np.diff(command(np.arange(SECONDS * rate + 1) / rate))).sum()
        assert moving < gain * jumps / rate
    assert error(bench, mass, observers, 'a', 50, command) < 1e-12
    assert e[2] < e[1] / 1.8 < e[0] / 1.8**2


@pytest.mark.parametrize('command', [lambda t: np.sin(2 * t), lambda t: np.floor(2 * t) % 2.0],
                         ids=['moving', 'jumping'])
def test_a_known_Cu_is_taken_out_before_readings_are_put_on_straight_lines(
        bench, mass, observers, command):
    known = replace(observers, Cu=mass.Cu)
    e = [error(bench, mass, known, 'v', rate, command) for rate in (50, 100, 200)]
    raw = error(bench, mass, observers, 'v', 50, command)
    assert e[0] < 1e-3 < raw / 20
    assert e[2] < e[1] / 3.5 < e[0] / 3.5**2  # as without commands
    assert error(bench, mass, known, 'a', 50, command) < 1e-12
    assert bench.design(*observers.virtual_sensors, names=mass.sensors).Cu is None


def test_readings_are_cleaned_anew_when_a_command_comes_late(bench, mass, observers):
    rng, banks = np.random.default_rng(0), [Bank(replace(observers, Cu=mass.Cu), 100)
                                            for _ in range(2)]
    commands = {0: 0.0, 203: 1.0, 517: -2.0, 521: 4.0}
    for now in range(0, 1000, 10):
        for late, bank in zip((0, 90), banks):
            for stamp, value in commands.items():
                if now - 10 < stamp + late * (stamp > 0) <= now:
                    assert bank.take('u1', stamp * MS, value) is None
        if now % 30 == 0:
            for name in ('a', 'p', 'v'):
                value = rng.normal()
                for bank in banks:
                    bank.take(name, max(0, now - 3) * MS, value)
        for bank in banks:
            bank.advance(now * MS)
    for name in ('a', 'v'):
        prompt, late = (bank.estimate((name,), name) for bank in banks)
        assert prompt == late is not None


def test_a_reading_is_cleaned_of_what_it_has_seen_at_its_stamp(mass, observers):
    bank = Bank(replace(observers, Cu=mass.Cu), 100)
    for stamp, u in ((0, 1.0), (998, -2.0)):
        bank.take('u1', stamp * MS, u)
    for stamp in (0, 400, 800, 996):
        bank.take('p', stamp * MS, 0.3 + SEEN)
        bank.take('v', stamp * MS, 0.2)
    bank.advance(1000 * MS)
    assert bank.estimate(('a',), 'a') == pytest.approx(-SPRING * 0.3 - DRAG * 0.2 - 2.0 * DRIVE)
    bank.take('p', 1004 * MS, 0.3 - 2.0 * SEEN)
    bank.take('v', 1004 * MS, 0.2)
    bank.advance(1000 * MS)
    assert bank.estimate(('a',), 'a') == pytest.approx(-SPRING * 0.3 - DRAG * 0.2 - 2.0 * DRIVE)


def test_commands_are_remembered_as_long_as_readings_that_have_seen_them(mass, observers):
    rng, banks = np.random.default_rng(0), [Bank(replace(observers, Cu=mass.Cu), 100)
                                            for _ in range(2)]
    for now in range(0, 4800, 10):
        u, p = rng.normal(size=2)
        for late, bank in zip((0, 1000), banks):
            bank.take('u1', now * MS, u)
            if now % 480 == 0:
                bank.take('p', now * MS, p)
            if now == 3020 + late:  # redoes all that can be redone
                bank.take('v', 3020 * MS, 1.0)
            bank.advance(now * MS)
    prompt, late = (bank.estimate(('v',), 'v') for bank in banks)
    assert prompt == late is not None


def test_one_that_needs_no_command_needs_none_when_readings_are_cleaned(bench):
    v = bench.virtual_sensor([[-1.0]], [[1.0]], inputs=('u',))  # all of u comes with y2
    design = replace(bench.design(v, inputs=('u',)), Cu=np.array([[0.0], [5.0]]))
    for u, most in ((None, 1e-12), (3.0, 1e-12)):
        bank = Bank(design, 100)
        if u is not None:
            bank.take('u', 0, u)
        for now in range(0, 1010, 10):
            bank.take('y2', now * MS, 2.0)
            bank.advance(now * MS)
        assert bank.estimate(('y1',), 'y1') == pytest.approx(2 * (1 - np.exp(-1)), abs=most)


def random_sensor(bench, seed, sample_time, seen, J_free):
    """Make two alike, the second for readings that have seen so much of the commands."""
    rng = np.random.default_rng(seed)
    N = rng.normal(size=(2, 2)) * 0.3 - 0.5 * np.eye(2)
    J = rng.normal(size=(2, 3)) * J_free
    B, Gz, Gy = rng.normal(size=(2, 2)), rng.normal(size=(2, 2)), rng.normal(size=(2, 3))
    P = np.array([[-1.0, 0.3], [0.0, 0.5]])
    Gz[0] = [1.0, 0.0]  # friction that brakes
    common = {'P': P, 'texts': ['sign(w1)', 'tanh(w1)*u2'], 'inputs': ('u1', 'u2'),
              'healthy': ('y2', 'y3', 'y4'), 'sample_time': sample_time,
              'Gz': [Gz[:1], Gz[1:]], 'Gy': [Gy[:1], Gy[1:]]}
    plain = bench.virtual_sensor(N, J, B=B, **common)
    direct = bench.virtual_sensor(N, J, B=B - J @ seen, Gu=(-Gy[:1] @ seen, -Gy[1:] @ seen),
                                  **common)
    return plain, direct


@pytest.mark.parametrize('sample_time', [None, 0.1])
@pytest.mark.parametrize('seed', range(5))
def test_arguments_are_as_if_the_reading_had_seen_nothing(bench, sample_time, seed):
    seen = np.array([[0.7, 0.0], [0.0, -1.3], [0.0, 0.0]])
    # continuous: without J, whose reading is no straight line where a command jumps
    plain, direct = random_sensor(bench, seed, sample_time, seen, J_free=sample_time is not None)
    names = ('y1', *plain.healthy)
    steps = [make_step([v], names, 0.1) for v in (plain, direct)]
    # beside one that reads no command, and has no term at all
    both = make_step([bench.virtual_sensor(
        [[-1.0]], [[1.0]], inputs=('u1', 'u2'), sample_time=sample_time), direct], names, 0.1)
    rng = np.random.default_rng(100 + seed)
    z = [np.array([[0.3, -0.2]])] * 2
    stack = np.array([[1.0, 0.0], [0.3, -0.2]])
    y, u = rng.normal(size=(41, 4)), rng.normal(size=(41, 2))
    direct_y = y.copy()
    direct_y[:, 1:] += u @ seen.T
    for k in range(40):
        held = (u[k], u[k], u[k], u[k], u[k + 1])
        z = [step(now, readings[k], readings[k + 1], *held)[0]
             for step, now, readings in zip(steps, z, (y, direct_y))]
        stack, _ = both(stack, direct_y[k], direct_y[k + 1], *held)
        np.testing.assert_allclose(z[1], z[0], atol=1e-11)
        np.testing.assert_allclose(stack[1:], z[1], atol=1e-12)
    assert np.abs(z[0]).max() > 1e-3


def test_what_stands_still_stays_exactly_where_its_argument_is_zero(bench):
    # z' = -sign(z + y - u): rests on u - y, which moves slower than friction can
    v = bench.virtual_sensor([[0.0]], [[0.0]], P=[[-1.0]], Gz=[[[1.0]]], Gy=[[[1.0]]],
                             Gu=(np.array([[-1.0]]),), texts=['sign(w1)'], inputs=('u',))
    step, none = make_step([v], ('y2',), 0.1), np.zeros(1)
    z = np.array([[0.4]])
    for k in range(60):
        y0, y1 = np.array([3.0 + 0.05 * k]), np.array([3.05 + 0.05 * k])
        held0, held1 = np.array([3.0]), np.array([3.0])
        z, _ = step(z, y0, y1, none, none, none, held0, held1)
        if k > 15:
            assert z[0, 0] == pytest.approx(3.0 - y1[0], abs=1e-14)
    assert z[0, 0] < -2.9


def test_a_command_read_by_the_output_alone_is_waited_for_and_counts_from_its_stamp(bench):
    v = bench.virtual_sensor(np.zeros((0, 0)), None, Q=[[2.0]], Qu=np.array([[0.0, 10.0]]),
                             inputs=('idle', 'u'))
    bank = Bank(bench.design(v, inputs=('idle', 'u')), 100)
    bank.take('y2', 0, 1.0)
    bank.advance(10 * MS)
    assert str(bank.why_not(('y1',), 'y1')) == 'no command of u yet'
    bank.take('u', 20 * MS, 1.0)
    bank.advance(20 * MS)
    assert bank.estimate(('y1',), 'y1') == 12.0
    bank.advance(30 * MS)
    assert bank.estimate(('y1',), 'y1') == 12.0
    bank.take('u', 35 * MS, 3.0)  # not yet at the state's time
    assert bank.estimate(('y1',), 'y1') == 12.0
    bank.advance(40 * MS)
    assert bank.estimate(('y1',), 'y1') == 32.0
    bank.advance(60 * MS)
    bank.take('u', 55 * MS, 5.0)  # late
    bank.advance(60 * MS)
    assert bank.estimate(('y1',), 'y1') == 52.0


@pytest.fixture
def wanted(bench):
    """Make one that is wanted with all healthy, one with y1 failed, and one of two rows."""
    return bench.design(
        bench.virtual_sensor([[-1.0]], [[1.0]]),
        bench.virtual_sensor([[-1.0]], [[2.0, 1.0]], fault_set=(), channel='v',
                             healthy=('y1', 'y2')),
        bench.virtual_sensor([[-1.0]], [[3.0]], channel='v'),
        bench.virtual_sensor([[-1.0, 0.0], [0.0, -2.0]], [[1.0, 0.0], [0.0, 1.0]], rows=2,
                             fault_set=(), channel='w', healthy=('y1', 'y2')),
        wanted=('v', 'w'))


def test_wanted_functionals_are_stepped(bench, wanted):
    bank = Bank(wanted, 100)
    ones = {'y1': np.ones(501), 'y2': np.ones(501)}
    for key, gain in ((((), 'v'), 3.0), ((('y1',), 'v'), 3.0), ((('y1',), 'y1'), 1.0)):
        found = bench.run(Bank(wanted, 100), key, 100, ones, {})
        np.testing.assert_allclose(found, gain * (1 - np.exp(-np.arange(501) / 100)), atol=1e-12)
    assert str(bank.why_not((), 'v')) == 'no reading of y1 yet'
    assert str(bank.why_not(('y2',), 'v')) == 'no design for v when y2 failed'
    assert str(bank.why_not((), 'y1')) == 'no design for y1 when nothing failed'
    assert bank.sensors == ('y1', 'y2')


def test_wanted_functionals_of_several_rows_are_left_out(bench, wanted):
    bank = Bank(wanted, 100)
    found = bench.run(bank, ((), 'w'), 100, {'y1': np.ones(5), 'y2': np.ones(5)}, {})
    assert np.isnan(found).all() and bank.started((), 'w') is None
    assert str(bank.why_not((), 'w')) == 'w has 2 rows; design one for each'
    assert bank.estimate((), 'v') is not None


def test_the_switch_decides_on_sensors_alone(wanted):
    switch = Switch.of(wanted)
    assert set(switch.decisions) == {'y1', 'y2'}
    asked = SimpleNamespace(ready=lambda *_: True, converges=lambda *_: False,
                            deviation=lambda *_: 0.1, why_not=lambda *_: None)
    switch = switch.isolate(('y1',), 5).decide(5, asked)
    assert {name: d.source for name, d in switch.decisions.items()} == {
        'y1': Source.VIRTUAL, 'y2': Source.REAL}
    with pytest.raises(KeyError, match='v: no such sensor'):
        switch.isolate(('v',), 6)
