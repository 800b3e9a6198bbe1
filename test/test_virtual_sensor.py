"""The design file: what is written is read back exactly, and what is wrong is refused."""

import copy
from dataclasses import replace
import json
import os
from pathlib import Path
import stat
from threading import Thread

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from vsensor_ros import Design, design, Plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.virtual_sensor import Refusal, VERSION, VirtualSensor


def servo_design():
    plant = Plant.from_matrices(
        [[0, 1, 0], [0, -1, 1], [0, -1, -1]], [0, 0, 1], np.eye(3), [1, 0, 0], P=[0, -1, 0],
        G=[[0, 1, 0]], nonlinearities=['sign(w1)'], units={'y1': 'rad'})
    return design(plant, [('y1',), ('y2',), ('y2', 'y3')])


@pytest.fixture(name='written')
def _written(tmp_path):
    path = tmp_path / 'servo.design.json'
    servo_design().save(path)
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
    saved, loaded = servo_design(), Design.load(written)
    for name in ('plant_name', 'plant_hash', 'states', 'inputs', 'sensors', 'units',
                 'sample_time', 'fault_sets'):
        assert getattr(loaded, name) == getattr(saved, name)
    assert list(loaded.entries) == list(saved.entries)
    for key, entry in saved.entries.items():
        other = loaded.entries[key]
        assert frozen(entry) == frozen(other)
        if isinstance(entry, Refusal):
            assert other == entry
            continue
        for name in ('Phi', 'N', 'J', 'B', 'P', 'Cv', 'Q', 'z0', 'z0_gain', 'eigenvalues'):
            np.testing.assert_array_equal(getattr(other, name), getattr(entry, name))
            assert getattr(other, name).shape == getattr(entry, name).shape
        for mine, theirs in zip((*entry.Gz, *entry.Gy), (*other.Gz, *other.Gy)):
            np.testing.assert_array_equal(theirs, mine)
        assert [t.text for t in other.terms] == [t.text for t in entry.terms]
        assert (other.reads, other.order, other.active) == (
            entry.reads, entry.order, entry.active)


def frozen(entry):
    """Check that no array can be written to; return how many there are."""
    arrays = [a for value in vars(entry).values()
              for a in (value if isinstance(value, tuple) else (value,))
              if isinstance(a, np.ndarray)]
    arrays += [term.slope for term in getattr(entry, 'terms', ())]
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
}


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
    written.write_text(text.replace('"version": 1', '"version": 1, "version": 1'))
    assert 'version: stands there twice' in refusal_line(written)
    written.write_bytes(b'\xff\xfe\x00')
    assert 'not a text file' in refusal_line(written)
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
                      Cv=[[0.0] * 2], z0=[0.0] * 2, z0_gain=[[0.0] * 2] * 2)
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
        servo_design().save(written)
    assert written.read_bytes() == before
    assert list(written.parent.iterdir()) == [written]


@pytest.mark.parametrize('path', ['no/such/folder.json', '', '.', 'a\0b', 'x' * 300])
def test_save_where_nothing_can_be_written_says_so(tmp_path, path):
    with pytest.raises(BadInput, match='cannot be written'):
        servo_design().save(tmp_path / path)
    assert not list(tmp_path.iterdir())


def test_save_keeps_links_and_modes(written):
    link, dangling = written.with_name('link'), written.with_name('dangling')
    link.symlink_to(written.name)
    dangling.symlink_to('new.json')
    written.chmod(0o640)
    old = os.umask(0o027)
    try:
        for path in (link, dangling):
            servo_design().save(path)
            assert path.is_symlink()
    finally:
        os.umask(old)
    mode = {path.name: stat.S_IMODE(path.lstat().st_mode) for path in written.parent.iterdir()}
    assert mode == {**mode, written.name: 0o640, 'new.json': 0o640} and len(mode) == 4
    assert Design.load(dangling).entries.keys() == Design.load(link).entries.keys()


def test_save_writes_into_a_pipe_and_a_device(tmp_path):
    pipe, read = tmp_path / 'pipe', []
    os.mkfifo(pipe)
    reader = Thread(target=lambda: read.append(json.loads(pipe.read_text())))
    reader.start()
    servo_design().save(pipe)
    reader.join()
    assert read[0]['version'] == VERSION and list(tmp_path.iterdir()) == [pipe]
    servo_design().save('/dev/null')
    assert stat.S_ISCHR(Path('/dev/null').stat().st_mode)


@pytest.mark.parametrize(('change', 'needle'), [
    ({'noise_gain': float('nan')}, r'entries\[1\].noise_gain: is not finite'),
    ({'N': np.array([[-np.inf]])}, r'entries\[1\].N: '),
    ({'method': object()}, 'cannot be written as JSON'),
    ({'method': 'a\nb'}, r'entries\[1\].method: '),
])
def test_save_never_writes_what_load_refuses(tmp_path, change, needle):
    result = servo_design()
    sensor = result.virtual_sensors[0]
    result.entries[sensor.fault_set, sensor.channel] = replace(sensor, **change)
    with pytest.raises(BadInput, match=needle):
        result.save(tmp_path / 'x.json')
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize('key', ['y1', ('y1',), (), ('y1', 'y1', 'y1'), 5, (5, 'y1'),
                                 (('y1',), []), (([],), 'y1')])
def test_a_wrong_key_says_how_to_index(key):
    with pytest.raises(KeyError, match='is not a fault set and a channel'):
        servo_design()[key]


def test_a_key_with_unknown_names_says_which():
    for key in (('y9', 'y1'), (('y1', 9), 'y1')):
        with pytest.raises(KeyError, match='9: no such sensor; there are y1, y2, y3'):
            servo_design()[key]


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


@settings(deadline=None, max_examples=300)
@given(st.data())
def test_any_value_in_any_place_is_read_or_refused_but_never_a_traceback(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp('fuzz', numbered=True)
    path = folder / 'design.json'
    if not _RECORD:
        servo_design().save(path)
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
