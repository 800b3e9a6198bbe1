"""
How hypothesis draws, and virtual sensors of the papers, written out by hand, with their truths.

Hypothesis draws the same examples at every run; others with HYPOTHESIS_PROFILE=explore. No
deadline and no complaint of slow drawing: the machine may be busy.
"""

import gc
import json
import os
from pathlib import Path
import sys
from types import SimpleNamespace

from hypothesis import HealthCheck, settings
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import Design, Refusal, VirtualSensor
from vsensor_ros.observers.kinds.functional.tracking import Tracking

PATIENT = {'deadline': None, 'suppress_health_check': [HealthCheck.too_slow]}

settings.register_profile('fixed', derandomize=True, max_examples=40, **PATIENT)
settings.register_profile('explore', **PATIENT)
settings.load_profile(os.environ.get('HYPOTHESIS_PROFILE', 'fixed'))

SECOND = 1_000_000_000


def pytest_collection_finish():
    """Keep what was collected, and all that is imported, out of every later garbage collection."""
    gc.collect()
    gc.freeze()


def virtual_sensor(N, J, *, B=None, P=None, Gz=(), Gy=(), texts=(), slopes=None, Cv=None, Q=None,
                   z0=None, z0_gain=None, sample_time=None, fault_set=('y1',), healthy=('y2',),
                   inputs=(), channel=None, rows=1, **more):
    """Fill in what a test does not care about."""
    N = np.array(N, dtype=float).reshape(len(N), len(N))
    k, q = len(N), len(texts)

    def wide(a, *shape):
        return np.zeros(shape) if a is None else np.array(a, dtype=float).reshape(shape)
    slopes = slopes or [[0.0] * len(np.atleast_2d(g)) for g in Gz]
    terms = tuple(NonlinearTerm(text, text, np.array(s, dtype=float))
                  for text, s in zip(texts, slopes))
    return VirtualSensor(
        channel or fault_set[0], tuple(fault_set), tuple(healthy), tuple(inputs), np.eye(k), N,
        wide(J, k, len(healthy)), wide(B, k, len(inputs)), wide(P, k, q),
        wide(Cv if Cv is not None else np.eye(rows, k), rows, k), wide(Q, rows, len(healthy)),
        tuple(wide(g, len(t.slope), k) for g, t in zip(Gz, terms)),
        tuple(wide(g, len(t.slope), len(healthy)) for g, t in zip(Gy, terms)), terms, sample_time,
        wide(z0, k), wide(z0_gain, k, len(healthy)), np.linalg.eigvals(N).astype(complex), 1.0,
        'by hand', **more)


def design(*sensors, names=('y1', 'y2'), inputs=(), wanted=()):
    return Design('test', '0', ('x1',), tuple(inputs), tuple(names), {}, sensors[0].sample_time,
                  {(v.fault_set, v.channel): v for v in sensors}, wanted)


ENCODER, TACHO, JERK = 0.0005, 0.005, 0.2  # standard deviations of the joint's noise


def encoder(grade='temporary', rate=50.0, gain=1.0, names=('angle', 'tacho'), **more):
    """
    Make what stands in for the encoder of a joint from its tacho, for so many readings a second.

    Its gain and covariances are those of the Kalman filter of the scalar ``angle' = vel``.
    """
    W = TACHO**2 / rate + JERK**2 / rate**2 / 12
    P = np.sqrt(W * ENCODER**2 / rate)
    one, none = np.eye(1), np.zeros((1, 0))
    tracking = Tracking(names[:1], np.sqrt(W * rate) / ENCODER * one, one, 0.0 * one, none,
                        P * one, W * one, 0.0)
    return virtual_sensor([[0.0]], [[gain]], fault_set=names[:1], healthy=names[1:], grade=grade,
                          tracking=tracking, start=one, **more)


def joint(seconds, seed=0, rate=50.0):
    """Return the true angle and speed (n, 2) of a joint that is driven, and what sensors say."""
    rng, h = np.random.default_rng(seed), 1 / rate
    a, speed = np.exp(-4.0 * h), 0.0
    x = np.zeros((round(seconds * rate) + 1, 2))
    for k in range(1, len(x)):
        before = speed
        speed = a * before + (1 - a) * 4.0 * np.sin(0.8 * k * h) + \
            JERK * np.sqrt(h) * rng.standard_normal()
        # what the process noise does between the readings
        between = JERK * h**1.5 / np.sqrt(12) * rng.standard_normal()
        x[k] = x[k - 1, 0] + h * (before + speed) / 2 + between, speed
    return x, x + rng.standard_normal(x.shape) * (ENCODER, TACHO)


def servo(lam, k7=-1.0, z0=-1.0):
    """Make the decoupled observer of the servo's velocity, reference `family_any_rate`."""
    b = -(lam + 1.0)
    return virtual_sensor([[lam]], [[0.0, 1.0 - b - lam * b]], B=[[b]], P=[[k7]], Gz=[[[1.0]]],
                          Gy=[[[0.0, -b]]], texts=['sign(w1)'], Q=[[0.0, -b]], z0=[z0],
                          fault_set=('y2',), healthy=('y1', 'y3'), inputs=('u',))


def tank(z0):
    """Make the observer (18) of the replacement paper."""
    return virtual_sensor(
        [[0, -1], [1, -3]], [[0], [-1]], B=[[1, 0], [1, -1]], P=[[-1, 0], [-2, 1]],
        Gz=[[[0, 1]], [[1, -1]]], Gy=[[[0]], [[-1]]], texts=['sqrt(w1)', 'sqrt(w1)'],
        slopes=[[1.0], [1.0]], Cv=[[1, -1]], z0=z0, inputs=('u1', 'u2'))


def tank_truth(z0, times, u=(lambda t: 0.5, lambda t: 0.2), x0=(5.0, 3.0, 1.0)):
    """Return x (3, n) of the three tanks and z (2, n) of their observer, both integrated."""
    def root(w):
        return np.sign(w) * np.sqrt(abs(w))

    def rate(t, s):
        x1, x2, x3, z1, z2 = s
        u1, u2 = u[0](t), u[1](t)
        return [u1 - root(x1 - x2), u2 + root(x1 - x2) - root(x2 - x3),
                root(x2 - x3) - root(x3), u1 - root(z2),
                u1 - u2 - 2 * root(z2) + root(z1 - z2 - x3)]
    s = solve_ivp(rate, (0, times[-1]), [*x0, *z0], 'DOP853', times, rtol=1e-11, atol=1e-13,
                  max_step=0.02).y
    return s[:3], s[3:]


def friction_truth(rate, P, G, x0, times):
    """
    Integrate ``dx = rate(t, x) + P sigma, sigma_i in Sign(G_i x)`` from event to event.

    An independent account of stick and slip: what rests is held there by the friction that
    holds it until that exceeds 1.
    """
    P, G, x = np.array(P, float), np.array(G, float), np.array(x0, float)
    mode = np.sign(np.round(G @ x, 12))  # of each sign: moving at -1 or 1, or resting at 0
    t, found = 0.0, []

    def friction(t, x):
        sigma, rest = mode.copy(), np.flatnonzero(mode == 0)
        if rest.size:
            sigma[rest] = np.linalg.solve(-G[rest] @ P[:, rest], G[rest] @ (rate(t, x) + P @ mode))
        return sigma

    def event(i, start):
        def value(t, x):
            if mode[i] == 0:
                return 1.0 - abs(friction(t, x)[i])
            return mode[i] * (G[i] @ x) if t > start + 1e-9 else 1.0
        value.terminal, value.direction = True, -1
        return value

    while t < times[-1]:
        for _ in range(10):  # release what friction cannot hold
            sigma = friction(t, x)
            mode[:] = np.where(np.abs(sigma) > 1.0 + 1e-12, np.sign(sigma), mode)
        s = solve_ivp(lambda t, x: rate(t, x) + P @ friction(t, x), (t, times[-1]), x, 'DOP853',
                      events=[event(i, t) for i in range(len(G))], rtol=1e-11, atol=1e-13,
                      max_step=0.02, dense_output=True)
        found += [s.sol(time) for time in times[len(found):] if time <= s.t[-1]]
        t, x = s.t[-1], s.y[:, -1]
        for i, hits in enumerate(s.t_events):  # two may come at once
            if mode[i] != 0 and (len(hits) or abs(G[i] @ x) < 1e-10):
                x = x - P[:, i] * (G[i] @ x) / (G[i] @ P[:, i])
                mode[i] = 0.0  # the loop above decides whether it stays
            elif mode[i] == 0 and abs(friction(t, x)[i]) > 1.0 - 1e-9:
                mode[i] = np.sign(friction(t, x)[i])
    return np.array(found).T


def servo_truth(lam, times, z0=-1.0):
    """Return x (3, n) and z (n,) of reference `sim_k7=-1`."""
    b = -(lam + 1.0)
    A = np.array([[0, 1, 0, 0], [0, -1, 1, 0], [0, -1, -1, 0], [0, 0, 1 - b - lam * b, lam]])

    def rate(t, s):
        u = 2 * np.sin(t)
        return A @ s + np.array([0.5 * np.sin(3 * t), 0.0, u, b * u])
    s = friction_truth(rate, [[0, 0], [-1, 0], [0, 0], [0, -1]], [[0, 1, 0, 0], [0, 0, -b, 1]],
                       [0, 1, 0, z0], times)
    return s[:3], s[3]


def run(bank, key, rate, readings, commands):
    """
    Feed readings {name: values at each grid time} and commands {name: function of time [s]}.

    Returns the estimate at each grid time, NaN where there is none.
    """
    h, n = 1 / rate, len(next(iter(readings.values())))
    out = np.full(n, np.nan)
    for k in range(n):
        now = k * bank.period
        for name, values in readings.items():
            assert bank.take(name, now, values[k]) is None
        for name, u in commands.items():  # held for a period: the value in its middle
            assert bank.take(name, now, u((k + 0.5) * h)) is None
        bank.advance(now)
        value = bank.estimate(*key)
        out[k] = np.nan if value is None else value
    return out


@pytest.fixture(scope='session')
def bench():
    return SimpleNamespace(
        virtual_sensor=virtual_sensor, design=design, encoder=encoder, joint=joint, servo=servo,
        tank=tank, tank_truth=tank_truth, friction_truth=friction_truth,
        servo_truth=servo_truth, run=run, Refusal=Refusal, SECOND=SECOND)


@pytest.fixture(scope='session')
def reference():
    path = Path(__file__).parent / 'reference.json'
    return json.loads(path.read_text(encoding='utf-8'))


@pytest.fixture(scope='session')
def designed():
    """Return what designs as `design` does, each plant once for all who ask the same of it."""
    from vsensor_ros.designer import design  # which takes long to import
    made = {}

    def once(plant, fault_sets=None, progress=None, **choices):
        with np.printoptions(floatmode='unique', threshold=sys.maxsize):
            asked = repr((plant, fault_sets, sorted(choices.items())))
        if asked not in made:
            made[asked] = design(plant, fault_sets, progress=progress, **choices)
        return made[asked]
    return once


@pytest.fixture
def designed_once(monkeypatch, designed):
    """Have the command `designer` design nothing that was designed in this process before."""
    monkeypatch.setattr('vsensor_ros.command.designer.design', designed)
