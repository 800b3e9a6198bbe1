"""Tables of columns: CSV, Parquet, MATLAB; what is suspicious in them; the dataset file."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.recording import main
from vsensor_ros.recordings import (
    Dataset,
    load_dataset,
    read_dataset,
    Recording,
    Track,
    Windows,
    write_dataset,
)
from vsensor_ros.recordings.aligned_table import write_aligned
from vsensor_ros.recordings.columns import Clock, open_table
from vsensor_ros.recordings.survey import ClockTally, Sample
from vsensor_ros.recordings.surveying import survey

pa = pytest.importorskip('pyarrow')
DATA = Path(os.environ.get('VSENSOR_DATA') or 'nowhere')


def written(path, text):
    path.write_text(text, encoding='utf-8')
    return path


def only(path, **keys):
    recording, = Dataset((path,), **keys).load()
    return recording


def codes(path, **keys):
    return {c.name: [w.code for w in c.suspicions]
            for c in survey(path, Dataset((), **keys)).channels}


@pytest.mark.parametrize('head, rows', [
    ('time,a [degC],note\n', '0,1.5,x\n0.1,,y\n0.2,2.5,z\n'),
    ('# of the rig, on a monday\n\n#\ntime,a [degC]\n', '0,1.5\n# rest\n0.1,\n0.2,2.5\n'),
    ('# by us\n# time, a [degC]\n', '0,1.5\n0.1,\n0.2,2.5\n'),
    ('t;a (degC);note\n', '0,0;1,5;x\n0,1;;y\n0,2;2,5;z\n'),
    ('# timestamp\ta [degC]\n', '1700000000000\t1.5\n1700000000100\t\n1700000000200\t2.5\n'),
    ('time,a [degC]\n', '1700000000000000000,1.5\n1700000000100000000,\n'
     '1700000000200000000,2.5\n'),
    ('time,a [degC]\n', '2023-11-14 22:13:20,1.5\n2023-11-14 22:13:20.1,\n'
     '2023-11-14 22:13:20.2,2.5\n'),
    ('time,a [degC]\n', '2023-11-14T22:13:20Z,1.5\n2023-11-14T23:13:20.1+01:00,\n'
     '2023-11-14T22:13:20.2Z,2.5\n')])
def test_a_csv_file_as_people_have_them(tmp_path, head, rows):
    recording = only(written(tmp_path / 'run.csv', head + rows))
    assert list(recording.tracks) == ['a'] and recording.units == {'a': 'degC'}
    np.testing.assert_allclose(recording.tracks['a'].times, [0.0, 0.2], atol=1e-12)
    np.testing.assert_array_equal(recording.tracks['a'].values, [1.5, 2.5])


@pytest.mark.parametrize('text, says', [
    ('', 'has no row'), ('time,a\n', 'has no row'), ('0,1\n1,2\n', 'no line of names'),
    ('time,a\n0,1\n1\n', 'columns'), ('x,a\n0,1\n1,2\n', 'no column that is called time'),
    ('time,a,a\n0,1,2\n', 'each once'), ('time,a\n0,1\n,2\n', 'without a time')])
def test_a_wrong_csv_file_is_one_line(tmp_path, text, says):
    path = written(tmp_path / 'run.csv', text)
    with pytest.raises(BadInput) as raised:
        only(path)
    assert says in str(raised.value) and 'run.csv' in str(raised.value)


def test_a_word_far_down_a_column_is_one_line(tmp_path):
    rows = ''.join(f'{k},{k}\n' for k in range(200_000))
    path = written(tmp_path / 'run.csv', f'time,a\n{rows}200000,oops\n')
    with pytest.raises(BadInput, match='oops'):
        only(path)


def test_a_matlab_file_is_read_by_places(tmp_path):
    path = tmp_path / 'run.mat'
    savemat(path, {'data': {'y': np.arange(12.0).reshape(6, 2), 'u': np.ones(6)}, 'note': 'hello',
                   'gain': 35.0, 'cells': np.array(['a', 1.0], object)})
    assert open_table(path, Clock(period=0.5)).columns == ('data.y[0]', 'data.y[1]', 'data.u')
    recording = only(path, clock=Clock(period=0.5), columns={'b': 'data.y[1]'})
    np.testing.assert_array_equal(recording.tracks['b'].values, np.arange(1.0, 12.0, 2.0))
    np.testing.assert_allclose(recording.tracks['b'].times, 0.5 * np.arange(6))
    with pytest.raises(BadInput, match=r'data\.y\[1\]'):
        only(path, clock=Clock(period=0.5), columns={'b': 'data.z'})
    written(path, 'no matlab file')
    with pytest.raises(BadInput, match='cannot be read'):
        only(path)


@pytest.mark.parametrize('suffix', ['.csv', '.parquet'])
def test_a_table_that_was_written_is_read_the_same(tmp_path, suffix):
    said = Recording({'a': Track.of([0.0, 0.1, 0.3], [0.1, 1 / 3, -2e-17]),
                      'b': Track.of([0.1, 0.25], [1.0, 2.0])}, units={'a': 'm'})
    path = tmp_path / f'table{suffix}'
    write_aligned(path, said)
    back = only(path)
    for name, track in said.tracks.items():
        np.testing.assert_array_equal(back.tracks[name].stamps, track.stamps)
        np.testing.assert_array_equal(back.tracks[name].values, track.values)
    assert suffix == '.csv' or back.units == {'a': 'm'}
    write_aligned(path, said, rate=10.0)
    np.testing.assert_array_equal(only(path).tracks['b'].values, [1.0, 1.0, 2.0])
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_an_interrupted_table_leaves_what_was_there(tmp_path, monkeypatch):
    from pyarrow import parquet
    path = written(tmp_path / 'table.parquet', 'the old one')

    def interrupted(table, beside):
        beside.write_bytes(b'half')
        raise KeyboardInterrupt
    monkeypatch.setattr(parquet, 'write_table', interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_aligned(path, Recording({'a': Track.of([0.0, 0.1], [1.0, 2.0])}))
    assert path.read_text() == 'the old one' and list(tmp_path.iterdir()) == [path]


def test_what_is_suspicious_is_found(tmp_path):
    rng, n = np.random.default_rng(1), 4000
    t = 0.01 * np.arange(n)
    angle = (0.8 * t + np.pi) % (2 * np.pi) - np.pi
    columns = {'smooth': np.cumsum(rng.standard_normal(n)), 'still': np.full(n, 3.0),
               'coarse': np.round(20 * np.sin(t)) * 0.05, 'angle': angle, 'copy': angle,
               'slow': np.repeat(rng.standard_normal(n // 50), 50)}
    t[2000:] += 3.0
    t[1000], t[3000] = t[998], t[2999]
    rows = '\n'.join(','.join(map(repr, map(float, row))) for row in zip(t, *columns.values()))
    found = codes(written(tmp_path / 'run.csv', f'time,{",".join(columns)}\n{rows}\n'))
    clock = ['stamps back', 'stamps twice', 'gaps']
    assert found == {'smooth': clock, 'still': [*clock, 'constant'],
                     'coarse': [*clock, 'mostly held', 'coarse'], 'angle': [*clock, 'wraps'],
                     'copy': [*clock, 'wraps', 'same as another'],
                     'slow': [*clock, 'mostly held']}


def test_a_recording_that_goes_by_in_pieces_is_surveyed_as_a_whole():
    stamps = np.cumsum(np.random.default_rng(2).integers(900, 1100, 700_000))
    whole, pieces = ClockTally(), ClockTally()
    whole.take(stamps)
    for piece in np.array_split(stamps, 371):
        pieces.take(piece)
    assert (pieces.count, pieces.longest) == (whole.count, whole.longest)
    kept, at = Sample(), 0
    for size in (5, 0, 1, 200_001, 7, 300_000):
        kept.take(np.arange(at, at + size, dtype=float))
        at += size
    steps = np.diff(kept.values)
    assert kept.values[0] == 0.0 and (steps == steps[0]).all() and at - kept.values[-1] <= steps[0]


def test_a_dataset_file_comes_back(tmp_path):
    written(tmp_path / 'run.csv', 'when,x,y\n0,1,2\n10,3,4\n')
    said = Dataset((tmp_path / 'run.csv',), None, {'a': 'x'}, Clock('when', 'ms'),
                   Windows(60.0, 10.0, 5.0), {'a': -0.001})
    write_dataset(tmp_path / 'set.yaml', said)
    assert read_dataset(tmp_path / 'set.yaml') == said
    recording, = load_dataset(tmp_path / 'set.yaml')
    np.testing.assert_allclose(recording.tracks['a'].times, [0.001, 0.011])
    np.testing.assert_allclose(Windows(10.0, 4.0, 1.0).starts(30.0), [1.0, 11.0, 21.0])
    assert len(Windows(10.0, 4.0, 1.0, 20.0).starts(30.0)) == 2


@pytest.mark.parametrize('text, says', [
    ('a: 1', 'recordings'), ('recordings: run.csv', 'no list'),
    ('recordings: [run.csv]\nwindow: {}', 'is not known'),
    ('recordings: [run.csv]\nwindows: {every: -1, length: 2}', 'every'),
    ('recordings: [run.csv]\ncolumns: [a]', 'channel: column'),
    ('recordings: [run.csv]\ndelays: {b: 1.0}', 'is no channel'),
    ('recordings: [run.csv]\ntime_unit: h', 'choose from'),
    ('recordings: [gone.csv]', 'is not there'),
    ('recordings: !!python/object/apply:os.getcwd []', 'set.yaml')])
def test_a_wrong_dataset_is_one_line(tmp_path, text, says):
    written(tmp_path / 'run.csv', 'time,x\n0,1\n10,3\n')
    with pytest.raises(BadInput) as raised:
        load_dataset(written(tmp_path / 'set.yaml', text))
    assert says in str(raised.value) and '\n' not in str(raised.value)


def test_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    written(tmp_path / 'run.csv', 'time,temp [degC]\n0,1\n10,3\n')
    written(tmp_path / 'map.yaml', 'T1: temp\n')
    assert main(['run.csv', '--wire', 'map.yaml', '--to', 'out.csv', '--dataset', 'set.yaml',
                 '--windows', '5,2']) == 0
    assert 'T1' in capsys.readouterr().out
    assert (tmp_path / 'out.csv').read_text() == '"time","T1"\n0,1\n10,3\n'
    assert main(['set.yaml']) == 0
    assert '10 s' in capsys.readouterr().out
    assert main(['run.csv', '--to', 'out.xls']) == 2
    assert capsys.readouterr().err == (
        'recording: out.xls: --to: is no kind of table that is written; '
        'end it in .csv or .parquet\n')


def test_a_real_recording():
    if not (DATA / 'double_pendulum').is_dir():
        pytest.skip('VSENSOR_DATA names no folder with double_pendulum')
    found = survey(DATA / 'double_pendulum' / 'trajectory_00.csv', Dataset(()))
    channels = {c.name: c for c in found.channels}
    assert 400 < channels['pos_meas1'].rate < 520
    assert [w.code for w in channels['vel_filt2'].suspicions] == ['same as another']


@pytest.mark.parametrize('text', ['t,a\n1e300,1\n2e300,2\n', 't,a\n0,1\n9000000000000000000,2\n',
                                  't,a\n2023-11-14 22:13:20,1\n,2\n'])
def test_times_that_no_clock_says_are_refused(tmp_path, text):
    with pytest.raises(BadInput, match=r'run\.csv: t: (goes from|has rows without a time)'):
        only(written(tmp_path / 'run.csv', text))


def test_columns_that_are_not_of_numbers_are_said(tmp_path):
    found = survey(written(tmp_path / 'run.csv', 't,a,b\n0,1,1\n1,oops,2\n'), Dataset(()))
    assert [c.name for c in found.channels] == ['b']
    assert 'not numbers in all rows, left out: a' in found.notes


def test_all_is_well_before_the_first_window_as_between_the_others(tmp_path):
    written(tmp_path / 'run.csv', 't,a\n0,1\n1,2\n')
    text = 'recordings: [run.csv]\nwindows: {every: 20, length: 5%s}\n'
    for more, start in (('', 15.0), (', start: 3', 3.0)):
        found = read_dataset(written(tmp_path / 'set.yaml', text % more))
        assert found.windows.start == start
    assert Windows.of('20,5,7') == Windows(20.0, 5.0, 7.0)
    assert Windows.of('20,5').start == 15.0 and Windows.of('5,20').start == 0.0


def test_a_file_that_is_not_there_is_said_to_be_missing(tmp_path):
    with pytest.raises(BadInput, match='is not there'):
        only(tmp_path / 'nothing')
    with pytest.raises(BadInput, match='name a dataset file'):
        read_dataset(tmp_path / 'nothing.yaml')
