"""Virtual sensors without a state: other readings tell it at once; truth is simulated."""

import json

import numpy as np
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank.bank import Bank
from vsensor_ros.designer import design
from vsensor_ros.designer.by_functions import by_functions
from vsensor_ros.observers import Design
from vsensor_ros.plant import load_plant
from vsensor_ros.report.design_text import facts
from vsensor_ros.simulate.simulate import readings, simulate

SECOND, RATE, LOST = 10**9, 100, 300  # the step of the loss
PLANT = """
name: product
time: continuous
states:
  x1: {range: [-2, 2], initial: 1, process_noise: 1e-4}
  x2: {range: [-1, 3], initial: 1, process_noise: 1e-4}
disturbances: {r1: , r2: }
dynamics: {x1: r1, x2: r2}
sensors: {y1: {measures: x1, noise: 0.01}, y2: {measures: x1*x2, noise: 0.01},
          y3: {measures: x2, noise: 0.02}}
"""


PUMPED = """
name: pumped
time: continuous
states:
  V: {range: [-1, 3], initial: 1, process_noise: 1e-4}
  T: {range: [20, 60], initial: 40, process_noise: 1e-4}
inputs: {P: {range: [0, 10], operating: 5}}
disturbances: {rho: }
dynamics: {V: rho, T: -T + P/V + V**2}
sensors: {head: {measures: V, noise: 0.001}, thermometer: {measures: T, noise: 0.1}}
"""


@pytest.fixture(name='made', scope='module')
def _made(tmp_path_factory):
    """Return a plant, and its design that went through a file."""
    path = tmp_path_factory.mktemp('product')
    (path / 'plant.yaml').write_text(PLANT)
    plant = load_plant(path / 'plant.yaml')
    design(plant, [('y3',)]).save(path / 'd.json')
    return plant, Design.load(path / 'd.json'), (path / 'd.json').read_text()


def test_the_designer_finds_the_quotient_and_says_so(made):
    entry = made[1][('y3',), 'y3']
    assert (entry.kind, entry.order, entry.out, entry.validity) == ('nonlinear', 0, 'y2/y1', ())
    said = dict(facts(entry, '', {}))
    assert said['order'].startswith('0') and 'y2/y1' in said['says']
    assert 'at once' in said['found as'] and said['decay']


def test_it_follows_the_truth_and_says_nothing_where_noise_divides(made):
    """The divisor goes through 0 twice; there the declared range tells more."""
    plant, found, _ = made
    t = np.arange(1200) / RATE

    def rho(time):
        return [1.5 * np.cos(time), -1.2 * np.sin(1.3 * time)]
    x = simulate(plant, t, None, rho, [0.2, 1.5])
    y = readings(plant, t, x, None, rho)
    read = y + plant.noise * np.random.default_rng(1).standard_normal(y.shape)
    bank, error, stated, silent = Bank(found, RATE), [], [], []
    for k, time in enumerate(t):
        now = SECOND + round(time * SECOND)
        for j, sensor in enumerate(plant.sensors):
            if sensor != 'y3' or k < LOST:
                bank.take(sensor, now, read[k, j])
        bank.advance(now)
        if k == LOST:
            assert bank.ready(('y3',), 'y3')  # nothing has to be forgotten
            bank.distrust(('y3',), now)
        if k > LOST:
            ready = bank.ready(('y3',), 'y3')
            error.append(bank.estimate(('y3',), 'y3') - y[k, 2] if ready else np.nan)
            stated.append(bank.deviation(('y3',), 'y3') if ready else np.nan)
            if not ready:
                silent.append((bank.why_not(('y3',), 'y3').code, abs(x[k, 0])))
    error, stated, divisor = np.array(error), np.array(stated), np.abs(x[LOST + 1:, 0])
    assert {code for code, _ in silent} == {'says too little'}
    assert max(size for _, size in silent) < 0.05 and (divisor < 0.005).any()
    there = np.isfinite(error)
    assert there[divisor > 0.05].all()
    assert (np.abs(error) < 2.0 * stated)[there].mean() > 0.95
    assert 0.5 < np.std(error[divisor > 1.0]) / 0.01 < 1.5  # by closed form 0.0089 to 0.014


def test_its_deviation_is_that_of_the_readings_from_the_first_on(made):
    bank = Bank(made[1], RATE)
    for k in range(2):
        for sensor in ('y1', 'y2'):
            bank.take(sensor, SECOND + k * SECOND // RATE, 1.0)
        bank.advance(SECOND + k * SECOND // RATE)
    assert bank.ready(('y3',), 'y3') and bank.estimate(('y3',), 'y3') == 1.0
    assert bank.deviation(('y3',), 'y3') == pytest.approx(0.01 * np.sqrt(2.0), rel=0.02)


def test_a_divisor_of_z_whose_range_holds_0_stops_it_by_the_noise_of_what_is_read(tmp_path):
    (tmp_path / 'plant.yaml').write_text(PUMPED)
    plant = load_plant(tmp_path / 'plant.yaml')
    entry = by_functions(plant, ('thermometer',), 'thermometer')
    assert [c.positive for c in entry.validity] == ['abs(head) - 0.005']


@pytest.mark.parametrize(('change', 'said'), [
    ({'grade': 'temporary'}, r'entries\[0\].z: are none, of which nothing is to be tracked'),
    ({'tracks': ['y3 - y2/y1']}, r'entries\[0\].z: are none, of which nothing is to be tracked'),
    ({'F': ['y1']}, r'entries\[0\].F: are not 0, one a state'),
    ({'useful': -1.0}, r'entries\[0\].useful: must not be negative'),
    ({'start': [[1.0]]}, r'entries\[0\].start: is not 0 x 0 numbers'),
])
def test_what_is_wrong_with_it_is_one_line(tmp_path, made, change, said):
    record = json.loads(made[2])
    assert record['entries'][0]['channel'] == 'y3'
    record['entries'][0].update(change)
    (tmp_path / 'd.json').write_text(json.dumps(record))
    with pytest.raises(BadInput, match=said) as caught:
        Design.load(tmp_path / 'd.json')
    assert '\n' not in str(caught.value)
