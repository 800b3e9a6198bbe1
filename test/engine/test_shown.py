"""Sensors that show an offset, a curve or the past, on their way through the engine."""

import math
from pathlib import Path
import sys

import pytest

sys.path.append(str(Path(__file__).parent))
from machine import Machine, PERIOD

from vsensor_ros.engine import Substitute
from vsensor_ros.functions.curve import Curve

CURVED = {'curves': {'y1': Curve(5.0), 'y2': Curve(0.0, 'w1 + 0.1*w1**3', -30.0, 30.0)}}


def shown(x):
    """Return what the two sensors say when y1 without its offset is x, and y2 twice that."""
    return x + 5.0, 2.0 * x + 0.8 * x**3


def substituted(m):
    stream, value = m.sent[-1].stream, m.sent[-1].fields[0][1]
    assert isinstance(value, Substitute)
    return stream, value


@pytest.mark.parametrize(('name', 'index'), [('y1', 0), ('y2', 1)])
def test_what_goes_out_is_what_the_sensor_would_show(bench, name, index):
    m = Machine(bench, told=CURVED)
    m.step(*shown(1.0), periods=200)
    m.isolate(name)
    for x in (1.0, 0.5, -2.0):
        said = list(shown(x))
        said[index] = 99.0  # the faulty one
        m.step(*said, periods=50)
        stream, value = substituted(m)
        assert stream == index and value.value == pytest.approx(shown(x)[index], abs=1e-6)
    assert m.state(name).residual == pytest.approx(99.0 - shown(-2.0)[index], rel=0.9)
    assert m.state(name).source == 'virtual'


def test_a_disagreement_is_carried_on_in_what_is_shown(bench):
    """Bumpless: what goes out first is what the sensor said last, not what it should have."""
    m = Machine(bench, told=CURVED, time_constant=1.0)
    m.step(shown(1.0)[0], shown(1.0)[1] + 0.05, periods=300)
    m.isolate('y2')
    value = substituted(m)[1]
    assert value.value == pytest.approx(shown(1.0)[1] + 0.05, abs=5e-3)
    assert value.offset == pytest.approx(0.05, abs=5e-3)


def test_an_offset_of_an_angle_leaves_the_range_of_its_driver(bench):
    """A compass mounted 3 rad off: its driver says -pi to pi all the same."""
    m = Machine(bench, wrap=({'y1': math.tau, 'y2': 2 * math.tau},),
                told={'curves': {'y1': Curve(3.0)}})

    def compass(heading):
        return math.remainder(heading + 3.0, math.tau)

    heading, out = 0.0, []
    for k in range(1200):
        heading += 0.02
        m.step(compass(heading) if k < 600 else 0.0, 2.0 * heading)
        if k == 599:
            m.isolate('y1')
        if k > 600:
            value = substituted(m)[1].value
            out.append(value)
            assert abs(math.remainder(value - compass(heading), math.tau)) < 0.025
    assert -math.pi <= min(out) < -3.0 and 3.0 < max(out) <= math.pi


def test_a_late_sensor_is_replaced_by_what_it_would_say_then(bench):
    """Y2 tells of 0.1 s ago: so does what stands in for it, and it counts as of then for y1."""
    late = 10
    m = Machine(bench, told={'delays': {'y2': late * PERIOD * 1e-9}})
    way = [0.02 * k + 0.5 * math.sin(0.02 * k) for k in range(700)]
    for k in range(late, 700):
        if k == 300:
            m.isolate('y2')
        if k == 500:
            m.isolate()  # both are well again
        m.step(way[k], 2.0 * way[k - late] if not 300 <= k < 500 else 77.0)
        if 300 < k < 500:
            assert substituted(m)[1].value == pytest.approx(2.0 * way[k - late], abs=0.05)
            assert abs(2.0 * way[k] - 2.0 * way[k - late]) > 0.15
