"""Recordings are found, checked, and read column by column."""

import hashlib

import numpy as np
import pytest
from scipy.io import savemat

from vsensor_ros.bad_input import BadInput
from vsensor_ros.simulate.recording import find_recording, load_columns, NoRecording

NOWHERE = 'http://127.0.0.1:9/x.mat'    # nothing listens on port 9


@pytest.fixture
def recording(tmp_path, monkeypatch):
    path = tmp_path / 'rig' / 'run.mat'
    path.parent.mkdir()
    savemat(path, {'data': {'y': np.arange(6.0).reshape(3, 2), 'k': np.array([3, 4, 5])},
                   'q': np.array([[1.5], [2.5]]), 'text': 'abc'})
    monkeypatch.setenv('VSENSOR_DATA', str(tmp_path))
    return path


def test_found_in_the_folder_and_checked(recording):
    checksum = hashlib.sha256(recording.read_bytes()).hexdigest()
    assert find_recording('rig/run.mat', NOWHERE, checksum) == recording
    with pytest.raises(BadInput, match='sha256'):
        find_recording('rig/run.mat', NOWHERE, '0' * 64)


@pytest.mark.parametrize('folder', [None, 'empty'])
def test_what_is_nowhere_is_said_in_one_line(tmp_path, monkeypatch, folder):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    monkeypatch.delenv('VSENSOR_DATA', raising=False)
    if folder:
        monkeypatch.setenv('VSENSOR_DATA', str(tmp_path / folder))
    with pytest.raises(NoRecording, match='VSENSOR_DATA') as refusal:
        find_recording('rig/run.mat', NOWHERE, '0' * 64)
    assert '\n' not in str(refusal.value)


def test_columns(recording):
    found = load_columns(recording, {'a': 'data.y[1]', 'b': 'data.k', 'c': 'q'})
    np.testing.assert_array_equal(found['a'], [1, 3, 5])
    np.testing.assert_array_equal(found['b'], [3, 4, 5])
    np.testing.assert_array_equal(found['c'], [1.5, 2.5])


@pytest.mark.parametrize('place', ['data.y', 'data.y[2]', 'data.x', 'none', 'text', 'data[0]',
                                   'data.y[-1]', 'data.__class__', '', 'data.y[1'])
def test_what_is_no_column_is_refused(recording, place):
    with pytest.raises(BadInput, match=r'run\.mat'):
        load_columns(recording, {'a': place})


def test_what_is_no_recording_is_refused(tmp_path):
    (tmp_path / 'run.mat').write_text('time,y\n')
    with pytest.raises(BadInput, match='cannot be read'):
        load_columns(tmp_path / 'run.mat', {'a': 'y'})
