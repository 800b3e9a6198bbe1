"""The design file: what is written is read back exactly, and what is wrong is refused."""

import copy
from dataclasses import replace
import json
import os
from pathlib import Path
import stat
from threading import Thread

from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
import numpy as np
import pytest

from vsensor_ros import Design
from vsensor_ros.bad_input import BadInput
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
from vsensor_ros.observers.file import VERSION

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


@pytest.fixture(name='written')
def _written(tmp_path):
    path = tmp_path / 'servo.design.json'
    example().save(path)
    return path


def rewrite(path, change):
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


def refusal_line(path):
    with pytest.raises(BadInput) as caught:
        Design.load(path)
    line = str(caught.value)
    assert '\n' not in line and str(path) in line
    return line


def test_what_is_loaded_is_what_was_saved_to_the_last_digit(written):
    saved, loaded = example(), Design.load(written)
    for name in ('plant_name', 'plant_hash', 'states', 'inputs', 'sensors', 'units',
                 'sample_time', 'fault_sets', 'wanted', 'tolerances', 'ranges', 'wrap', 'curves',
                 'delays'):
        assert getattr(loaded, name) == getattr(saved, name)
    bits(loaded.Cu, saved.Cu)
    assert not loaded.Cu.flags.writeable and not saved.Cu.flags.writeable
    assert list(loaded.entries) == list(saved.entries)
    for key, entry in saved.entries.items():
        other = loaded.entries[key]
        same(other, entry)


def same(other, entry):
    """Check that two entries are equal, bit by bit."""
    assert frozen(entry) == frozen(other) and type(other) is type(entry)
    if isinstance(entry, Refusal):
        assert other == entry
        return
    for name, value in vars(entry).items():
        if isinstance(value, np.ndarray):
            bits(getattr(other, name), value)
        elif name not in ('Gz', 'Gy', 'Gu', 'terms', 'certificate', 'tracking'):
            assert getattr(other, name) == value
    for mine, theirs in zip((*entry.Gz, *entry.Gy, *entry.Gu), (*other.Gz, *other.Gy, *other.Gu)):
        bits(theirs, mine)
    assert [(t.name, t.text, t.slope.tolist()) for t in other.terms] == [
        (t.name, t.text, t.slope.tolist()) for t in entry.terms]
    for name, value in (vars(entry.tracking) if entry.tracking else {}).items():
        if isinstance(value, np.ndarray):
            bits(getattr(other.tracking, name), value)
        else:
            assert getattr(other.tracking, name) == value
    if entry.certificate is not None:
        bits(other.certificate.S, entry.certificate.S)
        assert {**vars(other.certificate), 'S': 0} == {**vars(entry.certificate), 'S': 0}


def bits(theirs, mine):
    assert theirs.shape == mine.shape and theirs.tobytes() == mine.tobytes()


def frozen(entry):
    """Check that no array can be written to; return how many there are."""
    arrays = [a for value in vars(entry).values()
              for a in (value if isinstance(value, tuple) else (value,))
              if isinstance(a, np.ndarray)]
    arrays += [term.slope for term in getattr(entry, 'terms', ())]
    tracking = getattr(entry, 'tracking', None)
    arrays += [a for a in vars(tracking).values() if isinstance(a, np.ndarray)] if tracking else []
    arrays += [entry.certificate.S] if getattr(entry, 'certificate', None) else []
    assert not any(array.flags.writeable for array in arrays)
    return len(arrays)


def first_sensor(record):
    return record['entries'][1]


BROKEN = {
    'not json': (lambda r: None, 'is not JSON'),
    'newer version': (lambda r: r.update(version=VERSION + 1), 'update vsensor_ros'),
    'other format': (lambda r: r.update(format='something'), 'format'),
    'unknown key': (lambda r: r.update(extra=1), 'extra'),
    'missing matrix': (lambda r: first_sensor(r).pop('J'), 'J: is missing'),
    'text for a number': (lambda r: first_sensor(r).update(N=[['x']]), 'N'),
    'true for a number': (lambda r: first_sensor(r).update(N=[[True]]), 'N'),
    'wrong shape': (lambda r: first_sensor(r).update(Phi=[[1.0, 2.0]]), 'Phi: is not 1 x 3'),
    'ragged': (lambda r: first_sensor(r).update(Phi=[[1.0, 2.0], 3.0]), 'Phi'),
    'too large a number': (lambda r: first_sensor(r).update(J=[[1e308 * 10, 0.0]]), 'finite'),
    'huge integer': (lambda r: first_sensor(r).update(noise_gain=10**400), 'finite'),
    'unstable': (lambda r: first_sensor(r).update(N=[[0.5]], eigenvalues=[[0.5, 0.0]]),
                 'unstable (eigenvalue 0.5'),
    'eigenvalues of another matrix': (
        lambda r: first_sensor(r).update(eigenvalues=[[-7.0, 0.0]]), 'not those of N'),
    'large eigenvalue of the other sign': (
        lambda r: first_sensor(r).update(N=[[-1e7]], eigenvalues=[[1e7, 0.0]]), 'not those of N'),
    'small eigenvalue of the other sign': (
        lambda r: first_sensor(r).update(N=[[-1e-4]], eigenvalues=[[1e-4, 0.0]]),
        'not those of N'),
    'eigenvalue whose square overflows': (
        lambda r: first_sensor(r).update(eigenvalues=[[1e200, 1e200]]), 'not those of N'),
    'matrix whose square overflows': (
        lambda r: first_sensor(r).update(N=[[-1e200]], eigenvalues=[[-2e200, 0.0]]),
        'not those of N'),
    'true for a noise gain': (lambda r: first_sensor(r).update(noise_gain=True), 'noise_gain'),
    'true for a sample time': (lambda r: r['plant'].update(sample_time=True), 'sample_time'),
    'a word for a name': (lambda r: r['plant'].update(states=['a', 'b', 'sin']), 'sin'),
    'newline in a unit': (lambda r: r['plant']['units'].update(y1='m\n'), 'plant.units'),
    'reads the failed sensor': (
        lambda r: first_sensor(r).update(healthy=['y1', 'y2', 'y3']), 'healthy'),
    'unknown sensor': (lambda r: first_sensor(r).update(fault_set=['y7']), 'fault_set'),
    'channel not in its set': (lambda r: first_sensor(r).update(channel='y1'), 'channel'),
    'twice the same': (
        lambda r: r['entries'].append(copy.deepcopy(first_sensor(r))), 'twice'),
    'code in a term': (
        lambda r: first_sensor(r)['terms'][0].update(function="__import__('os')"),
        'terms[0].function'),
    'unknown name in a term': (
        lambda r: first_sensor(r)['terms'][0].update(function='sin(w2)'), 'w2'),
    'negative noise gain': (lambda r: first_sensor(r).update(noise_gain=-1.0), 'noise_gain'),
    'order beyond reason': (lambda r: first_sensor(r).update(order=10**9), 'order'),
    'plant as a list': (lambda r: r.update(plant=[]), 'plant'),
    'name twice': (lambda r: r['plant'].update(states=['a', 'a', 'b']), 'twice'),
    'newline in a reason': (
        lambda r: r['entries'][0].update(reason='a\nb'), 'reason'),
    'older version': (lambda r: r.update(version=1), 'write the file anew'),
    'version 1 of an entry': (lambda r: first_sensor(r).pop('Qu'), 'Qu: is missing'),
    'wanted left out': (lambda r: r.pop('wanted'), 'wanted: is missing'),
    'wanted is a sensor': (lambda r: r.update(wanted=['v', 'w', 'y1']), 'y1 is a sensor'),
    'wanted twice': (lambda r: r.update(wanted=['v', 'w', 'v']), 'wanted: holds a name twice'),
    'not wanted': (lambda r: r.update(wanted=['w']), 'v is not in its fault set'),
    'sensor without fault': (lambda r: first_sensor(r).update(fault_set=[]),
                             'y2 is not in its fault set'),
    'wanted reads the failed sensor': (
        lambda r: r['entries'][5].update(healthy=['y1', 'y2', 'y3']), 'entries[5].healthy'),
    'two rows for a sensor': (
        lambda r: first_sensor(r).update(Cv=[[1.0], [1.0]]), 'Cv: is not 1 x 1'),
    'no row at all': (lambda r: r['entries'][4].update(Cv=[]), 'Cv: must have 1 to'),
    'rows of Q for others': (lambda r: r['entries'][5]['Q'].pop(), 'Q: is not 2 x 2'),
    'rows of Qu for others': (lambda r: r['entries'][5]['Qu'].pop(), 'Qu: is not 2 x 1'),
    'shape of Gu': (lambda r: first_sensor(r)['terms'][0].update(Gu=[[1.0, 2.0]]),
                    'terms[0].Gu: is not 1 x 1'),
    'null in Qu': (lambda r: first_sensor(r).update(Qu=[[None]]), 'Qu: is not 1 x 1'),
    'grade': (lambda r: first_sensor(r).update(grade='good'),
              'grade: good is not one of exact, bounded, temporary'),
    'grade as a list': (
        lambda r: first_sensor(r).update(grade=['exact']), 'grade: must be a text'),
    'negative disturbance gain': (
        lambda r: first_sensor(r).update(disturbance_gain=-1e-9), 'disturbance_gain'),
    'infinite disturbance gain': (
        lambda r: first_sensor(r).update(disturbance_gain=None), 'disturbance_gain'),
    'doubts as a text': (lambda r: r['entries'][0].update(doubts='x'), 'doubts: must be a list'),
    'doubts as numbers': (lambda r: r['entries'][0].update(doubts=[1]), 'doubts: 1 is not a text'),
    'alternative': (lambda r: r['entries'][0].update(alternative=None), 'alternative'),
    'proof as a list': (lambda r: first_sensor(r).update(proof=[]), 'proof: must be an object'),
    'proof left out': (lambda r: first_sensor(r).pop('proof'), 'proof: is missing'),
    'bounds crossed': (lambda r: proof(r).update(lower=2, upper=1), 'lower: 2 is above upper, 1'),
    'upper above the order': (lambda r: proof(r).update(upper=2), 'upper: 2 is above the order 1'),
    'bound of minus one': (lambda r: proof(r).update(lower=-1), 'lower: must lie in 0..'),
    'bound of a half': (lambda r: proof(r).update(lower=0.5), 'lower: must be a whole number'),
    'verdict': (lambda r: step(r, 0).update(verdict='no'), 'verdict: no is not one of'),
    'impossible at the least': (lambda r: step(r, 1).update(verdict='impossible', freedom=0),
                                'impossible does not agree with lower, 1'),
    'possible below the least': (lambda r: step(r, 0).update(verdict='possible'),
                                 'possible does not agree with upper, 1'),
    'steps in disorder': (lambda r: proof(r)['steps'].reverse(), 'steps[1].order: is not above'),
    'gap of one number': (lambda r: step(r, 0).update(gap=[1.0]), 'gap: is not 2 numbers'),
    'infinite zero': (lambda r: step(r, 0).update(gap=[None, 1.0]), 'gap[0]: must be a number'),
    'negative gap': (lambda r: step(r, 0).update(gap=[0.0, -1.0]), 'gap[1]: must not be negative'),
    'unknown key in a step': (lambda r: step(r, 0).update(x=1), 'steps[0].x: is not a key'),
    'rung of no method': (lambda r: first_sensor(r)['ladder'][0].pop('method'),
                          'ladder[0].method: is missing'),
    'infinite noise': (lambda r: first_sensor(r)['ladder'][1].update(noise=None), 'noise'),
    'negative decay': (lambda r: first_sensor(r)['ladder'][1].update(decay=-1.0), 'decay'),
    'error unknown': (lambda r: first_sensor(r)['noise'].update(error=None), 'noise.error'),
    'negative floor': (lambda r: first_sensor(r)['noise'].update(floor=-1.0), 'noise.floor'),
    'assumed as a number': (lambda r: first_sensor(r)['noise'].update(assumed=1),
                            'noise.assumed: must be true or false'),
    'assumed left out': (lambda r: first_sensor(r)['noise'].pop('assumed'), 'assumed: is missing'),
    'status': (lambda r: certificate(r).update(status='sure'), 'status: sure is not one of'),
    'negative rate': (lambda r: certificate(r).update(rate=-1.0), 'certificate.rate'),
    'rate of nothing': (lambda r: certificate(r).update(status='none'),
                        'rate: must be 0 where nothing is certified'),
    'shape of S': (lambda r: certificate(r).update(S=[]), 'certificate.S: is not 1 x 1'),
    'region of a global one': (
        lambda r: certificate(r).update(
            region=[{'term': 0, 'argument': 0, 'low': 0.0, 'high': 1.0}]),
        'region: does not agree with the status global'),
    'no region': (lambda r: certificate(r).update(status='region'), 'region: does not agree'),
    'kind left out': (lambda r: first_sensor(r).pop('kind'), 'entries[1].kind: is missing'),
    'kind that nobody knows': (lambda r: first_sensor(r).update(kind='os.system'),
                               'entries[1].kind: os.system is not one of functional'),
    'kind as a list': (lambda r: first_sensor(r).update(kind=['functional']),
                       'entries[1].kind: must be a text'),
    'kind of a refusal': (lambda r: r['entries'][0].update(kind='functional'),
                          'entries[0].kind: is not a key'),
    'kind in an older file': (lambda r: r.update(version=3), 'entries[1].kind: is not a key'),
    'region of a term that is not there': (
        lambda r: certificate(r, 2)['region'][0].update(term=1), 'region[0].term: 1: there are 1'),
    'region of an argument that is not there': (
        lambda r: certificate(r, 2)['region'][0].update(argument=1),
        'region[0].argument: 1: there are 1'),
    'region of a command that is not there': (
        lambda r: certificate(r, 2)['region'][1].update(argument=7),
        'region[1].argument: 7: there are 1'),
    'region by name': (lambda r: certificate(r, 2)['region'][0].update(name='x2'),
                       'region[0].name: is not a key'),
    'argument bounded twice': (
        lambda r: certificate(r, 2)['region'].append(dict(certificate(r, 2)['region'][0])),
        'region[2].argument: stands there twice'),
    'bound of an argument that feeds nothing': (
        lambda r: r['entries'][2].update(P=[[0.0], [0.0]]), 'does not feed the estimate'),
    'form that is none': (
        lambda r: certificate(r, 2).update(S=[[1.0, 2.0], [2.0, 1.0]]),
        'S: is not symmetric and positive'),
    'empty region': (
        lambda r: certificate(r, 2)['region'][0].update(low=3.0), 'region[0].low: is not below'),
    'side left out': (lambda r: certificate(r, 2)['region'][0].pop('low'), 'low: is missing'),
    'lipschitz': (lambda r: certificate(r).update(lipschitz=1.0), 'lipschitz: must be a list'),
    'shape of start': (lambda r: first_sensor(r).update(start=[[1.0, 0.0]]),
                       'start: is not 1 x 1'),
    'start of null': (lambda r: first_sensor(r).update(start=None), 'start: must be a list'),
    'negative start': (lambda r: first_sensor(r).update(start=[[-1e-9]]),
                       'start: is not a covariance'),
    'start that is not symmetric': (
        lambda r: r['entries'][2].update(start=[[2.0, 1.0], [0.5, 2.0]]), 'is not symmetric'),
    'start with a negative eigenvalue': (
        lambda r: r['entries'][2].update(start=[[1e6, 1.1], [1.1, 1e-6]]), 'not a covariance'),
    'start that is no covariance': (
        lambda r: r['entries'][2].update(start=[[0.0, 1.0], [1.0, 2.0]]), 'not a covariance'),
    'start that is too large': (
        lambda r: r['entries'][2].update(start=[[1.0, 1e999], [1e999, 1.0]]), 'finite'),
    'shape of Cu': (lambda r: r['plant'].update(Cu=[[1.0]]), 'plant.Cu: is not 3 x 1'),
    'Cu of null': (lambda r: r['plant'].update(Cu=None), 'plant.Cu: must be a list'),
    'wrap of nobody': (
        lambda r: r['plant'].update(wrap=[{'y9': 1.0}]), 'plant.wrap[0].y9: is not'),
    'wrap of nothing': (lambda r: r['plant'].update(wrap=[{'y1': 0.0}]),
                        'plant.wrap[0].y1: is no turn'),
    'wrap of two': (lambda r: r['plant'].update(wrap=[{'y1': 1.0}, {'y1': 1.0}]),
                    'plant.wrap[1].y1: stands there twice'),
    'wrap without end': (lambda r: r['plant'].update(wrap=[{'y1': 10**400}]),
                         'plant.wrap[0].y1: is not finite'),
    'curve of nobody': (lambda r: r['plant'].update(curves={'y9': {'offset': 1.0}}),
                        'plant.curves.y9: is not a key'),
    'curve of nothing': (lambda r: r['plant']['curves'].update(y1={}),
                         'plant.curves.y1.function: is missing'),
    'curve that runs': (
        lambda r: r['plant']['curves']['y2'].update(function="__import__('os')"),
        'plant.curves.y2: the function'),
    'curve that turns back': (lambda r: r['plant']['curves']['y2'].update(function='(w1 - 1)**2'),
                              'plant.curves.y2: cannot be inverted'),
    'table that turns back': (
        lambda r: r['plant']['curves']['y2'].update(function='table(w1, 0, 1, 0, 2)'),
        'the table has points that do not rise in x'),
    'table of unknowns': (
        lambda r: r['plant']['curves']['y2'].update(function='table(w1, 0, 1, w1, 2)'),
        'the table holds a point that is no number'),
    'curve without end': (lambda r: r['plant']['curves']['y2'].update(high=1e999), 'finite'),
    'curve beside nobody': (lambda r: r['plant']['curves']['y2'].update(beside={'u9': 1.0}),
                            'plant.curves.y2.beside.u9: is not'),
    'offset beside a curve': (lambda r: r['plant']['curves']['y2'].update(offset=1.0),
                              'is not a key'),
    'delay of nobody': (lambda r: r['plant'].update(delays={'y9': 1.0}),
                        'plant.delays.y9: is not'),
    'delay of nothing': (lambda r: r['plant'].update(delays={'y1': 0.0}),
                         'plant.delays.y1: must be positive'),
    'tracking of null': (lambda r: last(r).update(tracking=None), 'tracking: must be an object'),
    'temporary without tracking': (lambda r: last(r).pop('tracking'), 'tracking: is missing'),
    'tracking that leaves it unstable': (
        lambda r: last(r)['tracking'].update(L=[[3.0], [0.0]]), 'leaves N - L C unstable'),
    'tracking by a healthy one': (
        lambda r: last(r)['tracking'].update(channels=['y1']), 'channels: are not some of the'),
    'tracking by others alone': (
        lambda r: r['entries'][2].update(tracking={'channels': ['y3']}), 'begin with its own'),
    'tracking by nobody': (lambda r: last(r)['tracking'].update(channels=[]), 'channels'),
    'tracking of order 0': (
        lambda r: r['entries'].append({**last(r), 'fault_set': ['y1', 'y3'], 'healthy': ['y2'],
                                       **{key: [] for key in (
                                           'Phi', 'N', 'J', 'B', 'P', 'z0', 'z0_gain',
                                           'eigenvalues')},
                                       'order': 0, 'terms': [], 'Cv': [[]], 'Q': [[1.0]]}),
        'of order 0 there is nothing to track'),
    'numbers that have no product': (
        lambda r: last(r)['tracking'].update(L=[[1e200], [0.0]]), 'L: has a number above'),
    'shape of L': (lambda r: last(r)['tracking'].update(L=[[1.0]]), 'tracking.L: is not 2 x 1'),
    'shape of Q of the tracked': (
        lambda r: last(r)['tracking'].update(Q=[[1.0]]), 'tracking.Q: is not 1 x 2'),
    'growth that is no covariance': (
        lambda r: last(r)['tracking'].update(W=[[-1.0, 0.0], [0.0, 1.0]]), 'W: is not a covar'),
    'tracked covariance of one side': (
        lambda r: last(r)['tracking'].update(P=[[1.0, 0.5], [0.0, 1.0]]), 'P: is not symmetric'),
    'negative direct': (lambda r: last(r)['tracking'].update(direct=-1.0), 'tracking.direct'),
    'negative noise of a reading': (
        lambda r: last(r)['tracking'].update(noise=[-0.1]), 'tracking.noise: must not be neg'),
    'slopes of another order': (
        lambda r: last(r)['tracking'].update(slopes=[[1.0]]), 'slopes: is not 2 x 2'),
    'unknown key of tracking': (
        lambda r: last(r)['tracking'].update(x=1), 'tracking.x: is not a key'),
    'infinite noise gain of a stable one': (
        lambda r: first_sensor(r).update(noise_gain=None), 'noise_gain'),
    'tolerance of nothing': (lambda r: r['plant'].update(tolerances={'y9': 1.0}), 'tolerances.y9'),
    'tolerance of zero': (
        lambda r: r['plant'].update(tolerances={'y3': 0}), 'tolerances.y3: must be positive'),
    'range upside down': (
        lambda r: r['plant'].update(ranges={'y1': [1.0, 1.0]}), 'ranges.y1: is not [low, high]'),
    'range as a number': (lambda r: r['plant'].update(ranges={'y1': 1.0}), 'ranges.y1'),
    'lipschitz left out': (lambda r: certificate(r).pop('lipschitz'), 'lipschitz: is missing'),
}


def last(record):
    return record['entries'][-1]


def proof(record):
    return first_sensor(record)['proof']


def step(record, i):
    return proof(record)['steps'][i]


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


@pytest.mark.parametrize('case', BROKEN)
def test_refused_with_one_line(written, case):
    change, expected = BROKEN[case]
    rewrite(written, change)
    if case == 'not json':
        written.write_text(written.read_text()[:-30])
    assert expected in refusal_line(written)


def test_a_file_of_version_2_is_read_and_nothing_is_known_of_its_starts(written):
    def older(record):
        as_version_3(record)
        record.update(version=2)
        for key in ('wrap', 'Cu', 'curves', 'delays'):
            del record['plant'][key]
        del record['entries'][2]['start']
    rewrite(written, older)
    read = Design.load(written)
    assert read.Cu is None and all(v.start is None for v in read.virtual_sensors)
    assert len(read.entries) == len(example().entries)


def test_a_file_of_version_3_is_the_same_design(tmp_path):
    """Written by the designer, of config/three_tank, before there were kinds."""
    golden = Path(__file__).with_name('three_tank.version_3.json')
    record, loaded = json.loads(golden.read_text()), Design.load(golden)
    assert record['version'] == 3
    loaded.save(tmp_path / 'new.json')
    for read in (loaded, Design.load(tmp_path / 'new.json')):
        assert read.plant_hash == record['plant']['hash'] and len(read.entries) == 2
        for entry in record['entries']:
            v = read[entry['fault_set'], entry['channel']]
            assert v.kind == 'functional' and v.outputs == (v.channel,)
            for key in ('Phi', 'N', 'J', 'B', 'P', 'Cv', 'Q', 'Qu', 'z0', 'z0_gain', 'start'):
                assert getattr(v, key).tolist() == entry[key]
            for key in ('order', 'method', 'grade', 'noise_gain', 'disturbance_gain'):
                assert getattr(v, key) == entry[key]
            for term, text, gz, gy, gu in zip(entry['terms'], v.terms, v.Gz, v.Gy, v.Gu):
                assert [term['name'], term['function'], term['Gz'], term['Gy'], term['Gu']] == [
                    text.name, text.text, gz.tolist(), gy.tolist(), gu.tolist()]
            # the region is of the arguments that its texts name
            assert v.certificate.status == 'region' and len(v.certificate.region) == 2
            assert v.region == tuple((limit['name'], limit['low'], limit['high'])
                                     for limit in entry['certificate']['region'])
            assert [loaded[v.fault_set, v.channel].terms[limit.term].name
                    for limit in v.certificate.region] == [
                        f"sqrt({limit['name']})" for limit in entry['certificate']['region']]


def test_an_old_region_lists_equal_arguments_once_and_then_commands(tmp_path):
    golden = Path(__file__).with_name('three_tank.version_3.json')
    record = json.loads(golden.read_text())
    entry = record['entries'][0]
    entry['terms'].append({**entry['terms'][1], 'name': 'once more'})
    entry['P'] = [[*row, row[1]] for row in entry['P']]
    entry['certificate']['region'].append({'name': 'u2', 'low': None, 'high': 2.0})
    path = tmp_path / 'old.json'
    path.write_text(json.dumps(record))
    v = Design.load(path)['y1', 'y1']
    assert [limit[:2] for limit in v.certificate.region] == [(0, 0), (1, 0), (None, 1)]
    assert v.region[2] == ('u2', -np.inf, 2.0)


@pytest.mark.parametrize('text', ['NaN', 'Infinity', '-Infinity'])
def test_not_finite_is_refused_by_the_parser(written, text):
    record = written.read_text()
    written.write_text(record.replace('"noise_gain": ', f'"noise_gain": {text}, "x": '))
    assert 'not a finite number' in refusal_line(written)


def test_duplicate_key_binary_deep_and_missing(written, tmp_path):
    text = written.read_text()
    version = f'"version": {VERSION}'
    written.write_text(text.replace(version, f'{version}, {version}'))
    assert 'version: stands there twice' in refusal_line(written)
    written.write_bytes(b'\xff\xfe\x00')
    assert 'is not UTF-8: line 1, byte 0xff' in refusal_line(written)
    written.write_text('[' * 200_000)
    refusal_line(written)
    written.write_text('{"format": "vsensor_ros design", "version": ' + '9' * 5000 + '}')
    refusal_line(written)
    assert 'cannot be read' in refusal_line(tmp_path / 'nowhere.json')
    assert 'cannot be read' in refusal_line(tmp_path)
    for path in ('', 'a\0b'):
        with pytest.raises(BadInput, match='cannot be read'):
            Design.load(path)


@pytest.mark.parametrize('size', [1e-4, 1.0, 1e7, 1e200])
def test_nearly_defective_eigenvalues_may_differ_in_their_last_digits(written, size):
    # of [[-s, s], [-1e-12 s, -s]]: -s +- 1e-6 s i, which an ulp of N moves by more than that
    def change(record):
        sensor = first_sensor(record)
        sensor.update(order=2, N=[[-size, size], [-1e-12 * size, -size]],
                      eigenvalues=[[-size, 2e-6 * size], [-size, -2e-6 * size]],
                      Phi=[[0.0] * 3] * 2, J=[[0.0] * 2] * 2, B=[[0.0]] * 2, P=[[0.0]] * 2,
                      Cv=[[0.0] * 2], z0=[0.0] * 2, z0_gain=[[0.0] * 2] * 2,
                      certificate=None)
        sensor['terms'][0]['Gz'] = [[0.0, 0.0]]
    rewrite(written, change)
    Design.load(written)
    rewrite(written, lambda r: first_sensor(r).update(
        eigenvalues=[[-1.01 * size, 0.0], [-size, 0.0]]))
    assert 'not those of N' in refusal_line(written)


def test_failed_save_leaves_the_old_file_whole(written, monkeypatch):
    before = written.read_bytes()

    def broken(*_):
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr('os.replace', broken)
    with pytest.raises(BadInput, match='No space left'):
        example().save(written)
    assert written.read_bytes() == before
    assert list(written.parent.iterdir()) == [written]


@pytest.mark.parametrize('path', ['no/such/folder.json', '', '.', 'a\0b', 'x' * 300])
def test_save_where_nothing_can_be_written_says_so(tmp_path, path):
    with pytest.raises(BadInput, match='cannot be written'):
        example().save(tmp_path / path)
    assert not list(tmp_path.iterdir())


def test_save_keeps_links_and_modes(written):
    link, dangling = written.with_name('link'), written.with_name('dangling')
    link.symlink_to(written.name)
    dangling.symlink_to('new.json')
    written.chmod(0o640)
    old = os.umask(0o027)
    try:
        for path in (link, dangling):
            example().save(path)
            assert path.is_symlink()
    finally:
        os.umask(old)
    mode = {path.name: stat.S_IMODE(path.lstat().st_mode) for path in written.parent.iterdir()}
    assert mode == {**mode, written.name: 0o640, 'new.json': 0o640} and len(mode) == 4
    assert Design.load(dangling).entries.keys() == Design.load(link).entries.keys()


def test_save_writes_into_a_pipe_and_a_device(tmp_path):
    pipe, read = tmp_path / 'pipe', []
    os.mkfifo(pipe)
    reader = Thread(target=lambda: read.append(json.loads(pipe.read_text())), daemon=True)
    reader.start()
    example().save(pipe)
    reader.join(10.0)
    assert read[0]['version'] == VERSION and list(tmp_path.iterdir()) == [pipe]
    example().save('/dev/null')
    assert stat.S_ISCHR(Path('/dev/null').stat().st_mode)


@pytest.mark.parametrize(('change', 'needle'), [
    ({'noise_gain': float('nan')}, r'entries\[1\].noise_gain: is not finite'),
    ({'N': np.array([[-np.inf]])}, r'entries\[1\].N: '),
    ({'method': object()}, 'cannot be written as JSON'),
    ({'method': 'a\nb'}, r'entries\[1\].method: '),
    ({'noise': Noise(np.nan, 0.0, True)}, r'entries\[1\].noise.error: is not finite'),
    ({'noise': Noise(0.0, -np.inf, True)}, r'entries\[1\].noise.floor: is not finite'),
    ({'certificate': replace(GLOBAL, bound=np.nan)}, r'certificate.bound: is not finite'),
    ({'certificate': replace(GLOBAL, S=np.eye(2))}, r'certificate.S: is not 1 x 1'),
    ({'proof': Proof(2, 2, (), ())}, r'proof.upper: 2 is above the order'),
    ({'Cv': np.ones((2, 1))}, r'entries\[1\].Cv: is not 1 x 1'),
])
def test_save_never_writes_what_load_refuses(tmp_path, change, needle):
    result = example()
    sensor = result.virtual_sensors[0]
    result.entries[sensor.fault_set, sensor.channel] = replace(sensor, **change)
    with pytest.raises(BadInput, match=needle):
        result.save(tmp_path / 'x.json')
    assert not list(tmp_path.iterdir())


def test_numbers_of_numpy_are_written_as_what_they_are(tmp_path):
    result = example()
    key = ('y2',), 'y2'
    result.entries[key] = replace(
        result[key], noise=Noise(np.float64(0.1), np.float64(0.2), np.bool_(True)),
        proof=Proof(np.int64(0), np.int64(1), (), ()))
    result.save(tmp_path / 'x.json')
    loaded = Design.load(tmp_path / 'x.json')[key]
    assert (loaded.noise, loaded.proof) == (Noise(0.1, 0.2, True), Proof(0, 1, (), ()))
    assert loaded.noise.assumed is True and type(loaded.proof.upper) is int


_sizes = st.floats(0.0, allow_nan=False, allow_infinity=False)
_open = st.floats(0.0, allow_nan=False)
_numbers = st.floats(allow_nan=False, allow_infinity=False)
_text = st.text(st.characters(categories=('L', 'N', 'P', 'S')), max_size=8)
_certificates = st.one_of(
    st.builds(Certificate, st.just('none'), st.just(0.0), _open,
              arrays(float, (1, 1), elements=_numbers), st.just(()),
              st.none() | st.tuples(_open, _open), _text),
    st.builds(Certificate, st.just('region'), _open, _open,
              arrays(float, (1, 1), elements=st.floats(1e-300, 1e300)),
              st.lists(st.builds(Limit, st.none() | st.just(0), st.just(0),
                                 st.floats(max_value=0.0, allow_nan=False),
                                 st.floats(0.0, exclude_min=True, allow_nan=False)),
                       min_size=1, max_size=2, unique_by=lambda limit: limit.term).map(tuple),
              st.tuples(_open, _open), _text))


@settings(deadline=None, max_examples=80)
@given(proof=st.builds(
           Proof, st.just(1), st.just(1), st.tuples(
               st.builds(OrderStep, st.just(0), st.sampled_from(['impossible', 'open']), _text,
                         st.just(0), st.tuples(_sizes, _open)),
               st.builds(OrderStep, st.just(1), st.sampled_from(['possible', 'open']), _text,
                         st.integers(0, 5), st.tuples(_sizes, _open))),
           st.lists(_text, max_size=2).map(tuple)) | st.none(),
       ladder=st.lists(st.builds(Rung, st.integers(0, 99), _sizes, _sizes, _open, _text),
                       max_size=3).map(tuple),
       noise=st.none() | st.builds(Noise, _sizes, _open, st.booleans()),
       certificate=st.none() | _certificates, grade=st.sampled_from(['exact', 'bounded']),
       disturbance_gain=_sizes, Qu=arrays(float, (1, 1), elements=_numbers),
       Gu=st.tuples(arrays(float, (1, 1), elements=_numbers)))
def test_whatever_is_known_comes_back_to_the_last_bit(tmp_path_factory, **known):
    path = tmp_path_factory.getbasetemp() / 'round_trip.json'
    result = example()
    key = ('y2',), 'y2'
    result.entries[key] = replace(result[key], **known)
    result.save(path)
    same(Design.load(path)[key], result[key])


def test_a_region_of_an_older_file_that_nobody_can_place_is_no_proof(tmp_path):
    path = tmp_path / 'old.json'
    example().save(path)
    record = json.loads(path.read_text())
    as_version_3(record)
    certificate(record, 2)['region'].append({'name': 'x7', 'low': 0.0, 'high': 1.0})
    path.write_text(json.dumps(record))
    loaded = list(Design.load(path).entries.values())[2]
    assert loaded.certificate.status == 'none' and not loaded.certificate.region
    assert loaded.certificate.rate == 0.0 and 'older file' in loaded.certificate.reason


@pytest.mark.parametrize('scale', [1e-10, 1.0, 1e10])
def test_small_numbers_are_told_apart_in_an_older_region(tmp_path, scale):
    """Arguments in pascals have coefficients of any size."""
    path = tmp_path / 'old.json'
    made = example()
    key = ('y2',), 'y2'
    v = made[key]
    term = NonlinearTerm('sqrt(a)', v.terms[0].text, v.terms[0].slope)
    twice = replace(
        v, terms=(*v.terms, term), P=np.hstack([v.P, v.P]),
        Gz=(v.Gz[0] * scale, v.Gz[0] * 2.0 * scale), Gy=(v.Gy[0] * scale, v.Gy[0] * 2.0 * scale),
        Gu=(v.Gu[0], v.Gu[0]), certificate=replace(
            v.certificate, status='region',
            region=(Limit(0, 0, -1.0, 1.0), Limit(1, 0, -2.0, 2.0))))
    made.entries[key] = twice
    made.save(path)
    record = json.loads(path.read_text())
    as_version_3(record)
    path.write_text(json.dumps(record))
    assert Design.load(path)[key].certificate.region == twice.certificate.region


_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(
        st.text(max_size=5), inner, max_size=3), max_leaves=6)
_RECORD: dict = {}


def places(value, path=()):
    yield path
    items = value.items() if isinstance(value, dict) else (
        enumerate(value) if isinstance(value, list) else ())
    for key, inner in items:
        yield from places(inner, (*path, key))


@settings(deadline=None, max_examples=200)
@given(st.data())
def test_any_value_in_any_place_is_read_or_refused_but_never_a_traceback(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp('fuzz', numbered=True)
    path = folder / 'design.json'
    if not _RECORD:
        example().save(path)
        _RECORD.update(json.loads(path.read_text()))
    record = copy.deepcopy(_RECORD)
    place = data.draw(st.sampled_from([p for p in places(record) if p]))
    inner = record
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = data.draw(_values)
    path.write_text(json.dumps(record))
    try:
        loaded = Design.load(path)
    except BadInput as error:
        assert '\n' not in str(error)
    else:
        assert all(np.all(np.isfinite(v.N)) for v in loaded.virtual_sensors)
        assert all(isinstance(v, VirtualSensor) for v in loaded.virtual_sensors)
