"""Sensors lost in recordings of a simulated machine: the verdict, the page, the exit status."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
import json
import math
import sys

import numpy as np
import pytest
from scipy.signal import cont2discrete

from vsensor_ros import design, load_plant
from vsensor_ros.bad_input import BadInput
from vsensor_ros.command.replay import _paced, _slow, main
from vsensor_ros.isolator import Settings
from vsensor_ros.recordings import (
    Case,
    judge_trials,
    Loss,
    Recording,
    replay,
    run_trials,
    settings,
    Track,
    Windows,
)
from vsensor_ros.recordings.aligned_table import write_aligned
from vsensor_ros.recordings.fault import fault, KINDS
from vsensor_ros.recordings.peers import peers
from vsensor_ros.recordings.replay_text import lines_of
from vsensor_ros.recordings.requirement import check, read_requirements
from vsensor_ros.recordings.trials import shares

RATE, NOISE = 25.0, 0.01
PLANT = """
name: heater
time: continuous
states:
  inner: {unit: degC}
  outer: {unit: degC}
inputs:
  power: {unit: W}
dynamics:
  inner: -inner + 0.3*outer + power
  outer: inner - 1.5*outer
sensors:
  a: {measures: inner, noise: 0.01}
  b: {measures: outer, noise: 0.01}
"""
WINDOWS = Windows(6.0, 1.5, 8.0)


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp('plant') / 'plant.yaml'
    path.write_text(PLANT)
    return design(load_plant(path))


def machine(seconds=30.0, seed=1):
    """Return a recording of the heater, its power changing every second, and the truth."""
    rng, count = np.random.default_rng(seed), round(seconds * RATE)
    A, B = np.array([[-1.0, 0.3], [1.0, -1.5]]), np.array([[1.0], [0.0]])
    Ad, Bd, *_ = cont2discrete((A, B, np.eye(2), np.zeros((2, 1))), 1.0 / RATE)
    power = np.repeat(rng.uniform(0.0, 2.0, math.ceil(seconds)), round(RATE))[:count]
    x = np.zeros((count, 2))
    for k in range(1, count):
        x[k] = Ad @ x[k - 1] + Bd[:, 0] * power[k - 1]
    t = np.arange(count) / RATE
    said = {'a': x[:, 0], 'b': x[:, 1]}
    return Recording({'power': Track.of(t, power), **{
        name: Track.of(t, v + NOISE * rng.standard_normal(count)) for name, v in said.items()}},
        'heater'), said


@pytest.fixture(scope='module')
def judged(made):
    recording, _ = machine()
    trials = run_trials(settings(made, RATE), [recording], [
        *(Case(('a',), kind) for kind in KINDS), Case(('b',), 'drop_out')], WINDOWS,
        {'a': 0.5, 'b': 0.5})
    return trials, judge_trials(settings(made, RATE), trials)


def test_a_good_model_is_near_the_truth_and_honest(judged):
    _, judgements = judged
    assert len(judgements) == len(KINDS) + 1
    for j in judgements:
        assert j.windows == 4 and j.windows_served == 1.0 and j.served > 0.98
        assert j.rmse < 4 * NOISE < j.hold and j.coverage > 0.9
        assert j.coverage1 <= j.coverage <= j.coverage3
        assert j.median <= j.p90 <= j.p99 and j.step < 6 * NOISE
        assert j.why == {} and j.until == math.inf and j.rmse < 1.3 * j.arx < j.regression


def test_who_is_told_at_once_does_not_mind_the_kind_of_fault(judged):
    trials, _ = judged
    first, *rest = ([s['a'].values for _, _, s in trials.heard[Case(('a',), kind)]]
                    for kind in KINDS)
    for other in rest:
        np.testing.assert_array_equal(np.array(first), np.array(other))


def test_a_fault_that_is_told_late_leaves_its_mark(made):
    recording, _ = machine()
    setup = settings(made, RATE)
    made_ = run_trials(setup, [recording], [Case(('b',), 'bias'), Case(('b',), 'drop_out')],
                       WINDOWS, {'b': 2.0}, told=0.5)
    for case, said in made_.heard.items():
        for _, loss, by_name in said:
            out = np.isfinite(by_name['b'].values)
            assert not out[by_name['b'].times < loss.start + 0.4].any(), case
            assert out[by_name['b'].times > loss.start + 0.6].all(), case


@pytest.mark.parametrize('jobs', [2, 3])
def test_jobs_say_the_same_to_the_last_bit(made, judged, jobs):
    recording, _ = machine()
    cases = [Case(('a',), 'noise'), Case(('b',), 'drop_out')]
    told = []
    with ThreadPoolExecutor(jobs) as executor:
        trials = run_trials(settings(made, RATE), [recording], cases, WINDOWS,
                            {'a': 0.5, 'b': 0.5}, jobs=jobs, executor=executor,
                            progress=lambda *given: told.append(given))
    for case in cases:
        for (_, loss, said), (_, other, alone) in zip(trials.heard[case], judged[0].heard[case]):
            assert loss.start == other.start
            for name in case.names:
                assert repr(said[name].values.tolist()) == repr(alone[name].values.tolist())
    assert told[0][:2] == (0, 8)


def test_a_window_before_anything_was_said_leaves_the_others_their_hold_and_step(made):
    recording, _ = machine()
    setup = settings(made, RATE)
    case = [Case(('b',), 'drop_out')]
    first, rest = (judge_trials(setup, run_trials(setup, [recording], case, Windows(
        10.0, 2.0, start), {}))[0] for start in (0.0, 10.0))
    assert first.windows == 3 and rest.windows == 2
    assert first.hold == pytest.approx(rest.hold) and np.isfinite(first.step)


def test_jobs_share_all_windows_evenly():
    starts = np.arange(10.0, 3600.0, 60.0)
    for jobs, lost in ((1, 10.0), (2, 40.0), (3, 0.1), (100, 10.0)):
        parts = shares(starts, jobs, lost)
        np.testing.assert_array_equal(np.concatenate(parts), starts)
        assert len(parts) <= jobs
        costs = [part[-1] + 5.0 * lost * len(part) for part in parts]
        assert jobs == 100 or len(costs) == jobs and max(costs) - min(costs) <= 10 * lost + 120.0
    assert shares(starts[:0], 2, 1.0) == []


def test_faults_do_what_their_names_say():
    said = {kind: [fault(kind, 7.0, 3.0, 2.0)(t, 1.0) for t in (0.0, 1.0, 2.0)] for kind in KINDS}
    assert said['drop_out'] == [None] * 3 and said['freeze'] == [7.0] * 3
    assert said['bias'] == [4.0] * 3 and said['drift'] == [1.0, 2.5, 4.0]
    assert np.isnan(said['nan']).all()
    noise = fault('noise', 7.0, 3.0, 2.0)
    drawn = [noise(0.0, 1.0) for _ in range(4000)]
    assert abs(np.std(drawn) - 1.0) < 0.05 and abs(np.mean(drawn) - 1.0) < 0.06


def test_a_static_relation_is_won_by_a_regression(made):
    recording, truth = machine()
    a = recording.tracks['a']
    lying = replace(recording, tracks={**recording.tracks, 'b': Track(
        a.stamps, 3.0 * truth['a'] - 1.0)})  # the model knows nothing of it
    setup = settings(made, RATE)
    trials = run_trials(setup, [lying], [Case(('b',), 'drop_out')], WINDOWS, {})
    j, = judge_trials(setup, trials)
    assert j.best_peer in ('regression', 'arx') and j.beaten
    assert j.regression == pytest.approx(3.0 * NOISE, rel=0.3) and j.rmse > 0.3
    said, = (line for line in lines_of(j) if line.startswith('A SIMPLE PEER WINS'))
    assert f'a static regression on the other channels {j.regression:.3g}' in said


def test_peers_do_not_win_where_nothing_went_out(judged):
    j = replace(judged[1][0], rmse=math.nan, served=0.0)
    assert not j.beaten and not any('WINS' in line for line in lines_of(j))
    alone = replace(j, hold=math.nan, regression=math.nan, arx=math.nan)
    assert not any('simple peers' in line for line in lines_of(alone))


def test_a_right_model_of_a_noisy_sensor_covers_what_it_says(tmp_path):
    (tmp_path / 'plant.yaml').write_text(PLANT.replace('outer, noise: 0.01', 'outer, noise: 0.2'))
    setup = settings(design(load_plant(tmp_path / 'plant.yaml')), RATE)
    recording, truth = machine(80.0)
    b = recording.tracks['b']
    noise = 0.2 * np.random.default_rng(5).standard_normal(len(b.values))
    noisy = replace(recording, tracks={**recording.tracks, 'b': Track(
        b.stamps, truth['b'] + noise)})
    j, = judge_trials(setup, run_trials(setup, [noisy], [Case(('b',), 'drop_out')], WINDOWS, {}))
    assert j.noise == 0.2 and j.deviation < 0.05
    assert 0.6 < j.coverage1 < 0.76 and 0.92 < j.coverage < 0.98
    assert any('with the noise of a reading 0.20' in line for line in lines_of(j))
    assert not any('noise of a reading' in line for line in lines_of(replace(j, noise=1e-4)))


def test_an_arx_model_finds_a_linear_machine():
    recording, truth = machine(80.0)
    clean = replace(recording, tracks={**recording.tracks, **{
        name: Track(recording.tracks[name].stamps, values) for name, values in truth.items()}})
    windows = Windows(10.0, 3.0, 5.0)
    starts = windows.starts(clean.seconds)
    times = [start + np.arange(round(3.0 * RATE)) / RATE for start in starts]
    found = peers([clean], 'b', ['power'], RATE, windows, times)
    assert found.order >= 2
    for at, arx, static in zip(times, found.arx, found.regression):
        there = clean.tracks['b'].at(at)
        assert np.abs(arx - there).max() < 1e-3 < np.abs(static - there).max()


def test_peers_read_nothing_of_the_windows():
    recording, _ = machine()
    starts = WINDOWS.starts(recording.seconds)
    times = [start + np.arange(round(1.5 * RATE)) / RATE for start in starts]
    before = peers([recording], 'b', ['a', 'power'], RATE, WINDOWS, times)
    b = recording.tracks['b']
    inside = np.zeros(len(b.stamps), bool)
    for start in starts:
        inside |= (b.times > start - 1e-6) & (b.times < start + 1.5 - 1e-6)
    odd = replace(recording, tracks={**recording.tracks, 'b': Track(
        b.stamps, np.where(inside, 77.0, b.values))})
    after = peers([odd], 'b', ['a', 'power'], RATE, WINDOWS, times)
    np.testing.assert_array_equal(before.regression, after.regression)
    np.testing.assert_array_equal(before.arx, after.arx)


def test_times_of_another_day_change_nothing_but_rounding(made):
    recording, _ = machine(14.0)
    shift = 1_700_000_000 * 10**9
    late = Recording({name: Track(t.stamps + shift, t.values, t.origin + shift)
                      for name, t in recording.tracks.items()})
    loss = [Loss(('a',), 9.0, 11.0)]
    (_, now), = replay(settings(made, RATE), recording, loss)
    (_, then), = replay(settings(made, RATE), late, loss)
    np.testing.assert_allclose(then['a'].values, now['a'].values, rtol=1e-9)
    np.testing.assert_allclose(then['a'].times, now['a'].times, atol=1e-6)


def test_requirements_are_read_and_met_or_not(judged):
    _, judgements = judged
    asked = read_requirements('a: rmse < 0.2, coverage > 0.9; *: rmse<hold ; b: p90 >= 9', 'ab')
    outcomes = check(asked, judgements)
    assert [str(r) for r in asked] == ['a: rmse < 0.2', 'a: coverage > 0.9', '*: rmse < hold',
                                       'b: p90 >= 9']
    assert [o.passed for o in outcomes] == [True] * (3 * len(KINDS) + 1) + [False]
    unknown = [replace(judgements[0], rmse=math.nan)]
    assert not any(o.passed for o in check(read_requirements('a: rmse < 9, rmse >= 0', 'ab'),
                                           unknown))


@pytest.mark.parametrize('text, says', [
    ('rmse < 1', 'of no channel'), ('c: rmse < 1', 'no channel that is judged'),
    ('', 'asks nothing'), (' ; ', 'asks nothing'), ('a: rmse', 'no comparison'),
    ('a: error < 1', 'is not measured'),
    ('a: rmse < x', 'no number'), ('a: rmse < nan', 'no number'),
    ('a: rmse < __import__("os")', 'no number')])
def test_a_wrong_requirement_is_one_line(text, says):
    with pytest.raises(BadInput, match=says):
        read_requirements(text, 'ab')


@pytest.fixture
def files(made, tmp_path):
    pytest.importorskip('pyarrow')
    made.save(tmp_path / 'heater.json')
    write_aligned(tmp_path / 'run.parquet', machine()[0])
    (tmp_path / 'set.yaml').write_text('recordings: [run.parquet]\n'
                                       'windows: {every: 6, length: 1.5, start: 8}\n')
    return tmp_path


def test_the_command(files, judged, capsys):
    pytest.importorskip('jinja2')
    pytest.importorskip('matplotlib')
    arguments = [str(files / 'heater.json'), str(files / 'set.yaml'), '--rate', '25',
                 '--require', 'a: rmse < 0.05', '--json', str(files / 'out.json'),
                 '--report', str(files / 'out.html')]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert 'PASS: all 1 are met' in said and 'a [degC], a lost (drop-out)' in said
    found = json.loads((files / 'out.json').read_text())
    a, b = found['verdicts']
    alone = next(j for j in judged[1] if j.channel == 'a' and j.kind == 'drop_out')
    assert a['rmse'] == alone.rmse and a['until'] is None and found['passed'] is True
    page = (files / 'out.html').read_text()
    assert page.count('<svg') == 6 and '<script' not in page and 'PASS' in page
    assert main([*arguments[:-2], '--require', 'b: rmse < 1e-9']) == 1
    assert 'FAIL: 1 of 2 are not met' in capsys.readouterr().out


def test_what_comes_from_files_is_escaped_on_the_page(made, judged, tmp_path):
    pytest.importorskip('jinja2')
    pytest.importorskip('matplotlib')
    from vsensor_ros.recordings.replay_page import write_page
    trials, judgements = judged
    evil = '<script>$\\frac{x</script>'
    j = judgements[0]
    j = replace(j, unit=evil, why={evil: 1}, shown=tuple(
        replace(w, recording=evil) for w in j.shown))
    write_page(tmp_path / 'page.html', evil, [j], [], trials)
    assert '<script' not in (tmp_path / 'page.html').read_text()


WIRING = """
/**:
  ros__parameters:
    design_file: heater.json
    rate: 25.0
    sensors:
      a: {topic: heat, type: sensor_msgs/msg/JointState, field: 'position[in]'}
      b: {topic: heat, type: sensor_msgs/msg/JointState, field: 'position[out]'}
    commands:
      power: {topic: power, type: std_msgs/msg/Float64, field: data}
"""


def write_bag(path, recording):
    """Write a bag in which both temperatures come in one message."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import get_typestore, Stores
    store = get_typestore(Stores.ROS2_JAZZY)
    T, (a, b, power) = store.types, (recording.tracks[name] for name in ('a', 'b', 'power'))
    with Writer(path, version=9) as writer:
        heat = writer.add_connection('/heat', 'sensor_msgs/msg/JointState', typestore=store)
        told = writer.add_connection('/power', 'std_msgs/msg/Float64', typestore=store)
        for stamp, *values, volt in zip(a.stamps.tolist(), a.values, b.values, power.values):
            header = T['std_msgs/msg/Header'](
                T['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9)), '')
            none = np.zeros(0)
            for connection, message in (
                    (told, T['std_msgs/msg/Float64'](volt)),
                    (heat, T['sensor_msgs/msg/JointState'](
                        header, ['in', 'out'], np.array(values), none, none))):
                writer.write(connection, stamp, store.serialize_cdr(message, connection.msgtype))


def test_a_bag_is_judged_with_the_settings_of_the_node(files, judged, capsys, monkeypatch):
    pytest.importorskip('rclpy')
    pytest.importorskip('rosbags')
    monkeypatch.setenv('AMENT_PREFIX_PATH', sys.prefix)
    write_bag(files / 'bag', machine()[0])
    (files / 'replacer.yaml').write_text(WIRING)
    (files / 'bag.yaml').write_text('recordings: [bag]\nwiring: replacer.yaml\n'
                                    'windows: {every: 6, length: 1.5, start: 8}\n')
    assert main([str(files / 'heater.json'), str(files / 'bag.yaml'), '--lose', 'a', '--faults',
                 'nan', '--json', str(files / 'out.json')]) == 0
    found, = json.loads((files / 'out.json').read_text())['verdicts']
    alone = next(j for j in judged[1] if (j.channel, j.kind) == ('a', 'nan'))
    assert found['rmse'] == pytest.approx(alone.rmse, rel=1e-6) and found['served'] == alone.served


@pytest.mark.parametrize('arguments, says', [
    (['--lose', 'a,c'], 'is no sensor'), (['--faults', 'rust'], 'no kind of fault'),
    (['--size', 'a'], 'NAME=SIZE'), (['--windows', '1'], 'two numbers'),
    (['--windows', '100,90'], 'fits into'), (['--isolator'], 'designer --isolate'),
    (['--require', 'a:'], 'of no channel')])
def test_wrong_arguments_are_one_line(files, capsys, arguments, says):
    assert main([str(files / 'heater.json'), str(files / 'set.yaml'), *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error and error.count('\n') == 1


def test_a_requirement_of_a_channel_that_is_not_lost_is_not_met_in_silence(files, capsys):
    assert main([str(files / 'heater.json'), str(files / 'set.yaml'), '--lose', 'b',
                 '--require', 'a: rmse < 1e-9']) == 2
    assert 'a: is no channel that is judged; choose from b' in capsys.readouterr().err


@pytest.mark.parametrize('option', ['--json', '--report'])
def test_a_file_that_cannot_be_written_is_said_before_the_work(files, capsys, option):
    assert main([str(files / 'heater.json'), str(files / 'set.yaml'), option,
                 str(files / 'nowhere' / 'out')]) == 2
    told = capsys.readouterr()
    assert 'name a file in a folder that exists' in told.err and not told.out


def test_a_peer_that_wins_by_little_is_seen_to(judged):
    j = replace(judged[1][0], rmse=0.0180049, hold=0.0180001, regression=1.0, arx=1.0)
    assert any('0.0180001 against 0.0180049' in line for line in lines_of(j))


def test_where_nothing_went_out_the_best_peer_is_named(judged):
    j = replace(judged[1][0], served=0.0, rmse=math.nan, hold=1.0, regression=0.25, arx=0.5)
    assert any('NOTHING WENT OUT: a static regression' in line and line.endswith('0.25')
               for line in lines_of(j))
    assert not any('WENT OUT' in line or 'WINS' in line
                   for line in lines_of(replace(j, served=1.0)))


@pytest.mark.filterwarnings('error::RuntimeWarning')
def test_an_infinite_reading_leaves_peers_and_faults_finite(made, files, capsys):
    recording, _ = machine()
    a = recording.tracks['a']
    values = a.values.copy()
    values[10] = math.inf
    write_aligned(files / 'run.parquet', replace(recording, tracks={
        **recording.tracks, 'a': Track(a.stamps, values, a.origin)}))
    assert main([str(files / 'heater.json'), str(files / 'set.yaml'), '--lose', 'a', '--rate',
                 '25', '--faults', 'bias', '--told', '0.2', '--json', str(files / 'o')]) == 0
    verdict, = json.loads((files / 'o').read_text())['verdicts']
    assert verdict['rmse'] < 0.05 and verdict['arx'] is not None


def test_slow_sensors_are_waited_for_where_no_parameter_file_says_for_how_long(files, capsys):
    recording, _ = machine()
    b = recording.tracks['b']
    write_aligned(files / 'run.parquet', replace(recording, tracks={
        **recording.tracks, 'b': Track(b.stamps[::20], b.values[::20], b.origin)}))
    assert main([str(files / 'heater.json'), str(files / 'set.yaml'), '--lose', 'a', '--rate',
                 '25', '--json', str(files / 'o')]) == 0
    assert capsys.readouterr().err == \
        'replay: slow sensors are waited for: a node needs sensors.b.max_age: 2.4\n'
    verdict, = json.loads((files / 'o').read_text())['verdicts']
    assert verdict['served'] > 0.9 and verdict['rmse'] < 0.1


def test_a_sensor_that_is_slower_than_its_max_age_is_named(made):
    setup = settings(made, 25.0)
    line, = _slow(setup, {'a': 0.04, 'b': 0.8})
    assert 'b speaks every 0.8 s' in line and 'sensors.b.max_age should be 2.4' in line


def test_the_rate_follows_the_sensors_where_nobody_says_it(made):
    assert _paced(settings(made, 100.0), {'a': 60.0, 'b': 120.0}, None).rate == 10.0 / 60.0
    assert _paced(settings(made, 25.0), {'a': 60.0, 'b': 120.0}, 25.0).rate == 25.0
    assert _paced(settings(made, 100.0), {'a': 0.01, 'b': 120.0}, None).rate == 100.0


def test_windows_without_number_are_one_line(files, capsys):
    assert main([str(files / 'heater.json'), str(files / 'set.yaml'), '--windows', '1e-9,1']) == 2
    assert 'more than 10000 in a recording' in capsys.readouterr().err


def test_a_channel_that_is_not_recorded_is_one_line(files, capsys):
    (files / 'set.yaml').write_text('recordings: [run.parquet]\ncolumns: {a: a, b: b}\n')
    assert main([str(files / 'heater.json'), str(files / 'set.yaml')]) == 2
    assert 'lacks power' in capsys.readouterr().err


@pytest.mark.slow
def test_who_finds_out_alone_is_judged_by_it(tmp_path):
    path = tmp_path / 'plant.yaml'
    path.write_text(PLANT + '  c: {measures: outer, noise: 0.01}\n')
    isolated = design(load_plant(path), isolate=True)
    recording, truth = machine(120.0)
    noise = NOISE * np.random.default_rng(9).standard_normal(len(truth['b']))
    b = recording.tracks['b']
    recording = replace(recording, tracks={**recording.tracks, 'c': Track(
        b.stamps, truth['b'] + noise)})
    setup = replace(settings(isolated, RATE), isolator=Settings(mode='act'))
    trials = run_trials(setup, [recording], [Case(('b',), 'bias'), Case(('b',), 'freeze')],
                        Windows(10.0, 4.0, 100.0), {'b': 0.5}, told=None)
    bias, freeze = judge_trials(setup, trials)
    assert bias.found == 1.0 and 0.0 < bias.delay < 2.0 and bias.blamed == 0.0
    assert bias.alarms == 0.0 and trials.healthy_seconds == pytest.approx(110.0)
    assert freeze.found == 1.0 and freeze.delay > 0.0


def test_a_table_without_windows_has_usual_ones_for_every_kind(files, capsys):
    """Times of theirs are of numpy, and what is said is a float all the same."""
    assert main([str(files / 'heater.json'), str(files / 'run.parquet'), '--rate', '25', '--lose',
                 'a', '--faults', 'all', '--json', str(files / 'out.json')]) == 0
    found = json.loads((files / 'out.json').read_text())['verdicts']
    assert [verdict['kind'] for verdict in found] == list(KINDS)


def test_what_is_too_short_or_would_be_lost_is_one_line(files, capsys):
    short = files / 'short.csv'
    short.write_text('time,a,b,power\n0,1,1,1\n')
    heater = str(files / 'heater.json')
    for words, line in (([str(short)], 'shorter than a step'),
                        ([str(files / 'run.parquet'), '--json', heater], 'would be lost')):
        assert main([heater, *words]) == 2
        said = capsys.readouterr().err
        assert line in said and said.count('\n') == 1
