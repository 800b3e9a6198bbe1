"""What was learnt comes back from its file, and nothing else does."""

import json

import numpy as np
import pytest
from three_sensors import Machine, of

from vsensor_ros.bad_input import BadInput
from vsensor_ros.isolator import load, save

DESIGN = 'a hash'


@pytest.fixture
def path(machine, tmp_path):
    save(machine.isolator, tmp_path / 'record.json', DESIGN)
    return tmp_path / 'record.json'


def test_a_new_isolator_goes_on_from_what_was_learnt(machine, path):
    new = Machine(seed=5)
    load(new.isolator, path, DESIGN)
    machine.isolator.watch.detector.refresh()
    ours, theirs = new.isolator.watch.detector, machine.isolator.watch.detector
    assert ours.thresholds == pytest.approx(theirs.thresholds, rel=1e-4)
    assert (ours.learnt == theirs.learnt).all()
    stepped = [one.isolator.watch.channels._step for one in (new, machine)]
    assert stepped[0] == pytest.approx(stepped[1], rel=1e-4) and np.isfinite(stepped[0]).all()
    assert new.run(20.0).notes == ()  # it need not learn first
    assert (ours.learnt > theirs.learnt).all()  # but does
    verdict = new.run(10.0, of('a', lambda reading, time, random: reading + 0.2))
    assert verdict.faulty == ('a',)


def test_what_alarms_and_motion_have_taught_comes_back_too(machine, tmp_path):
    watch = machine.isolator.watch
    watch.detector.admit(np.array([1]))
    watch.motion.use()
    save(machine.isolator, tmp_path / 'record.json', DESIGN)
    new = Machine(seed=5)
    load(new.isolator, tmp_path / 'record.json', DESIGN)
    assert new.isolator.watch.detector.taught == pytest.approx(watch.detector.taught, rel=1e-4)
    assert np.isfinite(new.isolator.watch.detector.taught).any(axis=0).tolist() == [0, 1, 0]
    assert new.isolator.watch.motion.range == pytest.approx(watch.motion.range, rel=1e-4)
    assert (watch.motion.range > 0.5).all()


def test_a_record_of_before_there_were_motion_and_steps_still_loads(path):
    forged(path, lambda r: [r.pop('swings'), r.pop('taught'), r.pop('steps')])
    new = Machine(seed=5)
    load(new.isolator, path, DESIGN)
    assert new.run(20.0).notes == ()
    assert (new.isolator.watch.motion.range == 0.0).all()


def test_an_old_record_stays_whole_when_a_new_one_cannot_be_written(machine, path):
    machine.isolator.watch.channels.roughness[0] = np.nan
    before = path.read_text()
    with pytest.raises(BadInput, match='cannot be written'):
        save(machine.isolator, path, DESIGN)
    assert path.read_text() == before and len(list(path.parent.iterdir())) == 1


def forged(path, change):
    record = json.loads(path.read_text())
    change(record)
    path.write_text(json.dumps(record))


@pytest.mark.parametrize('key, change', [
    ('format', lambda r: r.update(format='other')),
    ('version', lambda r: r.update(version=2)),
    ('design', lambda r: r.update(design='of another plant')),
    ('period', lambda r: r.update(period=0.2)),
    ('sensors', lambda r: r.update(sensors=['a', 'c', 'b'])),
    ('residuals', lambda r: r['residuals'].pop()),
    ('learnt', lambda r: r.update(learnt=[-1, 2, 3])),
    ('learnt', lambda r: r.update(learnt=[1e300, 2, 3])),
    ('pairs', lambda r: r.pop('pairs')),
    ('repeats', lambda r: r.update(repeats=[10**9] * 3)),
    ('roughness', lambda r: r.update(roughness=[-1.0, 1.0, 1.0])),
    ('usual_spike', lambda r: r.update(usual_spike=[1e300] * 3)),
    ('blocks[2][1]', lambda r: r['motion']['blocks'][2].__setitem__(1, [-1e308] * 9)),
    ('swings', lambda r: r.update(swings=[[0, 0, 99, 1.0]])),
    ('swings', lambda r: r.update(swings=[[0, 0, 0.5, 1.0]])),
    ('swings', lambda r: r.update(swings=[[0, 0]])),
    ('taught', lambda r: r.update(taught=[[0, 0, 1e300]])),
    ('taught', lambda r: r.update(taught='all')),
    ('taught', lambda r: r.update(taught=[[i, j, 1e75] for i in range(24) for j in range(3)])),
    ('extra', lambda r: r.update(extra=1)),
    ('merged', lambda r: r['maxima']['merged'][0].__setitem__(0, 3)),
    ('blocks', lambda r: r['maxima']['blocks'].pop()),
    ('blocks[0][0]', lambda r: r['maxima']['blocks'][0].__setitem__(0, [1.0] * 10**4)),
    ('blocks[0][1]', lambda r: r['maxima']['blocks'][0].__setitem__(1, ['1.0'])),
])
def test_a_wrong_record_is_refused_in_one_line_and_changes_nothing(path, key, change):
    forged(path, change)
    new = Machine()
    with pytest.raises(BadInput) as refused:
        load(new.isolator, path, DESIGN)
    assert refused.value.key.split('.')[-1] == key
    assert str(path) in str(refused.value) and 'learns anew' in str(refused.value)
    assert new.isolator.watch.detector.learnt.sum() == 0


@pytest.mark.parametrize('text', ['', '[]', '{', '{"learnt": NaN}', '[' * 10**5])
def test_what_is_no_record_is_refused(tmp_path, text):
    (tmp_path / 'record.json').write_text(text)
    with pytest.raises(BadInput, match='record.json') as refused:
        load(Machine().isolator, tmp_path / 'record.json', DESIGN)
    assert 'design file' not in str(refused.value)


def test_a_record_that_cannot_be_read_is_not_called_a_design_file(tmp_path):
    with pytest.raises(BadInput, match='isolation record.*learns anew'):
        load(Machine().isolator, tmp_path, DESIGN)
