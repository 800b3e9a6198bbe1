"""Virtual sensors that their channel tracks, and how they drift off: against simulated noise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vsensor_ros import Design, design, load_plant, Plant, Refusal
from vsensor_ros.designer.slow import unlearnt
from vsensor_ros.observers import deviation_after, horizon
from vsensor_ros.observers.kinds.functional.convergence import converge
from vsensor_ros.observers.kinds.functional.discretise import phi_functions
from vsensor_ros.observers.kinds.functional.tracking import tracker

BASE = Path(__file__).parents[2] / 'config/base/plant.yaml'
INTERVAL = 0.01  # s, between readings
FINER = 3  # steps of the truth between two of them


def joint():
    """Make an encoder beside a tacho."""
    return Plant.from_matrices(
        [[0, 1], [0, -4]], [0, 8], np.eye(2), states=('angle', 'velocity'),
        sensors=('encoder', 'tacho'), noise=[0.0005, 0.005], process_noise=[0, 0.2])


def base():
    """Make x, y and heading of a base that drives straight, its speed and its yaw rate."""
    A = np.zeros((5, 5))
    A[0, 3], A[1, 2], A[2, 4], A[3, 3], A[4, 4] = 1, 0.5, 1, -2, -3
    B = np.zeros((5, 2))
    B[3, 0], B[4, 1] = 2, 3
    names = ('x', 'y', 'heading', 'speed', 'yaw_rate')
    return Plant.from_matrices(A, B, np.eye(5), states=names, sensors=names,
                               noise=[0.02, 0.02, 0.01, 0.01, 0.01],
                               process_noise=[0, 0, 0, 0.1, 0.1])


def drive(**more):
    """Make a drive with dry friction and a position sensor, and no other."""
    return Plant.from_matrices(
        [[0, 1], [0, -2.2]], [0, 0.35], [1, 0], P=[0, -0.2], G=[[0, 1]],
        nonlinearities=['sign(w1)'], states=('position', 'velocity'), sensors=('position',),
        noise=[1e-5], process_noise=[0, 0.02], **more)


def pendulum():
    """Make a pendulum that falls, and a drive that does not tell how it stands."""
    return Plant.from_matrices(
        [[0, 1, 0], [9, -0.5, 0], [0, 0, -3]], [0, 1, 1], [[1, 0, 0], [0, 0, 1]],
        states=('angle', 'rate', 'current'), sensors=('angle', 'current'), noise=[0.001, 0.01],
        process_noise=[0, 0.05, 0.1])


def masses():
    """Make two masses on a spring; the speed of the second is told."""
    A = [[0, 1, 0, 0], [-50, -1, 50, 0], [0, 0, 0, 1], [50, 0, -50, -1]]
    return Plant.from_matrices(A, None, [[1, 0, 0, 0], [0, 0, 0, 1]], noise=[0.001, 0.01],
                               process_noise=[0, 0.3, 0, 0.3])


def stepwise():
    """Make a plant in steps of 0.1 s, with a counter of what a flow meter says."""
    return Plant.from_matrices([[1, 0.1], [0, 0.9]], [0, 0.1], np.eye(2), sample_time=0.1,
                               sensors=('level', 'flow'), noise=[0.02, 0.01],
                               process_noise=[0.001, 0.05])


def temporary(plant, fault_set, channel):
    found = design(plant, [fault_set])[fault_set, channel]
    assert found.grade == 'temporary' and found.certificate is None and found.noise is None
    return found


@pytest.mark.parametrize('plant, fault_set, order', [
    (joint(), ('encoder',), 1), (base(), ('x',), 1), (base(), ('y',), 1),
    (base(), ('y', 'heading'), 2), (base(), ('x', 'y', 'heading'), 1), (drive(), ('position',), 2),
    (pendulum(), ('angle',), 2), (masses(), ('y1',), 3), (stepwise(), ('level',), 1)])
def test_a_mode_that_stays_is_served_for_a_time_and_refused_when_asked(plant, fault_set, order):
    v = temporary(plant, fault_set, fault_set[0])
    assert v.order == order and v.tracking.channels[0] == fault_set[0]
    refused = design(plant, [fault_set], temporary=False)[fault_set, fault_set[0]]
    assert isinstance(refused, Refusal) and 'does not surely die out' in refused.reason


@pytest.mark.parametrize('lost', ['x', 'y'])
def test_nothing_is_read_for_the_sake_of_rounding(lost):
    """A pose in which nothing but heading and wheels moves what is lost."""
    v = design(load_plant(BASE), [(lost,)])[(lost,), lost]
    assert set(v.reads) == {'yaw', 'wheel_left', 'wheel_right'} and not v.commands
    assert np.count_nonzero(v.Phi) == 1 and not v.Q.any()


def test_what_stays_stands_behind_a_small_virtual_sensor_of_what_drives_it():
    """A position whose speed is one of 20 states; both sensors of it are lost."""
    rng = np.random.default_rng(1)
    n = 20
    A = np.zeros((n + 1, n + 1))
    A[:n, :n] = rng.normal(size=(n, n)) / np.sqrt(n) - 1.5 * np.eye(n)
    A[n, 0] = 1.0
    C = np.vstack([np.eye(n + 1)[[0, n]], np.hstack([rng.normal(size=(4, n)), np.zeros((4, 1))])])
    plant = Plant.from_matrices(A, None, C)
    result = design(plant, [('y1', 'y2')])
    speed, position = result[('y1', 'y2'), 'y1'], result[('y1', 'y2'), 'y2']
    assert speed.grade == 'exact' and position.grade == 'temporary'
    assert position.order == speed.order + 1 and position.tracking.channels == ('y2', 'y1')
    healthy = plant.C[2:]
    assert position.Phi @ A == pytest.approx(
        position.N @ position.Phi + position.J @ healthy, abs=1e-8)


def test_what_can_be_replaced_for_good_is_and_is_tracked_besides():
    result = design(joint(), up_to=2)
    tacho = result[('tacho',), 'tacho']
    assert tacho.grade == 'exact' and tacho.tracking.channels == ('tacho',)
    # long after the loss all that is left is the noise of the independent run
    assert deviation_after(tacho, 1e3) == pytest.approx(tacho.noise.error, rel=0.02)
    assert deviation_after(tacho, 0.0) < tacho.noise.error
    both = result[('encoder', 'tacho'), 'encoder']
    assert both.grade == 'temporary' and both.tracking.channels == ('encoder', 'tacho')


def test_growth_is_that_of_the_published_joint():
    """The table of the method: predicted, and found in 400 runs, for an encoder that is lost."""
    v = temporary(joint(), ('encoder',), 'encoder')
    assert deviation_after(v, [1, 3, 10, 30]) == pytest.approx(
        [0.00079, 0.00134, 0.00242, 0.00419], rel=0.01)


@pytest.mark.parametrize('plant, fault_set', [
    (joint(), ('encoder',)), (joint(), ('encoder', 'tacho')), (base(), ('y', 'heading')),
    (pendulum(), ('angle',)), (masses(), ('y1',)), (stepwise(), ('level',))])
def test_growth_is_that_of_simulated_runs(plant, fault_set):
    v = temporary(plant, fault_set, fault_set[0])
    times = np.array([0.1, 0.5, 1.0, 2.0, 4.0])
    found = simulated(plant, v, times, runs=500)
    # three percent is one standard deviation of that of 500 runs
    assert found == pytest.approx(deviation_after(v, times), rel=0.12)


def simulated(plant, v, times, runs):
    """Return the standard deviation of vhat (T,) at times after the loss, over many runs."""
    rng = np.random.default_rng(5)
    h, finer = (INTERVAL, FINER) if plant.sample_time is None else (plant.sample_time, 1)
    E, _, _, _ = phi_functions(plant.A, h / finer) if plant.sample_time is None else (
        plant.A, 0, 0, 0)
    push = plant.process_noise * (np.sqrt(h / finer) if plant.sample_time is None else 1.0)
    x = np.zeros((runs, len(plant.states)))
    tracking, free = Run(plant, tracker(v), h), Run(plant, v, h)
    tracking.z = rng.multivariate_normal(np.zeros(v.order), v.tracking.P, runs)
    lost, last = round(1.0 / h), round((1.0 + times[-1]) / h)
    at = {lost + round(t / h): i for i, t in enumerate(times)}
    found = np.zeros(len(times))
    own = plant.C[plant.sensors.index(v.channel)]
    for step in range(last + 1):
        y = x @ plant.C.T + plant.noise * rng.normal(size=(runs, len(plant.sensors)))
        if step <= lost:
            tracking.hear(y)
            free.z, free.before = tracking.z, free.of(y)
        else:
            free.hear(y)
        if step in at:
            found[at[step]] = np.sqrt(np.mean((free.says(y) - x @ own)**2))
        for _ in range(finer):
            x = x @ E.T + push * rng.normal(size=x.shape)
    return found


class Run:
    """A virtual sensor in many runs at once: readings on a straight line between samples."""

    def __init__(self, plant, v, h):
        self.v, self.columns = v, [plant.sensors.index(name) for name in v.healthy]
        if plant.sample_time is None:
            self.E, one, two, _ = phi_functions(v.N, h)
            self.now, self.next = h * (one - two), h * two
        else:
            self.E, self.now, self.next = v.N, np.eye(v.order), np.zeros_like(v.N)
        self.z = self.before = None

    def of(self, y):
        return y[:, self.columns] @ self.v.J.T

    def hear(self, y):
        if self.before is not None:
            self.z = self.z @ self.E.T + self.before @ self.now.T + self.of(y) @ self.next.T
        self.before = self.of(y)

    def says(self, y):
        return (self.z @ self.v.Cv.T + y[:, self.columns] @ self.v.Q.T)[:, 0]


def test_the_tracker_is_an_observer_of_more_sensors():
    plant = base()
    v = temporary(plant, ('y', 'heading'), 'y')
    t = tracker(v)
    assert t.healthy == ('x', 'speed', 'yaw_rate', 'y', 'heading') and t.fault_set == ()
    C = plant.C[[plant.sensors.index(name) for name in t.healthy]]
    assert t.Phi @ plant.A == pytest.approx(t.N @ t.Phi + t.J @ C, abs=1e-9)
    assert t.Phi @ plant.B == pytest.approx(t.B, abs=1e-9)
    assert (t.eigenvalues.real < 0).all() and t.grade == 'exact'
    with pytest.raises(ValueError, match='no tracking'):
        tracker(t)


def test_the_tracker_starts_where_the_first_reading_of_its_channel_says():
    v = temporary(joint(), ('encoder',), 'encoder')
    t = tracker(v)
    assert t.z0 + t.z0_gain @ [0.3, 2.0] == pytest.approx([2.0], rel=1e-4)  # tacho, encoder
    assert np.sqrt(t.start) == pytest.approx(0.0005, rel=1e-4)
    # so it needs no time to forget where it might have been
    assert converge(t).warm_up < 0.5 * converge(replace(t, start=v.start)).warm_up


def test_the_tracker_takes_out_what_its_channel_reads_of_a_command():
    plant = Plant.from_matrices([[-1.0, 0], [1, 0]], [1, 0], np.eye(2), Cu=[[0.5], [0.25]])
    v = temporary(plant, ('y2',), 'y2')
    t = tracker(v)
    C = plant.C[[plant.sensors.index(name) for name in t.healthy]]
    Cu = plant.Cu[[plant.sensors.index(name) for name in t.healthy]]
    assert t.Phi @ plant.A == pytest.approx(t.N @ t.Phi + t.J @ C, abs=1e-9)
    assert pytest.approx(t.Phi @ plant.B - t.J @ Cu, abs=1e-9) == t.B


def test_the_horizon_is_where_the_deviation_meets_the_tolerance():
    v = temporary(joint(), ('encoder',), 'encoder')
    times = [horizon(v, tolerance) for tolerance in (0.001, 0.002, 0.01)]
    assert deviation_after(v, times) == pytest.approx([0.001, 0.002, 0.01], rel=1e-5)
    assert horizon(v, 1e-5) == 0.0 and horizon(v, 100.0) == np.inf
    steps = temporary(stepwise(), ('level',), 'level')
    last = horizon(steps, 0.1)
    assert deviation_after(steps, last) <= 0.1 < deviation_after(steps, last + 0.1)
    assert deviation_after(temporary(pendulum(), ('angle',), 'angle'), 1e4) == np.inf


def test_static_ones_and_wanted_functionals_have_nothing_to_track():
    plant = Plant.from_matrices([[0.0]], None, [[1], [2]])
    result = design(plant, [('y1',)], wanted={'w': [3.0]})
    assert result[('y1',), 'y1'].order == 0 and result[('y1',), 'y1'].tracking is None
    assert result[('y1',), 'w'].tracking is None
    hidden = design(joint(), [('encoder',)], wanted={'w': [1.0, 0.0]})
    assert isinstance(hidden[('encoder',), 'w'], Refusal)


def test_terms_count_with_their_slope_where_the_plant_works():
    """X' = -x + y, y' = sin(y), of which nothing but y is lost: A holds no slope of sin."""
    plant = Plant.from_matrices(
        [[-1, 1], [0, 0]], None, [0, 1], P=[0, 1], G=[[0, 1]], nonlinearities=['sin(w1)'],
        sensors=('y',), noise=[0.01], process_noise=[0.0, 0.1])
    v = temporary(plant, ('y',), 'y')
    assert pytest.approx(np.zeros((1, 1))) == v.N and v.tracking.slopes == pytest.approx(1.0)
    assert deviation_after(v, 6.0) / deviation_after(v, 5.0) == pytest.approx(np.e, rel=1e-3)


SLOW = """
name: drive
time: {time}
states:
  position: {{unit: m, process_noise: 0}}
  velocity: {{process_noise: 0.002}}
  friction: {{slow: true, range: [-0.05, 0.05]}}
inputs: {{force: {{unit: N}}}}
dynamics: {dynamics}
sensors: {{encoder: {{measures: position, noise: 1e-5, tolerance: 0.002}}}}
"""


def test_a_slow_offset_is_learnt_while_its_sensor_is_believed(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text(SLOW.format(time='continuous', dynamics='{position: velocity, velocity: '
                                'force - 2*velocity - friction}'))
    plant = load_plant(path)
    assert plant.A[2].tolist() == [0, 0, 0] and plant.slow.tolist() == [False, False, True]
    v = temporary(plant, ('encoder',), 'encoder')
    assert v.order == 3
    without = unlearnt(plant, v)
    assert horizon(without, 0.002) < 0.5 * horizon(v, 0.002)
    # nothing is known of it but its range: half of a t^2 off, and slowed down
    friction = 0.1 / np.sqrt(12)
    off = friction * (1.0 / 2 - (1 - np.exp(-2.0)) / 4)
    assert deviation_after(without, 1.0) == pytest.approx(
        np.hypot(off, deviation_after(v, 1.0)), rel=1e-6)
    steps = tmp_path / 'steps.yaml'
    steps.write_text(SLOW.format(time='{sample_time: 0.1}', dynamics='{position: position + '
                                 'velocity, velocity: force - friction}'))
    assert load_plant(steps).A[2].tolist() == [0, 0, 1]


def test_tolerances_and_ranges_stand_in_the_design(tmp_path):
    plant = drive(ranges=[[-0.2, 0.3], [-np.inf, np.inf]])
    result = design(plant)
    assert result.tolerance('position') == pytest.approx(0.05)
    result.save(tmp_path / 'design.json')
    assert Design.load(tmp_path / 'design.json').tolerance('position') == pytest.approx(0.05)
    given = design(drive(tolerances={'position': 0.004}))
    given.save(tmp_path / 'given.json')
    assert Design.load(tmp_path / 'given.json').tolerance('position') == 0.004
    assert design(joint()).tolerance('encoder') is None
