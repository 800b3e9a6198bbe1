"""Plants that no linear map serves, what a study found for each, and how it may be driven."""

from dataclasses import dataclass
import math

import numpy as np

from vsensor_ros.designer.algebra import System

CIRCLE = (-math.pi, math.pi)


@dataclass(frozen=True)
class Case:
    """A system, the functions the study found, and a run; rmse: of its second half, clean."""

    system: System
    phi: tuple[str, ...]
    grade: str
    start: tuple[float, ...] = ()
    drive: object = None     # t -> (inputs, unknown inputs)
    time: float = 0.0        # s
    step: float = 1e-3       # s
    rmse: float = math.inf   # the study's
    off: float = 0.3         # of z at the start


def system(states, f, sensors, wanted, inputs=None, unknown=None, angles=(), sample_time=None):
    return System(states, dict(zip(states, f)), sensors, wanted, inputs or {}, unknown or {},
                  angles, sample_time)


def square(t, period):
    return float(t % period < period / 2)


def heated_cascade(n):
    """Return n heated tanks in a row; the thermometer of the last is lost."""
    V, T = ([f'{letter}{i}' for i in range(1, n + 1)] for letter in 'VT')
    out = ['rho', *(f'0.5*sqrt({v})' for v in V)]
    f = [f'{out[i]} - {out[i + 1]}' for i in range(n)]
    f += ['(rho*(15 - T1) + P)/V1']
    f += [f'{out[i]}*({T[i - 1]} - {T[i]})/{V[i]}' for i in range(1, n)]
    return system({**dict.fromkeys(V, (0.5, 3.0)), **dict.fromkeys(T, (20.0, 60.0))}, f,
                  {f'level{i + 1}': v for i, v in enumerate(V)}, {'last': T[-1]}, {'P': (0, 10)},
                  {'rho': (0, 2)})


def motor(sensor, wanted, speeds=(1.0, 100.0)):
    return system({'i': (-5, 5), 'w': speeds},
                  ['(-i - rho*w + U)/0.05', '(rho*i - 0.02*w)/0.01'], {'y': sensor},
                  {wanted: wanted}, {'U': (0, 50)}, {'rho': (0, 1)})


CHEMOSTAT = system({'s': (0.2, 3), 'X': (0.5, 2.5)},
                   ['rho*(5 - s) - 0.8*s/(0.6 + s)*X', '-rho*X + 0.4*s/(0.6 + s)*X'],
                   {'y': 's'}, {'X': 'X'}, {}, {'rho': (0, 1)})
TANK = {'V': (0.5, 3.0), 'T': (20.0, 60.0)}
TROLLEY = '(F + rho + sin(th)*(q**2 + 9.81*cos(th)) + 0.2*q*cos(th))/(5 + sin(th)**2)'
RING = {f'w{i}': (-1, 1) for i in (1, 2, 3)}
FIELD = {f'B{i}': (0.3, 1.0) for i in (1, 2, 3)}

CASES = {
    'chemostat': Case(CHEMOSTAT, ('(5 - s)/X',), 'certified in a region', (1.0, 1.6),
                      lambda t: ((), (0.02 + 0.6 * square(t, 7.0),)), 60.0, 2e-2, 1e-6),
    'heated tank': Case(
        system(TANK, ['rho - 0.5*sqrt(V)', 'rho*(15 - T)/V + P/V'], {'y': 'V'}, {'T': 'T'},
               {'P': (0, 10)}, {'rho': (0, 2)}),
        ('V*(T - 15)',), 'certified in a region', (1.5, 35.0),
        lambda t: ((6.0 + 3.0 * math.sin(0.5 * t),), (0.05 + 1.9 * square(t, 6.0),)), 60.0, 3e-2,
        0.000767),
    'heated tank, discrete': Case(
        system(TANK, ['V + rho - 0.05*sqrt(V)',
                      '15 + (V*(T - 15) - 0.05*sqrt(V)*(T - 15) + P)/(V + rho - 0.05*sqrt(V))'],
               {'y': 'V'}, {'T': 'T'}, {'P': (0, 10)}, {'rho': (0, 0.2)}, (), 0.1),
        ('V*(T - 15)',), 'certified in a region', (1.5, 35.0),
        lambda t: ((0.6 + 0.3 * math.sin(0.5 * t),), (0.005 + 0.14 * square(t, 6.0),)), 100.0,
        0.1, 1e-5),
    'heated cascade': Case(
        heated_cascade(2), ('V1*(T1 - 15)', 'T2'), 'certified in a region',
        (1.0, 1.2, 40.0, 35.0),
        lambda t: ((6.0 + 3.0 * math.sin(0.5 * t),), (0.05 + 1.6 * square(t, 6.0),)), 60.0, 4e-2,
        0.000561),
    'motor, field flux unknown': Case(
        motor('i', 'w'), ('5*i**2 + w**2',), 'certified in a region', (0.5, 40.0),
        lambda t: ((25.0,), (0.4 + 0.35 * math.sin(9.0 * t),)), 5.0, 1e-3, 0.0028),
    'crane': Case(
        system({'v': (-1, 1), 'th': (-0.6, 0.6), 'q': (-1, 1)},
               [TROLLEY, 'q', f'-({TROLLEY})*cos(th) - 9.81*sin(th) - 0.2*q'],
               {'y1': 'v', 'y2': 'th'}, {'q': 'q'}, {'F': (-20, 20)}, {'rho': (-15, 15)}),
        ('q + v*cos(th)',), 'certified in a region', (0.0, 0.1, 0.0),
        lambda t: ((0.0,), (15.0 * math.copysign(1.0, math.sin(2.1 * t)),)), 10.0, 4e-3, 0.000117),
    'battery, ammeter lost': Case(
        system({'s': (0.1, 0.9), 'v1': (-0.1, 0.1)}, ['-rho/3600', '-v1/40 + rho/2000'],
               {'y': '3.2 + 0.6*s + 0.4*s**2 - v1'}, {'s': 's'}, {}, {'rho': (-50, 50)}),
        ('1.8*s + v1',), 'certified in a region', (0.6, 0.0),
        lambda t: ((), (5.0 * math.sin(t / 40.0),)), 2000.0, 1.0, 0.00012),
    'motor, encoder lost': Case(
        system({'ia': (-5, 5), 'ib': (-5, 5), 'th': CIRCLE},
               ['(ua - 0.5*ia + 0.1*rho*sin(th))/0.01', '(ub - 0.5*ib - 0.1*rho*cos(th))/0.01',
                'rho'], {'y1': 'ia', 'y2': 'ib'}, {'c': 'cos(th)', 's': 'sin(th)'},
               {'ua': (-10, 10), 'ub': (-10, 10)}, {'rho': (-50, 50)}, ('th',)),
        ('ia + 10*cos(th)', 'ib + 10*sin(th)'), 'temporary', (0.0, 0.0, 0.3),
        lambda t: ((3.0 * math.cos(5.0 * t), 3.0 * math.sin(5.0 * t)), (5.0 + 3.0 * math.sin(t),)),
        10.0, 1e-3, 0.00578, 0.0),
    'satellite': Case(
        system({**RING, **FIELD},
               ['(5*w2*w3 + u1 + r2*B3 - r3*B2)/10', '(-3*w3*w1 + u2 + r3*B1 - r1*B3)/12',
                '(-2*w1*w2 + u3 + r1*B2 - r2*B1)/7', 'w3*B2 - w2*B3', 'w1*B3 - w3*B1',
                'w2*B1 - w1*B2'],
               {'g1': 'w1', 'g2': 'w2', 'm1': 'B1', 'm2': 'B2', 'm3': 'B3'}, {'w3': 'w3'},
               {f'u{i}': (-1, 1) for i in (1, 2, 3)}, {f'r{i}': (-1, 1) for i in (1, 2, 3)}),
        ('10*w1*B1 + 12*w2*B2 + 7*w3*B3',), 'temporary', (0.05, -0.05, 0.1, 0.5, 0.6, 0.7),
        lambda t: ((0.5 * math.sin(t), 0.5 * math.cos(t), 0.6 * math.sin(t)),
                   (0.2 * math.sin(2 * t), 0.2 * math.cos(3 * t), 0.1)), 8.0, 2e-3, 0.00291, 0.0),
    'base with known speed': Case(
        system({'x': (-5, 5), 'y': (-5, 5), 'th': CIRCLE}, ['v*cos(th)', 'v*sin(th)', 'om'],
               {'y1': 'x', 'y2': 'y'}, {'c': 'cos(th)', 's': 'sin(th)'},
               {'v': (0, 1), 'om': (-1, 1)}, {}, ('th',)),
        ('cos(th)', 'sin(th)'), 'temporary', (0.0, 0.0, 0.4),
        lambda t: ((1.0, 0.5 * math.sin(t)), ()), 10.0, 2e-3, 0.0009, 0.0),
    'base that slips': Case(
        system({'x': (-5, 5), 'y': (-5, 5), 'th': CIRCLE}, ['rho*cos(th)', 'rho*sin(th)', 'om'],
               {'y1': 'x', 'y2': 'y'}, {'c': 'cos(th)', 's': 'sin(th)'}, {'om': (-1, 1)},
               {'rho': (-1, 1)}, ('th',)),
        ('cos(th)', 'sin(th)'), 'temporary', (0.0, 0.0, 0.4),
        lambda t: ((0.5 * math.sin(t),), (math.cos(3.0 * t),)), 10.0, 2e-3, 0.0009, 0.0),
}

YAW_UNKNOWN = system({'x': (-5, 5), 'y': (-5, 5), 'th': CIRCLE}, ['v*cos(th)', 'v*sin(th)', 'rho'],
                     {'y1': 'x', 'y2': 'y'}, {'th': 'th'}, {'v': (0, 1)}, {'rho': (-1, 1)},
                     ('th',))
HEISENBERG = system(dict.fromkeys('abc', (-1, 1)), ['0', 'rho', 'a*rho'], {'y': 'a'}, {'c': 'c'},
                    {}, {'rho': (-1, 1)})
NOT_INVOLUTIVE = system(dict.fromkeys('abcq', (-1, 1)), ['r1', 'r2', 'a*r2', '-q + c'], {'y': 'q'},
                        {'c': 'c'}, {}, {'r1': (-1, 1), 'r2': (-1, 1)})
MOTOR_BY_EULER = system({'i': (-5, 5), 'w': (1, 100)},
                        ['i + 0.001*(-i - rho*w + U)/0.05', 'w + 0.001*(rho*i - 0.02*w)/0.01'],
                        {'y': 'i'}, {'w': 'w'}, {'U': (0, 50)}, {'rho': (0, 1)}, (), 0.001)
NOT_SUBMERSIVE = system({'x1': (-1, 1), 'x2': (-1, 1), 'x3': (-1, 1)}, ['u', 'u', 'x3/2 + rho'],
                        {'y1': 'x1', 'y2': 'x2'}, {'x3': 'x3'}, {'u': (-1, 1)}, {'rho': (-1, 1)},
                        (), 1.0)


def three_tanks(*wanted):
    """Return the three tanks of Symmetry 15, 993, equation (26)."""
    return system({f'x{i}': (1.0, 9.0) for i in (1, 2, 3)},
                  ['0.1*u1 - 0.1*sqrt(x1 - x2) + x1 + rho',
                   '0.2*u2 + 0.1*sqrt(x1 - x2) - 0.1*sqrt(x2 - x3) + x2',
                   '0.1*sqrt(x2 - x3) - 0.1*sqrt(x3) + x3'],
                  {'y': 'x2'}, {name: name for name in wanted}, {'u1': (0, 2), 'u2': (0, 2)},
                  {'rho': (-0.15, 0.15)}, (), 1.0)


def played(case, observer, noise=0.0, seed=0):
    """Run plant and observer; return what was wanted and what was estimated, (p, steps) each."""
    from vsensor_ros.functions.expression import compile_expression
    system = case.system
    names = [*system.states, *system.inputs, *system.unknown]
    f = [compile_expression(text, names) for text in system.f.values()]
    h = [compile_expression(text, list(system.states)) for text in system.sensors.values()]
    phi = [compile_expression(text, list(system.states)) for text in observer.phi]
    known = [*observer.names, *system.sensors, *system.inputs]
    F = [compile_expression(text, known) for text in observer.F]
    out = [compile_expression(text, known) for text in observer.out.values()]
    wanted = [compile_expression(text, list(system.states)) for text in system.wanted.values()]

    def at(functions, values):
        return np.array([float(function(values)) for function in functions])

    def step(functions, x, before, after):
        if system.sample_time is not None:
            return at(functions, [*x, *before])
        middle, dt = 0.5 * (before + after), case.step
        k1 = at(functions, [*x, *before])
        k2 = at(functions, [*(x + 0.5 * dt * k1), *middle])
        k3 = at(functions, [*(x + 0.5 * dt * k2), *middle])
        k4 = at(functions, [*(x + dt * k3), *after])
        return x + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)

    random = np.random.default_rng(seed)
    spread = np.array([high - low for low, high in observer.ranges])
    x = np.array(case.start)
    z = at(phi, x) + case.off * spread * (np.arange(len(phi)) == 0)
    truth, estimate = [], []
    sizes = np.abs(at(h, x)) + 0.1

    def reading(x):
        return at(h, x) + noise * sizes * random.standard_normal(len(h))
    y = reading(x)
    for k in range(round(case.time / case.step)):
        t = k * case.step
        u, rho = map(np.array, case.drive(t))
        truth.append(at(wanted, x))
        estimate.append(at(out, [*z, *y, *u]))
        held = np.concatenate([u, rho])
        x = step(f, x, held, held)
        fresh = reading(x)
        z = step(F, z, np.concatenate([y, u]), np.concatenate([fresh, u]))
        y = fresh
    return np.array(truth).T, np.array(estimate).T
