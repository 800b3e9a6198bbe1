"""A design with an entry of every kind, its numbers with many digits, and changes of its file."""

from dataclasses import replace
import json

import numpy as np

from vsensor_ros import Design
from vsensor_ros.functions.curve import Curve
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import (
    Certificate,
    Limit,
    Noise,
    OrderStep,
    Proof,
    Refusal,
    Rung,
    Tracking,
    VirtualSensor,
)

TERM = NonlinearTerm('sign(x2)', 'sign(w1)', np.zeros(1))
SENSORS = ('y1', 'y2', 'y3')
PROOF = Proof(1, 1, (OrderStep(0, 'impossible', 'the rows of C0 do not span v', 0, (1e-16, 0.3)),
                     OrderStep(1, 'possible', 'a root is free', 1, (0.0, np.inf))), ('of A',))
LADDER = (Rung(1, 0.1, 2.0, 1.0 / 3.0, 'least'), Rung(2, 0.05, 1.0, np.inf, 'quiet'))
GLOBAL = Certificate('global', 0.1 + 0.2, 2.5, np.array([[2.0]]), (), (2.35, 0.25), 'it brakes')
REGION = Certificate('region', np.inf, np.inf, np.eye(2) / 3, (
    Limit(0, 0, -np.inf, 3.0), Limit(None, 0, 1e-300, np.inf)), (np.inf, np.inf),
    'while levels are so')
NONE = Certificate('none', 0.0, np.inf, np.zeros((1, 1)), (), None, 'the slope has no bound')

TRACKING = Tracking(('y3',), np.array([[3.0], [2.0]]), np.array([[1.0, 0.0]]),
                    np.array([[0.0, 1.0 / 3.0]]), np.array([[-0.5]]), np.eye(2) / 3,
                    np.diag([0.0, 0.1]), 1e-9, True, np.array([0.1 + 0.2]))


def sensor(channel, fault_set, rows=1, order=1, **more):
    """Make a virtual sensor that could be of the servo, in numbers with many digits."""
    healthy = tuple(name for name in SENSORS if name not in fault_set)
    rng = np.random.default_rng(order)
    k, l0 = order, len(healthy)
    N = np.diag(-rng.uniform(0.5, 2.0, k))
    return VirtualSensor(
        channel, fault_set, healthy, ('u1',), rng.normal(size=(k, 3)), N,
        rng.normal(size=(k, l0)), rng.normal(size=(k, 1)), rng.normal(size=(k, 1)),
        rng.normal(size=(rows, k)), rng.normal(size=(rows, l0)), (rng.normal(size=(1, k)),),
        (rng.normal(size=(1, l0)),), (TERM,), None, rng.normal(size=k),
        rng.normal(size=(k, l0)), np.diag(N).astype(complex), 0.7, 'by hand', **more)


def example():
    """Make a design with an entry of every kind."""
    entries = (
        Refusal('y1', ('y1',), 'rho1 reaches y1', ('rank of C0',), 'a bounded one exists'),
        sensor('y2', ('y2',), Qu=np.array([[1.0 / 3.0]]), Gu=(np.array([[-0.1]]),), proof=PROOF,
               ladder=LADDER, noise=Noise(0.3, 0.1, True), certificate=GLOBAL),
        sensor('y2', ('y2', 'y3'), order=2, certificate=REGION,
               start=np.array([[2.0, 1.0 / 3.0], [1.0 / 3.0, 1.0 / 18.0]])),
        Refusal('y3', ('y2', 'y3'), 'nothing sees x3'),
        sensor('v', (), grade='bounded', disturbance_gain=0.25, noise=Noise(0.3, np.inf, False),
               certificate=NONE),
        sensor('w', ('y1',), rows=2, order=2, Qu=np.array([[1.5], [-0.0]])),
        sensor('w', (), rows=3, order=0),
        replace(sensor('y3', ('y3',), order=2, grade='temporary', tracking=TRACKING),
                N=np.array([[0.0, 1.0], [0.0, 0.0]]), eigenvalues=np.zeros(2, complex),
                noise_gain=np.inf))
    return Design('servo', '0' * 64, ('x1', 'x2', 'x3'), ('u1',), SENSORS, {'y1': 'rad'}, None,
                  {(e.fault_set, e.channel): e for e in entries}, ('v', 'w'),
                  np.array([[0.0], [1.0 / 3.0], [-2.0]]), {'y3': 0.1}, {'y1': (-np.pi, 0.3)},
                  wrap=({'y1': 2.0 * np.pi, 'y3': -360.0},),
                  curves={'y1': Curve(1.0 / 3.0), 'y2': Curve(
                      0.0, 'smooth_table(w1, 0, 1, 1.5, 3) + w1/3', 0.0, 2.0,
                      {'u1': -1.0 / 3.0})},
                  delays={'u1': 0.2, 'y3': 1.0 / 3.0})


def rewrite(path, change):
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def first_sensor(record):
    return record['entries'][1]


def certificate(record, entry=1):
    return record['entries'][entry]['certificate']


def as_version_3(record):
    """Write a record as it stood in the file before there were kinds."""
    record.update(version=3)
    for entry in record['entries']:
        entry.pop('kind', None)
        for limit in (entry.get('certificate') or {}).get('region', ()):
            del limit['argument']
            limit['name'] = 'u1' if limit.pop('term') is None else 'x2'

