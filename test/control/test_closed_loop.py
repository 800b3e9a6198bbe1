"""Closed loops against simulations, closed forms and another package."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from vsensor_ros import closed_loop, Controller, design, load_plant, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.control import load_controller, uncertainty
from vsensor_ros.functions.nonlinearity import evaluate
from vsensor_ros.lab.balance_controller import Law
from vsensor_ros.simulate.balance import load_balance

CONFIG = Path(__file__).parents[2] / 'config'
CART_POLE = CONFIG / 'cart_pole'
GAIN = [[-50.0, -34.2, -113.1, -21.6]]


@pytest.fixture(scope='module')
def cart():
    return load_plant(CART_POLE / 'plant.yaml')


@pytest.fixture(scope='module')
def carts(cart):
    """Return the design of the cart-pole."""
    return design(cart, [('angle', 'rate'), ('angle',), ('position',)])


class Bench:
    """A plant, virtual sensors and a controller in time: nothing of the code that it judges."""

    def __init__(self, plant, sensors, controller, hears=1.0):
        self.plant, self.sensors, self.controller, self.hears = plant, sensors, controller, hears
        self.sizes = np.cumsum([len(plant.states), *(s.order for s in sensors)])

    def told(self, state, u, noise=0.0):
        """Return what the controller reads of (x, z..), and what the virtual sensors read."""
        x, *z = np.split(state, self.sizes[:-1])
        real = self.plant.C @ x + self.plant.Cu @ u + noise
        said = real.copy()
        for sensor, own in zip(self.sensors, z):
            y0 = real[[self.plant.sensors.index(name) for name in sensor.healthy]]
            said[self.plant.sensors.index(sensor.channel)] = (
                sensor.Cv @ own + sensor.Q @ y0 + sensor.Qu @ u * self.hears)[0]
        return said[[self.plant.sensors.index(name) for name in self.controller.reads]]

    def moves(self, state, u, noise=0.0):
        """Return the rate of change of (x, z..)."""
        x, *z = np.split(state, self.sizes[:-1])
        real = self.plant.C @ x + self.plant.Cu @ u + noise
        rates = [self.plant.rate_of_change(x, u)]
        for sensor, own in zip(self.sensors, z):
            y0 = real[[self.plant.sensors.index(name) for name in sensor.healthy]]
            rates.append(sensor.N @ own + sensor.J @ y0 + sensor.B @ u * self.hears)
        return np.concatenate(rates)

    def law(self, s, y):
        """Return the command and the rate, or next value, of the controller's state."""
        c = self.controller
        return c.C @ s + c.D @ y, c.A @ s + c.B @ y

    def growth(self, duration):
        """Return the rate [1/s] at which a state grows in the second half of a run."""
        c, h = self.controller, self.controller.sample_time
        n, r, m = self.sizes[-1], len(c.A), len(self.plant.inputs)
        start = np.random.default_rng(1).standard_normal(n)
        if h is None:
            def rate(full):
                u, ds = self.law(full[n:], self.told(full[:n], np.zeros(m)))
                return np.concatenate([self.moves(full[:n], u), ds])
            by_state = np.array([rate(unit) for unit in np.eye(n + r)]).T  # all is linear
            times = np.linspace(0.0, duration, 801)
            run = solve_ivp(lambda _, x: by_state @ x, (0.0, duration),
                            np.concatenate([start, np.zeros(r)]), method='DOP853', rtol=1e-8,
                            atol=1e-300, t_eval=times)
            return slope(times, run.y.T)
        # what a period makes of each state and of each command that is held
        period = np.array([solve_ivp(
            lambda _, x, u: self.moves(x, u), (0.0, h), unit[:n], rtol=1e-11,
            atol=1e-13, args=(unit[n:],)).y[:, -1] for unit in np.eye(n + m)]).T
        state, s, states = start, np.zeros(r), []
        u = np.zeros(m)
        for _ in range(round(duration / h)):
            u, s = self.law(s, self.told(state, u))
            state = period @ np.concatenate([state, u])
            states.append(state)
        return slope(np.arange(len(states)) * h, states)


def slope(times, states):
    """Return at which rate [1/s] the size of states grows in the second half of the times."""
    half = len(times) // 2
    return np.polyfit(times[half:], np.log(np.linalg.norm(states, axis=1))[half:], 1)[0]


@pytest.mark.parametrize('sample_time', [None, 0.02])
def test_poles_are_those_with_healthy_sensors_and_of_n_while_the_model_is_right(
        cart, carts, sample_time):
    loop = closed_loop(cart, carts, Controller.gain(GAIN, cart.sensors, cart.inputs,
                                                    sample_time=sample_time))
    for lost in (('angle', 'rate'), ('angle',)):
        case = loop[lost]
        N = np.concatenate([carts[lost, name].eigenvalues for name in lost])
        N = N if sample_time is None else np.exp(N * sample_time)
        expected = np.concatenate([loop.healthy.poles, N])
        # of eigenvalues that stand together, their polynomial is well known, they are not
        assert np.allclose(np.poly(case.poles), np.poly(expected), rtol=1e-7)
        assert case.separate and case.verdict == 'stable'
    assert len(loop.healthy.poles) == 4


@pytest.mark.parametrize(('sample_time', 'share'), [(None, 0.03), (0.02, 0.05)])
def test_growth_at_the_worst_corner_is_that_of_a_simulation(cart, carts, sample_time, share):
    controller = Controller.gain(GAIN, cart.sensors, cart.inputs, sample_time=sample_time)
    shares = dict.fromkeys(('cart', 'pole', 'length'), share)
    case = closed_loop(cart, carts, controller, shares)['angle', 'rate']
    assert case.verdict == 'stable' and case.unstable_corners > 0 and not case.holds
    sensors = [carts[('angle', 'rate'), name] for name in ('angle', 'rate')]
    bench = Bench(cart.remake(case.worst.factors), sensors, controller)
    assert bench.growth(20.0) == pytest.approx(case.worst.growth, rel=0.01)
    # a little nearer than where it is said to become unstable there is no corner that grows
    for part, unstable in ((0.98, False), (1.02, True)):
        nearer = dict.fromkeys(shares, part * case.unstable_from * share)
        there = closed_loop(cart, carts, controller, nearer)['angle', 'rate']
        assert bool(there.unstable_corners) == unstable


def pole_and_zero(hinge=0.32, pole=0.249):
    """Return a cart-pole without friction: its pole falls at 5.2 1/s, beside a zero at 4.8."""
    moment, inertia, total = pole * hinge, 4.0 / 3.0 * pole * hinge**2, 1.0 + pole
    both = total * inertia - moment**2
    A = np.array([[0, 1, 0, 0], [0, 0, -9.81 * moment**2 / both, 0], [0, 0, 0, 1],
                  [0, 0, total * 9.81 * moment / both, 0]])
    B = np.array([0, inertia, 0, -moment]) / both
    return A, B


def test_a_certified_exact_virtual_sensor_in_an_unstable_loop():
    def remake(factors):
        A, B = pole_and_zero()
        return Plant.from_matrices(
            A, B * factors.get('motor', 1.0), np.eye(4), inputs=('force',), remake=remake,
            states=('position', 'speed', 'angle', 'rate'), noise=[3e-4, 0.01, 5e-4, 0.005],
            sensors=('position', 'speed', 'angle', 'rate'), process_noise=[0, 0.01, 0, 0.05],
            parameters={'motor': factors.get('motor', 1.0)})
    plant = remake({})
    assert np.linalg.eigvals(plant.A).real.max() == pytest.approx(5.2, abs=0.01)
    assert np.sqrt(3 * 9.81 / 4 / 0.32) == pytest.approx(4.8, abs=0.01)  # of force to position
    result = design(plant, [('angle', 'rate')])
    for name in ('angle', 'rate'):
        found = result[('angle', 'rate'), name]
        assert found.grade == 'exact' and found.certificate.status == 'global'
        assert found.eigenvalues.real.max() < 0.0
    controller = Controller.gain([[-50.0, -32.4, -115.1, -23.0]], plant.sensors, plant.inputs)
    loop = closed_loop(plant, result, controller, 'motor=2.1%')
    assert loop.healthy.holds and loop.healthy.peak < 2.0
    case = loop['angle', 'rate']
    # the sensitivity cannot be less than what pole and zero leave: |p + z| / |p - z|
    assert case.verdict == 'stable' and case.peak > 10.0 / 0.4
    assert case.worst.growth == pytest.approx(1.4, abs=0.2) and not case.holds
    bench = Bench(remake(case.worst.factors),
                  [result[('angle', 'rate'), name] for name in ('angle', 'rate')], controller)
    assert bench.growth(20.0) == pytest.approx(case.worst.growth, rel=0.02)


def test_what_no_reading_holds_is_good_for_a_time(cart, carts):
    controller = Controller.gain(GAIN, cart.sensors, cart.inputs, sample_time=0.01)
    case = closed_loop(cart, carts, controller, 'cart=10%,pole=10%')['position']
    assert case.verdict == 'for a time' and case.states == ('position',)
    assert case.unheld == pytest.approx([1.0])
    assert case.growth < -2.0 and case.noise is None and not case.unstable_corners


def motor(Cu=None, delay=0.0, **more):
    """Return speed and angle of a motor, each with a sensor."""
    return Plant.from_matrices(
        [[-2.0, 0.0], [1.0, 0.0]], [6.0, 0.0], np.eye(2), sensors=('tacho', 'angle'),
        states=('speed', 'angle'), inputs=('u',), noise=[0.3, 0.002],
        process_noise=[0.4, 0.0], Cu=Cu, input_delay=[delay], **more)


@pytest.mark.parametrize('sample_time', [None, 0.02])
def test_noise_of_the_command_is_that_of_a_simulation(sample_time):
    plant = motor()
    result = design(plant, [('tacho',)])
    vs = result['tacho', 'tacho']
    # slower than the readings, with a state of its own
    controller = Controller(('tacho', 'angle'), ('u',), [[-3.0]], [[-4.0, -6.0]], [[1.0]],
                            [[-0.3, -1.0]])
    if sample_time is not None:
        held = expm(np.array([[-3.0, 1.0], [0.0, 0.0]]) * sample_time)
        controller = replace(controller, A=[[held[0, 0]]], sample_time=sample_time,
                             B=held[0, 1] * np.array([[-4.0, -6.0]]))
    loop = closed_loop(plant, result, controller)
    for lost, sensors in (((), []), (('tacho',), [vs])):
        said = loop[lost].noise['u']
        assert said == pytest.approx(simulated_noise(plant, sensors, controller), rel=0.04)
    assert loop['tacho'].noise['u'] != pytest.approx(loop.healthy.noise['u'], rel=0.2)


def simulated_noise(plant, sensors, controller):
    """
    Return the deviation of the command in long runs of many loops side by side.

    Each reading errs anew. In a loop of samples a virtual sensor interpolates between them; in a
    continuous one all take the last one, of which there is one each 10 ms.
    """
    random, many, steps = np.random.default_rng(5), 200, 10
    bench = Bench(plant, sensors, controller)
    h = controller.sample_time or 0.01
    n, l0, none = bench.sizes[-1], len(plant.sensors), np.zeros(1)

    def matrix(f, width):  # all is linear
        return np.array([f(row) for row in np.eye(width)]).T
    F, J = matrix(lambda x: bench.moves(x, none), n), matrix(
        lambda e: bench.moves(np.zeros(n), none, e), l0)
    G = matrix(lambda u: bench.moves(np.zeros(n), u), 1)
    H, M = matrix(lambda x: bench.told(x, none), n), matrix(
        lambda e: bench.told(np.zeros(n), none, e), l0)
    dt = h / steps
    move = expm(np.block([[F, np.eye(n)], [np.zeros((n, 2 * n))]]) * dt)
    push = np.zeros((n, 1))
    push[:len(plant.states), 0] = plant.process_noise * np.sqrt(dt)

    def reading():
        return random.standard_normal((l0, many)) * plant.noise[:, None]
    x, s, total, count = np.zeros((n, many)), np.zeros((len(controller.A), many)), 0.0, 0
    now, after = reading(), reading()
    for k in range(800):
        u, ds = bench.law(s, H @ x + M @ now)
        if controller.sample_time is not None:
            s = ds
        if k > 300:
            total, count = total + np.sum(u**2), count + u.size
        for i in range(steps):
            error = now
            if controller.sample_time is None:
                u, ds = bench.law(s, H @ x + M @ now)
                s = s + dt * ds
            else:
                error = now + (after - now) * (i + 0.5) / steps
            x = move[:n, :n] @ x + move[:n, n:] @ (G @ u + J @ error) \
                + push * random.standard_normal((n, many))
        now, after = after, reading()
    return np.sqrt(total / count)


def test_sensitivity_is_that_of_another_package(cart, carts):
    control = pytest.importorskip('control')
    from control import ss
    for h in (None, 0.02):
        controller = Controller(
            cart.sensors, cart.inputs, [[-0.2 if h else -40.0]], [[10.0, 5.0, 20.0, 4.0]],
            [[1.0 if h else 60.0]], [[20.0, 20.0, 60.0, 10.0]], h)
        case = closed_loop(cart, carts, controller).healthy
        assert case.verdict == 'stable'
        plant = ss(cart.A, cart.B, cart.C, np.zeros((4, 1)))
        plant = plant if h is None else control.sample_system(plant, h, 'zoh')
        law = ss(controller.A, controller.B, controller.C, controller.D,
                 *(() if h is None else (h,)))
        S = control.feedback(ss([], [], [], [[1.0]], *(() if h is None else (h,))), law * plant,
                             sign=1)
        omega = np.geomspace(1e-2, 1e3 if h is None else np.pi / h, 20_000)
        z = 1j * omega if h is None else np.exp(1j * omega * h)
        inner = np.linalg.solve(z[:, None, None] * np.eye(len(S.A)) - S.A, S.B[None] + 0j)
        sizes = np.abs(S.C @ inner + S.D)[:, 0, 0]
        peak, at = case.sensitivity['force']
        assert peak == pytest.approx(sizes.max(), rel=1e-4)
        assert at == pytest.approx(omega[np.argmax(sizes)], rel=1e-2)
        assert np.allclose(np.sort_complex(S.poles()), np.sort_complex(case.poles), atol=1e-6)


def test_sensitivity_by_hand():
    # P = 1/s, K = k/(s + a): S = s (s + a) / (s^2 + a s + k)
    plant = Plant.from_matrices([[0.0]], [1.0], [[1.0]])
    a, k = 2.0, 9.0
    controller = Controller(('y1',), ('u1',), [[-a]], [[-k]], [[1.0]], [[0.0]])
    loop = closed_loop(plant, design(plant), controller)
    s = 1j * np.linspace(0.01, 50.0, 500_000)
    assert loop.healthy.peak == pytest.approx(
        np.abs(s * (s + a) / (s**2 + a * s + k)).max(), rel=1e-5)
    assert np.sort_complex(loop.healthy.poles) == pytest.approx(np.sort_complex(
        np.roots([1.0, a, k])))


def test_sensitivity_counts_what_the_virtual_sensor_hears():
    """The sensitivity with a virtual sensor is |1 + L|^-1 of the plant and what reads the rest."""
    plant = motor()
    result = design(plant, [('tacho',)])
    vs = result['tacho', 'tacho']
    kt, ka = 0.7, 3.0
    loop = closed_loop(plant, result, Controller.gain([[kt, ka]], plant.sensors, plant.inputs))
    omega = np.geomspace(0.01, 1e4, 3_000)
    sizes = []
    for s in 1j * omega:
        angle = 6.0 / (s * (s + 2.0))
        inner = np.linalg.inv(s * np.eye(vs.order) - vs.N)
        of_angle = (vs.Cv @ inner @ vs.J + vs.Q)[0, 0]
        of_u = (vs.Cv @ inner @ vs.B + vs.Qu)[0, 0]
        law = (kt * of_angle + ka) / (1.0 + kt * of_u)
        sizes.append(abs(1.0 / (1.0 + law * angle)))
    assert loop['tacho'].peak == pytest.approx(max(sizes), rel=1e-3)


def test_dead_time_between_samples_is_exact():
    """An integrator whose input acts 1.4 samples later, against a run and a polynomial."""
    h, late, k = 0.1, 0.14, 4.0
    plant = Plant.from_matrices([[0.0]], [1.0], [[1.0]], input_delay=[late])
    loop = closed_loop(plant, design(plant), Controller.gain([[k]], ('y1',), ('u1',),
                                                             sample_time=h))
    # x+ = x + (h - 0.04) u(-1) + 0.04 u(-2), u = -k x
    expected = np.roots([1.0, -1.0, k * (h - 0.04), k * 0.04])
    poles = loop.healthy.poles
    assert np.sort_complex(poles[np.abs(poles) > 1e-9]) == pytest.approx(
        np.sort_complex(expected))
    with pytest.raises(BadInput, match='sample_time: is missing, and the plant has dead times'):
        closed_loop(plant, design(plant), Controller.gain([[k]], ('y1',), ('u1',)))


@pytest.mark.parametrize(('late', 'Cu'), [
    (0.03, None), (0.1, None), (0.05, [[0.5], [0.0]]), (0.12, [[0.5], [0.0]])])
def test_readings_that_are_late_are_as_good_as_a_command_that_is(late, Cu):
    """In a loop around one command it does not matter where the dead time is."""
    h, loops = 0.05, []
    for more in ({'sensor_delay': [late, late]}, {'input_delay': [late]}):
        plant = replace(motor(Cu), **{name: np.array(of) for name, of in more.items()})
        controller = Controller.gain([[0.4, 2.0]], plant.sensors, plant.inputs, sample_time=h)
        loops.append(closed_loop(plant, design(plant, [('tacho',)]), controller))
    reading, command = loops
    for of in ((), ('tacho',)):
        first, second = ([pole for pole in loop[of].poles if abs(pole) > 1e-3] for loop in loops)
        assert np.poly(first) == pytest.approx(np.poly(second), abs=1e-9)
        assert reading[of].peak == pytest.approx(command[of].peak, rel=1e-5)
    assert reading.healthy.noise['u'] == pytest.approx(command.healthy.noise['u'], rel=1e-6)
    assert reading['tacho'].noise['u'] == pytest.approx(command['tacho'].noise['u'], rel=0.02)
    later = replace(motor(), sensor_delay=np.array([0.0, late]))
    case = closed_loop(later, design(later, [('tacho',)]), controller)['tacho']
    assert case.verdict == 'not closed' and 'reads angle, which tells of an earlier' in case.reason
    with pytest.raises(BadInput, match='sample_time: is missing, and the plant has dead times'):
        closed_loop(later, design(later, [('tacho',)]), replace(controller, sample_time=None))


@pytest.mark.parametrize('delay', [0.0, 0.02, 0.05])
def test_a_sampled_plant_is_its_continuous_original(delay):
    """Poles and noise of a plant that was discretised before, also in every other sample."""
    h, K = 0.02, [[0.5, 2.0]]
    plant = motor(delay=delay)
    both = expm(np.block([[plant.A, plant.B], [np.zeros((1, 3))]]) * h / 2)
    A, B = both[:2, :2], both[:2, 2:]
    step = Plant.from_matrices(A, B, np.eye(2), sensors=plant.sensors, inputs=plant.inputs,
                               sample_time=h / 2, input_delay=[delay], noise=plant.noise,
                               process_noise=[0.0, 0.0])
    controller = Controller.gain(K, plant.sensors, plant.inputs, sample_time=h)
    original = closed_loop(replace(plant, process_noise=np.zeros(2)), design(replace(
        plant, process_noise=np.zeros(2)), [('tacho',)]), controller).healthy
    sampled = closed_loop(step, design(step, [('tacho',)]), controller).healthy
    assert np.poly(sampled.poles) == pytest.approx(np.poly(original.poles), abs=1e-9)
    assert sampled.peak == pytest.approx(original.peak, rel=1e-6)
    assert sampled.noise['u'] == pytest.approx(original.noise['u'], rel=1e-6)


@pytest.mark.parametrize('every', [1, 3])
def test_noise_of_a_sampled_plant_is_that_of_a_simulation(every):
    """The virtual sensor takes in each reading, the controller each so manieth."""
    plant = Plant.from_matrices([[0.9, 0.0], [0.1, 1.0]], [0.3, 0.0], np.eye(2), sample_time=0.05,
                                sensors=('tacho', 'angle'), inputs=('u',), noise=[0.3, 0.02],
                                process_noise=[0.03, 0.0])
    result = design(plant, [('tacho',)])
    vs = result['tacho', 'tacho']
    controller = Controller.gain([[0.4, 0.5]], plant.sensors, plant.inputs,
                                 sample_time=0.05 * every)
    said = closed_loop(plant, result, controller)['tacho'].noise['u']
    random, many = np.random.default_rng(3), 2000
    x, z = np.zeros((2, many)), np.zeros((vs.order, many))
    total, count = 0.0, 0
    for k in range(600):
        y = x + plant.noise[:, None] * random.standard_normal((2, many))
        if k % every == 0:
            told = vs.Cv @ z + vs.Q @ y[1:]
            u = -0.4 * told - 0.5 * y[1:]
            if k > 200:
                total, count = total + np.sum(u**2), count + many
        z = vs.N @ z + vs.J @ y[1:] + vs.B @ u
        x = plant.A @ x + plant.B @ u + plant.process_noise[:, None] * random.standard_normal(
            (2, many))
    assert said == pytest.approx(np.sqrt(total / count), rel=0.02)


def test_a_reading_of_the_command_is_that_of_the_command_before():
    """A torque that a sensor reads directly: when it is sampled, the new command is not there."""
    plant = motor(Cu=[[0.5], [0.0]])
    result = design(plant, [('angle',)])
    k = [0.4, 2.0]
    continuous = closed_loop(plant, result, Controller.gain([k], plant.sensors, plant.inputs))
    own = plant.A - plant.B @ np.array([k]) / (1.0 + 0.4 * 0.5)
    assert np.sort_complex(continuous.healthy.poles) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(own)))
    h = 0.1
    sampled = closed_loop(plant, result, Controller.gain([k], plant.sensors, plant.inputs,
                                                         sample_time=h)).healthy
    both = expm(np.block([[plant.A, plant.B], [np.zeros((1, 3))]]) * h)
    law = np.array([[-0.4, -2.0, -0.2]])  # of x and of the command that is in the reading
    step = np.vstack([np.hstack([both[:2, :2], np.zeros((2, 1))]) + both[:2, 2:] @ law, law])
    assert np.sort_complex(sampled.poles) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(step)))
    hopeless = Controller.gain([[-2.0, 2.0]], plant.sensors, plant.inputs)
    case = closed_loop(plant, result, hopeless).healthy
    assert case.verdict == 'not closed' and 'depends on itself' in case.reason


def test_a_command_that_is_not_heard_breaks_the_separation(cart, carts):
    more = {'reads': cart.sensors, 'writes': cart.inputs}
    deaf = Controller.gain(GAIN, **more, unheard=('force',))
    case = closed_loop(cart, carts, deaf)['angle',]
    heard = closed_loop(cart, carts, Controller.gain(GAIN, **more))['angle',]
    assert heard.separate and heard.verdict == 'stable' and not case.separate
    assert np.poly(case.poles) != pytest.approx(np.poly(heard.poles), rel=1e-3)
    bench = Bench(cart, [carts['angle', 'angle']], deaf, hears=0.0)
    if case.verdict == 'unstable':
        assert bench.growth(200.0) == pytest.approx(case.growth, rel=0.02)
    else:
        assert bench.growth(6.0) < 0.0


def test_only_what_the_controller_reads_is_replaced(cart, carts):
    controller = Controller.gain([GAIN[0][:2] + GAIN[0][3:]], ('position', 'speed', 'rate'),
                                 cart.inputs)
    case = closed_loop(cart, carts, controller)['angle',]
    assert case.unread and len(case.poles) == 4


def test_what_cannot_be_replaced_is_not_closed():
    plant = load_plant(CONFIG / 'servo' / 'plant.yaml')
    result = design(plant, [('y1',), ('y2',)])
    controller = load_controller(CONFIG / 'servo' / 'controller.yaml', plant)
    loop = closed_loop(plant, result, controller, 'k3=10%,k6=10%')
    assert loop['y1'].verdict == 'not replaced' and 'y1' in loop['y1'].reason
    assert loop['y2'].holds and loop.healthy.holds
    assert loop.left_out == ('sign(velocity)',)
    # the transfer matrix by hand, beside the linear servo without friction
    h, kp, half, kd = 0.05, 2.0, 0.025, 2.0
    both = expm(np.block([[plant.A, plant.B], [np.zeros((1, 4))]]) * h)
    # states: plant, integral of the trapezoids
    law = np.array([-kp - half, -kd, 0.0, 1.0])
    step = np.zeros((4, 4))
    step[:3] = np.hstack([both[:3, :3], np.zeros((3, 1))]) + both[:3, 3:] * law
    step[3] = [-2.0 * half, 0.0, 0.0, 1.0]
    assert np.sort_complex(loop.healthy.poles) == pytest.approx(
        np.sort_complex(np.linalg.eigvals(step)))


def test_terms_without_a_slope_are_named():
    plant = Plant.from_matrices(
        [[-1.0]], [1.0], [[1.0]], P=np.ones((1, 5)), G=[[[1.0]]] * 5, nonlinearities=[
            'w1*abs(w1)', 'abs(w1)', 'sign(w1)', 'sqrt(w1)', 'tanh(3*w1)'])
    result = design(plant)
    loop = closed_loop(plant, result, Controller.gain([[1.0]], ('y1',), ('u1',)))
    assert loop.left_out == ('abs(x1)', 'sign(x1)', 'sqrt(x1)')
    assert loop.healthy.poles == pytest.approx([1.0])  # -1 - 1 + 3


def test_nonlinear_plants_are_closed_about_the_operating_point():
    """Poles against difference quotients of the equations themselves, the observer's too."""
    plant = load_plant(CONFIG / 'three_tank' / 'plant.yaml')
    result = design(plant, [('y2',)])
    vs = result['y2', 'y2']
    assert vs.active
    K = np.array([[0.4, 0.3], [-0.2, 0.5]])
    assert plant.sensors == ('y1', 'y2')
    loop = closed_loop(plant, result, Controller.gain(K, plant.sensors, plant.inputs))
    assert not loop.linear
    x0, u0, n = plant.operating_point, plant.operating_input, len(plant.states)

    def observer(z, y0, u):
        rate = vs.N @ z + vs.J @ y0 + vs.B @ u
        for i in vs.active:
            w = vs.Gz[i] @ z + vs.Gy[i] @ y0 + vs.Gu[i] @ u
            rate = rate + vs.P[:, i] * evaluate(vs.terms[i], w, plant.inputs, u)
        return rate

    def rate(full, replaced):
        x, z = full[:n], full[n:]
        y = plant.C @ x
        if replaced:
            y[1] = (vs.Cv @ z + vs.Q @ y[:1])[0]
        u = u0 - K @ (y - plant.C @ x0)
        return np.concatenate([plant.rate_of_change(x, u), observer(z, y[:1], u)])
    start, step = np.concatenate([x0, vs.Phi @ x0]), 1e-6
    for case, replaced, count in ((loop.healthy, False, n), (loop['y2'], True, len(start))):
        slopes = np.array([(rate(start + step * unit, replaced) - rate(
            start - step * unit, replaced)) / (2.0 * step) for unit in np.eye(len(start))]).T
        assert np.sort_complex(case.poles) == pytest.approx(np.sort_complex(
            np.linalg.eigvals(slopes[:count, :count])), abs=1e-6)
    assert loop['y2'].separate


@pytest.mark.parametrize('folder', ['cart_pole', 'servo'])
def test_the_controllers_that_are_shipped(folder):
    plant = load_plant(CONFIG / folder / 'plant.yaml')
    controller = load_controller(CONFIG / folder / 'controller.yaml', plant)
    loop = closed_loop(plant, design(plant, [plant.sensors[1:2]]), controller, dict.fromkeys(
        list(plant.parameters)[:3], 0.1))
    assert all(case.holds for case in loop.cases) and loop.healthy.peak < 3.0


def test_the_cart_poles_controller_is_that_of_the_demo(cart):
    controller = load_controller(CART_POLE / 'controller.yaml', cart)
    K = Law.of(cart, load_balance(CART_POLE / 'demo.yaml', cart)).K
    assert np.allclose(controller.A, -K[:, 4:], rtol=1e-4)
    assert np.allclose(controller.B, -K[:, :4], rtol=1e-4)
    assert controller.sample_time == 0.01


def test_separation_is_not_claimed_of_another_plant(cart, carts):
    with pytest.raises(BadInput, match='is the design of another plant'):
        closed_loop(motor(), carts, Controller.gain([[1.0, 1.0]], ('tacho', 'angle'), ('u',)))


def test_many_corners_are_drawn_with_a_fixed_seed(monkeypatch):
    monkeypatch.setattr(uncertainty, 'MOST_CORNERS', 32)
    names = [f'k{i}' for i in range(12)]

    def remake(factors):
        return Plant.from_matrices(
            -np.diag([1.0 + i * factors.get(name, 1.0) for i, name in enumerate(names)]),
            np.ones(12), np.eye(12), remake=remake,
            parameters={name: factors.get(name, 1.0) for name in names})
    plant = remake({})
    result = design(plant, [('y1',)])
    controller = Controller.gain([[1.0]], ('y2',), ('u1',))
    loops = [closed_loop(plant, result, controller, '10%') for _ in range(2)]
    first, again = loops
    assert (first.all_corners, first.corners) == (4096, 32)
    assert first.healthy.worst == again.healthy.worst
    assert len(first.healthy.corner_poles) == 32


def test_results_are_frozen(cart, carts):
    loop = closed_loop(cart, carts, Controller.gain(GAIN, cart.sensors, cart.inputs))
    for thing, name in product((loop, loop.healthy), ('cases', 'verdict')):
        with pytest.raises(AttributeError):
            setattr(thing, name, None)
    with pytest.raises(KeyError, match='no such fault set'):
        loop['speed']
