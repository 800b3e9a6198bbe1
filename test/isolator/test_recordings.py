"""No channel of a recording is taken for stuck, idle and quantised ones neither."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from vsensor_ros.isolator.channels import Channels

DATA = Path(os.environ.get('VSENSOR_DATA') or 'nowhere')
LAG = 0.05  # s over which the estimates are means: they follow, and are late


def drive():
    data = loadmat(DATA / 'emps' / 'DATA_EMPS.mat')
    return np.hstack([data['qm'], data['qg'], data['vir']]), 0.001


def boards():
    readings = np.asarray(loadmat(DATA / 'tclab' / 'tclab_kuntz_rawlings_2022.mat')
                          ['data']['ydat'][0, 0], dtype=float)
    return readings if len(readings) > len(readings.T) else readings.T, 1.0


def pendulum(number):
    file = DATA / 'double_pendulum' / f'trajectory_{number:02}.csv'
    table = np.loadtxt(file, delimiter=',', skiprows=1)
    return table[:, [1, 2, 3, 4, 13, 14]], float(np.median(np.diff(table[:, 0])))


@pytest.mark.skipif(not DATA.is_dir(), reason='VSENSOR_DATA names no folder')
@pytest.mark.parametrize('recording', [drive, boards, *(
    pytest.param(lambda i=i: pendulum(i), id=f'pendulum {i}') for i in range(5))])
def test_none_is_stuck(recording):
    readings, period = recording()
    count = max(3, round(LAG / period))
    sums = np.cumsum(np.vstack([np.repeat(readings[:1], count, axis=0), readings]), axis=0)
    estimates = (sums[count:] - sums[:-count]) / count
    batch = 4 if period <= 0.02 else 1
    channels = Channels(period, batch, readings.shape[1])
    for start in range(0, len(readings) - batch, batch):
        part = slice(start, start + batch)
        channels.step(readings[part], readings[part] - estimates[part], estimates[part],
                      start < len(readings) // 2)
        assert not channels.stuck(estimates[part][-1]).any(), (start, channels.run)
