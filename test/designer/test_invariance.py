"""What a design does not depend on: sample time, strangers, units, the order of the states."""

from dataclasses import replace

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from vsensor_ros import design, load_plant, Plant
from vsensor_ros.designer.natural_size import couplings, natural_sizes, reaches
from vsensor_ros.observers import VirtualSensor

MOTOR = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 1.0], [0.0, 0.0, -20.0]])  # angle, speed, drive


def sampled(A, B, C, h, **more):
    """Return a plant as it is with commands held between samples of h seconds."""
    n, m = B.shape
    moved = expm(h * np.block([[A, B], [np.zeros((m, n + m))]]))
    return Plant.from_matrices(moved[:n, :n], moved[:n, n:], C, sample_time=h, **more)


@st.composite
def matrices(draw):
    """Draw stable A (n, n), B (n, 1), C (2, n), and the noise of two sensors."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(2, 4))
    A = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.6)
    A = A - (max(np.linalg.eigvals(A).real.max(), 0.0) + rng.uniform(0.1, 1.0)) * np.eye(n)
    B, C = rng.normal(size=(n, 1)), np.eye(n)[rng.permutation(n)[:2]]
    return A, B, C, 10**rng.uniform(-3, -1, 2)


def compare(one, other, noise=1.1, unit=None):
    """
    Compare two designs of the same thing, whose readings are in other units by ``unit`` (l,).

    What is least for all is the same; what a descent found may differ a little.
    """
    for i, (mine, theirs) in enumerate(pairs(one, other)):
        size = 1.0 if unit is None else unit[i]
        assert mine.order == theirs.order and mine.proof.lower == theirs.proof.lower
        assert (mine.reads, mine.commands) == (theirs.reads, theirs.commands)
        assert 1 / noise < theirs.noise.error / size / mine.noise.error < noise
        assert 1 / noise < theirs.noise.floor / size / mine.noise.floor < noise
        assert 1 / noise < theirs.decay / mine.decay < noise


def pairs(one, other):
    """Yield the exact virtual sensors of two designs, which refuse the same channels."""
    for mine, theirs in zip(one.entries.values(), other.entries.values(), strict=True):
        assert type(mine) is type(theirs)
        if isinstance(mine, VirtualSensor) and mine.grade == 'exact':
            yield mine, theirs


@pytest.mark.parametrize('h', [0.01, 0.0025, 1e-4])
def test_a_sampled_motor_is_tuned_as_the_motor(h):
    B, C, noise = np.eye(3)[:, 2:], np.eye(3)[:2], [1e-4, 0.01]
    v = design(sampled(MOTOR, B, C, h, noise=noise), [('y2',)])['y2', 'y2']
    rates = np.sort(-np.log(v.eigenvalues.real) / h)
    np.testing.assert_allclose(rates, [3.02, 20.0], rtol=0.01)
    assert v.noise.error == pytest.approx(9.6e-4, rel=0.05) and v.reads == ('y1',)


@settings(max_examples=6)
@given(matrices(), st.floats(-4.0, -1.0))
def test_a_sampled_plant_is_tuned_as_its_continuous_original(drawn, exponent):
    """
    The floor, the healthy sensors and, where it is alike, the design do not depend on h.

    Between samples a state has a share in what others do, so that an observer of low order that
    leaves one out may be lost: then both are within the factor of two of the best, and the faster
    one is not the quieter, too.
    """
    A, B, C, noise = drawn
    h = 10**exponent / np.abs(np.linalg.eigvals(A)).max()
    for mine, theirs in pairs(design(Plant.from_matrices(A, B, C, noise=noise)),
                              design(sampled(A, B, C, h, noise=noise))):
        assert 1 / 1.1 < theirs.noise.floor / mine.noise.floor < 1.1
        assert mine.reads == theirs.reads and 0.5 < theirs.noise.error / mine.noise.error < 2.0
        quieter, faster = theirs.noise.error < mine.noise.error, theirs.decay > mine.decay
        assert quieter != faster or all(1 / 1.3 < ratio < 1.3 for ratio in (
            theirs.noise.error / mine.noise.error, theirs.decay / mine.decay))
    modes = couplings(sampled(A, B, C, h)).mean_rate
    assert modes == pytest.approx(couplings(Plant.from_matrices(A, B, C)).mean_rate, rel=1e-6)


@pytest.mark.slow
@settings(max_examples=6)
@given(matrices(), st.integers(0, 2**31))
def test_units_do_not_matter(drawn, seed):
    A, B, C, noise = drawn
    rng = np.random.default_rng(seed)
    x, u, y = (10.0**rng.integers(-6, 7, count) for count in (len(A), 1, 2))
    compare(design(Plant.from_matrices(A, B, C, noise=noise)),
            design(Plant.from_matrices(A * x[:, None] / x, B * x[:, None] / u, C / x * y[:, None],
                                       noise=noise * y)), unit=y)


@pytest.mark.slow
@settings(max_examples=6)
@given(matrices(), st.integers(0, 2**31))
def test_the_order_of_the_states_does_not_matter(drawn, seed):
    A, B, C, noise = drawn
    other = np.random.default_rng(seed).permutation(len(A))
    compare(design(Plant.from_matrices(A, B, C, noise=noise)), design(Plant.from_matrices(
        A[np.ix_(other, other)], B[other], C[:, other], noise=noise)))


@settings(max_examples=6)
@given(matrices())
def test_strangers_change_nothing(drawn):
    """States with sensors of their own, before and after, with terms and unknown inputs."""
    A, B, C, noise = drawn
    n = len(A)
    alone = design(Plant.from_matrices(A, B, C, noise=noise))
    with_strangers = design(Plant.from_matrices(
        block_diag(-300.0, A, -0.01), np.vstack([[0.0], B, [7.0]]),
        block_diag([[5.0]], C, [[1.0]]), D=np.eye(n + 2)[:, :1], noise=[1.0, *noise, 1e-6],
        P=np.eye(n + 2)[:, :1], G=[np.eye(n + 2)[:1]], nonlinearities=['sin(w1)'],
        sensors=['first', 'y1', 'y2', 'last']), [('y1',), ('y2',)])
    for mine, theirs in zip(alone.entries.values(), with_strangers.entries.values()):
        assert type(mine) is type(theirs)
        if isinstance(mine, VirtualSensor):
            assert theirs.reads == mine.reads and theirs.healthy[0] == 'first'
            np.testing.assert_array_equal(theirs.Phi[:, 1:-1], mine.Phi)
            np.testing.assert_array_equal(theirs.J[:, 1:-1], mine.J)
            np.testing.assert_array_equal(theirs.N, mine.N)
            assert not theirs.P.any() and theirs.noise == mine.noise


def test_what_reads_the_channel_is_no_stranger():
    """The temperature, which rises with the speed, tells it."""
    A = np.array([[-0.5, 0, 0], [2.0, -0.1, 0], [0, 1.0, -0.2]])
    plant = Plant.from_matrices(A, [1, 0, 0], np.eye(3), noise=[0.01, 0.01, 0.01],
                                states=['speed', 'temperature', 'casing'])
    both = design(plant, [('y1',), ('y1', 'y2', 'y3')])
    assert 'y2' in both['y1', 'y1'].reads
    alone = both[('y1', 'y2', 'y3'), 'y1']
    assert alone.order == 1 and alone.Phi.tolist() == [[1.0, 0.0, 0.0]]
    assert alone.fault_set == ('y1', 'y2', 'y3') and not alone.reads


def test_terms_and_regions_of_a_part_are_those_of_the_whole():
    """A glider with a stranger before it, whose term comes first: indices must be told apart."""
    names = ['oven', 'climb', 'pitch', 'rate']
    A = [[-1.0, 0, 0, 0], [0, -1.5, 20, 0], [0, 0, 0, 1], [0, 0, 0, -2]]
    P, G = np.array([[1.0, 0], [0, 20.0], [0, 0], [0, 0]]), [np.eye(4)[0], np.eye(4)[2]]
    more = {'states': names, 'sensors': ['thermo', 'vario', 'ahrs', 'gyro']}
    plant = Plant.from_matrices(
        A, None, np.eye(4), P=P, G=G, nonlinearities=['cos(w1)', 'sin(w1) - w1'],
        noise=[1.0, 0.2, 0.01, 0.01], **more)
    v = design(plant, [('ahrs',)])['ahrs', 'ahrs']
    assert v.active == (1,) and v.Phi.shape[1] == 4 and v.healthy == ('thermo', 'vario', 'gyro')
    assert v.reads == ('vario', 'gyro') and len(v.Gz) == 2
    (name, low, high), = v.region
    assert name == 'pitch' and -low == high > 0.5


@pytest.mark.parametrize('height', [0.0, 1500.0])
def test_the_box_is_made_of_each_state_s_own_reach(height):
    """Whether a state far off, such as the height, is large says nothing of another one."""
    plant = Plant.from_matrices(
        [[0, 1, 0], [0, -1, 1], [0, 0, -2]], [0, 0, 4.0], np.eye(3), noise=[0.5, 0.2, np.nan],
        operating_point=[height, 0, 0], ranges=[[-np.inf, np.inf]] * 2 + [[-3, 5.0]])
    states, inputs = reaches(plant)
    assert states.tolist() == [height or 50.0, 20.0, 4.0]
    assert inputs == reaches(replace(plant, operating_point=np.zeros(3)))[1]


def test_natural_sizes_are_what_steady_state_makes_them():
    """A command of 4 V: a lag of gain 2 goes to 8, one behind it of gain 1/4 to 2."""
    plant = Plant.from_matrices([[-1e-3, 0], [0.25, -1.0]], [2e-3, 0], [[0, 1]],
                                operating_input=[4.0])
    sizes = natural_sizes(plant, [0], [], np.zeros((0, 2)))
    assert sizes[0] / sizes[1] == pytest.approx(4.0) and 0.1 < sizes[0] / 8.0 < 1.0
    given = natural_sizes(replace(plant, noise=np.array([0.5])), [0], [], np.zeros((0, 2)))
    np.testing.assert_allclose(given, [200.0, 50.0])
    ranged = natural_sizes(replace(plant, ranges=np.array([[-np.inf, np.inf], [0.0, 6.0]])), [0],
                           [], np.zeros((0, 2)))
    np.testing.assert_allclose(ranged, [12.0, 3.0])


@pytest.mark.parametrize('per', ['s', 'min', 'h'])
def test_the_unit_of_time_decides_nothing(tmp_path, per):
    """At the end of its range b neither grows nor dies out, but for rounding."""
    seconds = {'s': 1, 'min': 60, 'h': 3600}[per]
    path = tmp_path / 'plant.yaml'
    path.write_text(f"""
name: tanks
time: continuous
time_unit: {per}
parameters: {{s: {seconds}}}
states:
  a: {{range: [0, 4], process_noise: 0.02*sqrt(s)}}
  b: {{range: [0, 4], process_noise: 0.02*sqrt(s)}}
inputs: {{u: {{operating: 1, range: [0.5, 2]}}}}
operating_point: {{a: 1, b: 1}}
dynamics: {{a: 0.5*s*(u - a), b: 0.2*s*(a - b*sqrt(b))}}
sensors: {{ya: {{measures: a, noise: 0.01}}, yb: {{measures: b, noise: 0.01}}}}
""")
    found = design(load_plant(path), [('yb',)])[('yb',), 'yb']
    assert found.decay == pytest.approx(0.3) and found.order == 1
    assert 'unstable' not in found.certificate.uncovered


@pytest.mark.slow
def test_units_and_order_do_not_decide_among_what_holds_in_the_same_region():
    """Levels in a row of tanks, in units of their own and in another order."""
    n, rng = 5, np.random.default_rng(1)
    G, P = np.eye(n) - np.eye(n, k=1), 40.0 * (np.eye(n, k=-1) - np.eye(n))

    def designed(x, y, order):
        return design(Plant.from_matrices(
            (P @ G * x[:, None] / x)[np.ix_(order, order)], 40.0 * np.eye(n)[order, :1] * x[0],
            np.diag(y / x)[:, order], P=(P * x[:, None])[order], G=list((G / x)[:, order]),
            nonlinearities=['sqrt(w1) - w1'] * n, initial=(np.arange(n, 0.0, -1.0) * x)[order],
            noise=0.01 * y), [('y1',), ('y3',)])

    one = designed(np.ones(n), np.ones(n), np.arange(n))
    x, y = 10.0**rng.integers(-2, 3, (2, n))
    compare(one, designed(x, y, rng.permutation(n)), unit=y[[0, 2]])
    assert [v.reads for v in one.virtual_sensors] == [('y2',), ('y2', 'y4')]
