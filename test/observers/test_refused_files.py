"""What is wrong with a design file is refused, in one line that says where."""

import copy
from dataclasses import replace
import json

from design_example import certificate, example, first_sensor, GLOBAL, rewrite
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros import Design
from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers import Noise, Proof, VirtualSensor
from vsensor_ros.observers.file import VERSION


def refusal_line(path):
    with pytest.raises(BadInput) as caught:
        Design.load(path)
    line = str(caught.value)
    assert '\n' not in line and str(path) in line
    return line


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


@pytest.mark.parametrize('case', BROKEN)
def test_refused_with_one_line(written, case):
    change, expected = BROKEN[case]
    rewrite(written, change)
    if case == 'not json':
        written.write_text(written.read_text()[:-30])
    assert expected in refusal_line(written)


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


@settings(deadline=None, max_examples=100)
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
