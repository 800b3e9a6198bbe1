"""A sensor that wraps, on its way through the engine: forwarded, replaced, and believed again."""

import math
from pathlib import Path
import sys

import pytest

sys.path.append(str(Path(__file__).parent))
from machine import Machine

from vsensor_ros.engine import Substitute

TURN = math.tau
RATE = 0.02  # rad in a period


class Turning(Machine):
    """Two sensors of a heading; y2 is twice y1, and a turn of it is twice as large."""

    def __init__(self, bench, low=-0.5, **live):
        super().__init__(bench, wrap=({'y1': TURN, 'y2': 2 * TURN},), **live)
        self.low, self.heading, self.bias = low, 0.0, 0.0

    def said(self, turns=1.0):
        """Return what a driver says of the heading."""
        bias = self.bias if turns == 1.0 else 0.0
        return turns * ((self.heading + bias - self.low * TURN) % TURN + self.low * TURN)

    def turn(self, periods):
        """Go on turning; return the last verdict on y1, and what went out of it."""
        before, out = len(self.sent), []
        for _ in range(periods):
            self.heading += RATE
            verdict = self.step(self.said(), self.said(2.0))[0]
            out += [(self.heading, field.value, field) for composition in self.sent[before:]
                    for _, field in composition.fields if composition.stream == 0]
            before = len(self.sent)
        return verdict, out


def off(value, heading):
    return math.remainder(value - heading, TURN)


@pytest.mark.parametrize('low', [-0.5, 0.0])
def test_a_heading_lost_while_turning_is_replaced_without_a_jump(bench, low):
    m = Turning(bench, low, time_constant=0.5)
    m.bias = 0.2  # a little off the other: that is no turn
    m.heading = (low + 1.0) * TURN - 0.5 - 500 * RATE  # lost shortly before it jumps
    verdict, out = m.turn(500)
    assert not verdict.changed and not out
    last = m.said()
    m.isolate('y1')
    m.bias = 1.5
    first = m.sent[-1].fields[0][1]
    assert isinstance(first, Substitute) and abs(off(first.value, last)) < RATE
    _, out = m.turn(400)  # through the jump, and again
    values = [value for _, value, _ in out]
    assert low * TURN <= min(values) and max(values) <= (low + 1.0) * TURN
    assert max(values) - min(values) > 0.98 * TURN
    steps = [abs(off(b, a)) for a, b in zip(values, values[1:])]
    assert max(steps) < 1.2 * RATE
    assert abs(out[0][2].offset) == pytest.approx(0.2, abs=0.01)
    assert all(abs(off(value - field.offset, heading)) < 1.1 * RATE
               for heading, value, field in out)
    assert m.state('y1').residual == pytest.approx(1.5, abs=2 * RATE)
    assert abs(m.state('y1').last_step) < RATE


def test_believed_again_on_the_other_side_of_the_jump(bench):
    """The reading is at -pi then, and what went out last at +pi: no offset of a turn."""
    m = Turning(bench, time_constant=0.5)
    m.turn(100)
    m.isolate('y1')
    m.turn(3)
    m.heading = math.pi - 2.5 * RATE
    m.turn(2)
    assert m.sent[-1].fields[0][1].value > 3.0
    m.isolate()
    verdict, out = m.turn(1)
    m.heading += 2 * RATE  # it is believed with the tick, on the other side
    verdict, out = m.turn(1)
    assert m.said() < -3.0
    for put in verdict.changed.values():  # with what is left of an offset
        assert abs(off(put, m.said())) < 3 * RATE and abs(put) <= math.pi
    assert abs(m.state('y1').last_step) < 4 * RATE and abs(m.state('y1').offset) < 3 * RATE
    verdict, _ = m.turn(500)
    assert not verdict.changed  # as it came, to the last bit


def test_a_reading_beyond_its_range_goes_on_as_it_came(bench):
    m = Turning(bench)
    m.turn(10)
    assert not m.hear(0, 3.1417).changed  # a driver that rounds
    m.isolate('y1')
    m.turn(3)
    m.isolate()
    m.turn(100)
    assert not m.hear(0, 3.1417).changed
