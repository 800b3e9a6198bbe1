"""A table keeps every bit, and tells nothing sent from NaN sent."""

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.simulate.fault import drop_out, not_a_number, Recorded
from vsensor_ros.simulate.table import read_table, write_table


def test_round_trip_of_channels_with_their_own_times(tmp_path):
    random = np.random.default_rng(1)
    fast = Recorded.of(0.1 * np.arange(30), random.standard_normal(30))
    slow = Recorded.of(0.5 * np.arange(6), random.standard_normal(6))
    channels = {'y1': drop_out(not_a_number(fast, 1.0, 1.5), 2.0), 'u1': slow}
    write_table(tmp_path / 'table.csv', channels)
    for name, channel in read_table(tmp_path / 'table.csv').items():
        assert_array_equal(channel.time[channel.sent], channels[name].time[channels[name].sent])
        assert_array_equal(channel.value[channel.sent], channels[name].value[channels[name].sent])


@pytest.mark.parametrize('text', [
    '', 'time\n1\n', 'y1,time\n1,2\n', 'time,y1,y1\n0,1,1\n', 'time,y1\n', 'time,y1\n0,1\n0,2\n',
    'time,y1\n0,1,2\n', 'time,y1\n0,one\n', 'time,y1\n,1\n', 'time,y1\nnan,1\n'])
def test_what_is_no_table_is_refused_in_one_line(tmp_path, text):
    (tmp_path / 'table.csv').write_text(text)
    with pytest.raises(BadInput) as refusal:
        read_table(tmp_path / 'table.csv')
    assert 'table.csv' in str(refusal.value) and '\n' not in str(refusal.value)


def test_a_missing_table_is_refused(tmp_path):
    with pytest.raises(BadInput, match='No such file'):
        read_table(tmp_path / 'none.csv')
