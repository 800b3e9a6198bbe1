"""A motor that loses an ammeter, from corner to corner of its range, with constant gains."""

import numpy as np
import pytest

from vsensor_ros import design, load_plant
from vsensor_ros.bank import Bank

R, LD, LQ, FLUX, PAIRS, J, B = 0.15, 0.0007, 0.0011, 0.02, 4, 0.0009, 0.0004
MOTOR = f"""
name: motor
time: continuous
states:
  id: {{unit: A, process_noise: 5.0, range: [-60, 60]}}
  iq: {{unit: A, process_noise: 5.0, range: [-60, 60]}}
  w: {{unit: rad/s, process_noise: 5.0, range: [-400, 400], initial: 100}}
inputs: {{vd: , vq: {{operating: 8}}}}
disturbances: {{load: }}
dynamics:
  id: (vd - {R}*id + {PAIRS}*w*{LQ}*iq)/{LD}
  iq: (vq - {R}*iq - {PAIRS}*w*({LD}*id + {FLUX}))/{LQ}
  w: (1.5*{PAIRS}*({FLUX}*iq + ({LD} - {LQ})*id*iq) - {B}*w)/{J} + load
sensors:
  amp_d: {{measures: id, unit: A, noise: 0.05}}
  amp_q: {{measures: iq, unit: A, noise: 0.05}}
  encoder: {{measures: w, unit: rad/s, noise: 0.5}}
"""
FINE = 1e-4  # s, of the controller


def slope(x, u, load):
    """Return what the motor does, written out again."""
    d, q, w = x
    return np.array([(u[0] - R * d + PAIRS * w * LQ * q) / LD,
                     (u[1] - R * q - PAIRS * w * (LD * d + FLUX)) / LQ,
                     (1.5 * PAIRS * (FLUX * q + (LD - LQ) * d * q) - B * w) / J + load])


def worst(made, step, seconds=0.26):
    """Return how far off both estimates are at most [A], and how far the plant went."""
    bank, x = Bank(made, 1.0 / step), np.array([0.0, 2.0, 100.0])
    off, far = np.zeros(2), np.zeros(3)
    for k in range(round(seconds / FINE)):
        now = round(k * FINE * 1e9)
        wanted = 57.0 * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)][k // 200 % 4])
        speed = 400.0 * (-1) ** (k // 800)
        load = 20000.0 * np.sign(speed - x[2]) * (abs(speed - x[2]) > 10.0)
        u = np.array([R * x[0] - PAIRS * x[2] * LQ * x[1],
                      R * x[1] + PAIRS * x[2] * (LD * x[0] + FLUX)]) + 300.0 * (
                          wanted - x[:2]) * [LD, LQ]
        for name, value in zip(('vd', 'vq'), u):
            bank.take(name, now, value)
        if k % round(step / FINE) == 0:
            for name, value in zip(('amp_d', 'amp_q', 'encoder'), x):
                bank.take(name, now, value)
            bank.advance(now)
            if k * FINE > 0.1:
                said = [bank.estimate((name,), name) for name in ('amp_d', 'amp_q')]
                off, far = np.maximum(off, abs(said - x[:2])), np.maximum(far, abs(x))
        x = x + FINE * slope(x + FINE / 2 * slope(x, u, load), u, load)
    return off, far


@pytest.mark.slow
def test_an_ammeter_is_replaced_over_the_whole_range(tmp_path):
    path = tmp_path / 'motor.yaml'
    path.write_text(MOTOR)
    made = design(load_plant(path), [['amp_d'], ['amp_q']])
    for lost, rate in (('amp_d', R / LD), ('amp_q', R / LQ)):
        entry = made[(lost,), lost]
        # order 1, at the rate of its own circuit: whichever product is taken, the load stays out
        assert entry.order == 1 and entry.grade == 'exact' and entry.certificate.status == 'global'
        assert entry.decay == pytest.approx(rate)
    off, far = worst(made, 1e-4)
    assert (far > [50.0, 50.0, 380.0]).all() and (off < 0.4).all()
    slower, _ = worst(made, 1e-3)  # readings and voltages between samples are straight lines
    assert (off < slower).all() and (slower < 12.0).all()
