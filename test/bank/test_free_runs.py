"""What goes on from the last good readings: from where, how surely, and why it does not."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from vsensor_ros.bank import Bank, composite, steps
from vsensor_ros.observers import Noise, Told
from vsensor_ros.reason import Reason

MS = 1_000_000
RATE, PERIOD = 50, 20
KEY = (('angle',), 'angle')
NAMES = ('angle', 'tacho')


@pytest.fixture(scope='module')
def made(bench):
    return bench.design(bench.encoder(), names=NAMES)


class Run:
    """A joint and its bank; time [ms] goes on reading by reading."""

    def __init__(self, bench, made, seconds=12.0, seed=0, bank=None, **more):
        self.x, self.y = bench.joint(seconds, seed)
        self.bank = bank or Bank(made, RATE, **more)
        self.k = -1

    def until(self, time, angle=None, silent=(), tacho=None):
        """Go on to a time [ms]; angle: what the encoder says of its reading k."""
        for k in range(self.k + 1, time // PERIOD + 1):
            now = k * PERIOD * MS
            said = self.y[k, 0] if angle is None else angle(k)
            for name, value in (('angle', said), ('tacho', self.y[k, 1])):
                if name not in silent:
                    self.bank.take(name, now, value)
            self.bank.advance(now)
            self.k = k
        return self

    @property
    def error(self):
        return self.bank.estimate(*KEY) - self.x[self.k, 0]

    @property
    def deviation(self):
        return self.bank.deviation(*KEY)


def test_from_the_first_seconds_on_and_as_sure_as_it_says(bench, made):
    """Lost 1.5 s after the start: the error is as large as is stated, and grows as stated."""
    errors, stated = [], []
    for seed in range(16):
        run = Run(bench, made, 6.0, seed).until(1500)
        assert run.bank.ready(*KEY)
        before = run.deviation
        run.bank.distrust({'angle'})
        assert run.deviation == pytest.approx(before, rel=0.05)
        found = []
        for time in (1500, 2500, 5500):
            run.until(time)
            assert run.bank.ready(*KEY) and run.bank.why_not(*KEY) is None
            found.append((run.error, run.deviation))
        errors.append([e for e, _ in found])
        stated.append([d for _, d in found])
    errors, stated = np.array(errors), np.array(stated)
    assert (np.abs(errors) <= 2 * stated).mean() >= 0.9
    rms = np.sqrt(np.mean(errors**2, axis=0))
    assert (rms > 0.6 * stated.mean(axis=0)).all() and (np.diff(stated, axis=1) > 0.0).all()


def test_what_a_fault_does_within_the_guard_never_serves(bench, made):
    """
    It begins at all times before isolation; within the guard it is as if there had been no fault.

    If it began before the guard, but after the rehearsal that was going on, that is gone on with.
    """
    isolated, clean, same = 4000, {}, {}
    sound = Run(bench, made, 5.0).until(isolated)
    sound.bank.distrust({'angle'})
    sound.until(4500)
    for before in (0, 20, 100, 240, 480, 500, 520, 700, 1000, 1900, 2500):
        run = Run(bench, made, 5.0)
        faulty = (isolated - before) // PERIOD
        run.until(isolated, lambda k, run=run, faulty=faulty: run.y[k, 0] + 5.0 * (k >= faulty))
        run.bank.distrust({'angle'})
        run.until(4500)
        assert run.bank.ready(*KEY)
        clean[before] = abs(run.error) <= 3 * run.deviation
        same[before] = run.bank.estimate(*KEY) == sound.bank.estimate(*KEY)
        assert run.deviation == (sound.deviation if same[before] or not clean[before] else
                                 pytest.approx(1.5 * sound.deviation, rel=0.5))
        # the offset of the switch has nothing of the fault, either
        assert not clean[before] or abs(run.bank.disagreement(*KEY).usual) < 10 * sound.deviation
    assert [b for b, good in same.items() if good] == [0, 20, 100, 240, 480, 500]
    assert [b for b, good in clean.items() if not good] == [2500]


@pytest.mark.parametrize(('guard', 'last'), [(0.0, 0), (0.2, 200), (1.0, 1000)])
def test_the_guard_is_a_parameter_and_what_it_needs_is_kept(bench, made, guard, last):
    for before, good in ((last, True), (last + 20, False)):
        run = Run(bench, made, 5.0, guard={'angle': guard})
        # so that no rehearsal is older than the fault
        run.bank._runs._begins = frozenset({(4000 - before) // PERIOD})
        faulty = (4000 - before) // PERIOD
        run.until(4000, lambda k, run=run, faulty=faulty: run.y[k, 0] + 5.0 * (k >= faulty))
        run.bank.distrust({'angle'})
        run.until(4500)
        assert (abs(run.error) <= 3 * run.deviation) == good


def test_an_onset_that_is_known_counts_until_it_is_older_than_what_is_kept(bench, made):
    for before, good in ((600, True), (900, True), (1500, False)):
        run = Run(bench, made, 6.0)
        onset = 4000 - before
        run.until(4000, lambda k, run=run, at=onset: run.y[k, 0] + 5.0 * (k * PERIOD >= at))
        run.bank.distrust({'angle'}, onsets={'angle': onset * MS})
        run.until(4500)
        assert run.bank.ready(*KEY) == good
        if good:
            assert abs(run.error) <= 3 * run.deviation
            assert run.bank.started(*KEY) < onset * MS - 500 * MS
        else:
            assert run.bank.why_not(*KEY).code == 'tracked too long ago'
            assert run.bank.remaining(*KEY, 1.0) == 0.0


def test_of_a_silent_one_from_before_its_last_reading(bench, made):
    run = Run(bench, made, 12.0).until(3000)
    run.until(9000, silent=('angle',))  # held for max_age, and nobody isolates it for long
    run.bank.distrust({'angle'})
    run.until(9500, silent=('angle',))
    assert run.bank.started(*KEY) == (3000 - 520) * MS
    assert run.bank.ready(*KEY) and abs(run.error) <= 3 * run.deviation
    assert run.deviation == pytest.approx(run.bank._measured.growth.stated(0, 7.02))


def test_readings_may_come_late_and_seldom(bench, made):
    """Every fifth reading of the encoder, late by 80 ms, is as good as if it came at once."""
    late, prompt = (Run(bench, made, 8.0) for _ in range(2))
    for k in range(0, 300):
        for run, delay in ((late, 4), (prompt, 0)):
            run.k = k
            run.bank.take('tacho', k * PERIOD * MS, run.y[k, 1])
            if k % 5 == delay and k >= delay:
                run.bank.take('angle', (k - delay) * PERIOD * MS, run.y[k - delay, 0])
            run.bank.advance(k * PERIOD * MS)
    for run in (late, prompt):
        run.bank.distrust({'angle'})
        run.until(7000)
        assert abs(run.error) <= 3 * run.deviation
    assert late.bank.estimate(*KEY) == pytest.approx(prompt.bank.estimate(*KEY), abs=1e-12)


def test_a_late_reading_of_what_it_reads_counts(bench, made):
    prompt, late = (Run(bench, made, 6.0).until(3000) for _ in range(2))
    for run in (prompt, late):
        run.bank.distrust({'angle'})
    prompt.until(4000)
    late.until(3900, silent=())
    for k in range(196, 201):
        late.bank.advance(k * PERIOD * MS)
    for k in range(196, 201):
        late.k = k
        late.bank.take('tacho', k * PERIOD * MS, late.y[k, 1])
    late.until(4020)
    prompt.until(4020)
    assert late.bank.estimate(*KEY) == pytest.approx(prompt.bank.estimate(*KEY), abs=1e-12)


def test_a_loss_steps_what_flies_alone(bench, made, monkeypatch):
    run = Run(bench, made, 6.0).until(3000)
    monkeypatch.setattr(run.bank, '_next', lambda state: pytest.fail('all were stepped anew'))
    run.bank.distrust({'angle'})
    assert run.bank.ready(*KEY) and run.bank.started(*KEY) == 2480 * MS


def test_a_long_way_to_now_is_gone_over_several_ticks_and_leads_to_the_same(
        bench, made, monkeypatch):
    """Late readings come in on the way, and soon after."""
    said = []
    for at_once in (1000, 3):
        monkeypatch.setattr(steps, 'AT_ONCE', at_once)
        run = Run(bench, made, 8.0).until(3000)
        run.bank.distrust({'angle'})
        waited = []
        for k in range(151, 170):
            run.k = k
            # the tacho is late twice: by then the way leads through what it says, or it did
            late = {151: (), 152: (), 155: (151, 152, 153, 154, 155), 153: (), 154: (),
                    163: (), 164: (), 165: (163, 164, 165)}.get(k, (k,))
            for i in late:
                run.bank.take('tacho', i * PERIOD * MS, run.y[i, 1])
            run.bank.advance(k * PERIOD * MS)
            waited.append(not run.bank.ready(*KEY))
            if waited[-1]:
                assert run.bank.why_not(*KEY).code == 'catching up'
                assert run.bank.estimate(*KEY) is None and run.bank.deviation(*KEY) == np.inf
                assert run.bank.remaining(*KEY, 1.0) == 0.0
        # 26 steps: 3 at the loss, and 3 more than there are new ones at each tick
        assert sum(waited) == (0 if at_once > 3 else 6)
        run.until(4000)
        said.append((run.bank.estimate(*KEY), run.deviation, run.bank.started(*KEY)))
    assert said[0] == said[1]


def test_who_serves_is_put_further_back_at_once(bench, made, monkeypatch):
    """It took off when its channel fell silent; isolation knows of an onset before that."""
    run = Run(bench, made, 8.0).until(3000)
    run.until(3700, silent=('angle',))
    monkeypatch.setattr(steps, 'AT_ONCE', 3)
    assert run.bank.ready(*KEY) and run.bank.started(*KEY) == 2480 * MS
    run.bank.distrust({'angle'}, onsets={'angle': 2900 * MS})
    assert run.bank.ready(*KEY) and run.bank.started(*KEY) == 2380 * MS
    run.until(4000, silent=('angle',))
    assert abs(run.error) <= 3 * run.deviation


def test_some_runs_are_stepped_as_all_are(bench, made):
    """To the last bit, be they linear, with terms, or of several kinds; rows may repeat."""
    tank = bench.tank([3.0, 1.0])
    rubbing = bench.servo(-1.0)
    exact = bench.design(bench.encoder(grade='exact'), names=NAMES)
    batches = [
        composite.batch_of(bench.design(tank, inputs=tank.inputs), 1 / RATE, None),
        composite.batch_of(bench.design(rubbing, names=('y1', 'y2', 'y3'), inputs=('u',)),
                           1 / RATE, None),
        composite._composed([composite.batch_of(d, 1 / RATE, None) for d in (exact, made)], 2, 0)]
    rng = np.random.default_rng(0)
    for batch, (L, m) in zip(batches, ((2, 2), (3, 1), (2, 0))):
        R, known = len(batch.runs_on), L + m
        z = rng.uniform(0.1, 1.0, (R, batch.width))
        before, after = (Told(rng.uniform(0.1, 1.0, L), np.ones(known, dtype=bool),
                              rng.standard_normal(m)) for _ in range(2))
        commands = rng.standard_normal((3, m))
        rows = np.array([R - 1, 0, R - 1])
        some, outside = batch.step_of(rows)(z[rows], before, after, commands)
        everyone, out = batch.step(z, before, after, commands)
        assert (some == everyone[rows]).all() and (outside == out[rows]).all()
        said = batch.estimates(z[:batch.size], after.y, after.held)
        for output in range(len(batch.keys)):
            one = batch.estimate(output, z[batch.of[output]], after.y, after.held)
            assert one == pytest.approx(said[output], abs=1e-14)


def test_why_it_does_not_serve(bench, made):
    bank = Bank(made, RATE)
    assert bank.waiting(*KEY) == np.inf and not bank.ready(*KEY)
    run = Run(bench, made, 12.0, bank=bank).until(100)
    assert bank.why_not(*KEY).code.startswith('converging')
    assert bank.waiting(*KEY) < bank.warm_up(*KEY) < 1.0
    bank.distrust({'angle'})  # too soon
    run.until(500)
    assert bank.why_not(*KEY).code == 'not tracked yet' and not bank.ready(*KEY)
    bank.distrust(())
    run.until(2500)
    assert bank.ready(*KEY)  # tracked anew
    bank.distrust({'tacho'})
    assert str(bank.why_not(*KEY)) == 'tacho is isolated' and bank.estimate(*KEY) is None
    bank.distrust(())
    run.until(4500)
    bank.distrust({'angle'})
    run.until(5000)
    assert bank.ready(*KEY)
    run.until(6000, silent=('tacho',))
    assert bank.why_not(*KEY).code == 'input silent' and bank.deviation(*KEY) == np.inf
    run.until(6500)
    assert bank.why_not(*KEY).code == 'track lost' and not bank.ready(*KEY)
    bank.reset()
    run.until(7000)
    assert bank.why_not(*KEY).code == 'not tracked yet'
    bank.distrust(())
    run.until(9500)
    assert bank.ready(*KEY) and bank.why_not(*KEY) is None


def test_lost_again_before_it_is_tracked_again_it_goes_on(bench, made):
    run = Run(bench, made, 8.0).until(3000)
    run.bank.distrust({'angle'})
    run.until(4000)
    began = run.bank.started(*KEY)
    run.bank.distrust(())
    run.until(4060)
    run.bank.distrust({'angle'})
    run.until(6000)
    assert run.bank.started(*KEY) == began and run.bank.ready(*KEY)
    assert abs(run.error) <= 3 * run.deviation


def test_it_goes_on_until_its_channel_could_be_lost_anew(bench, made):
    """For a guard after the sensor is back, nothing else could serve if it were lost."""
    run = Run(bench, made, 8.0).until(3000)
    run.bank.distrust({'angle'})
    run.until(4000)
    run.bank.distrust(())
    for now in range(4020, 6000, PERIOD):
        run.until(now)
        assert run.bank.ready(*KEY) and run.bank.waiting(*KEY) == 0.0
    assert not run.bank._runs.flights  # its tracker is by then what serves


def test_spikes_before_it_begins_do_not_make_a_fault_usual(bench, made):
    run = Run(bench, made, 8.0)
    run.until(3000, lambda k: run.y[k, 0] + 3.0 * (k in (137, 141)))
    run.until(3600)
    run.until(3700, lambda k: run.y[k, 0] + 1.0)
    run.bank.distrust({'angle'})
    assert run.bank.run(*KEY) == 'from the last good readings'
    assert run.bank._runs.seed(0).spread < 0.5
    assert abs(run.bank.disagreement(*KEY).usual) < 0.2


def test_the_way_of_a_long_guard_is_gone_at_once(bench, made):
    run = Run(bench, made, 12.0, guard={'angle': 5.0}).until(10_000)
    run.bank.distrust({'angle'})  # 250 steps
    assert run.bank.ready(*KEY) and abs(run.error) <= 3 * run.deviation


def test_how_long_it_is_good_for(bench, made):
    run = Run(bench, made, 12.0).until(3000)
    whole = run.bank.remaining(*KEY, 0.003)
    run.bank.distrust({'angle'})
    run.until(5000)
    left = run.bank.remaining(*KEY, 0.003)
    assert whole - left == pytest.approx(2.0, abs=0.1) and run.deviation < 0.003
    run.until(5000 + int(1000 * left) - 100)
    assert run.deviation < 0.003
    run.until(5000 + int(1000 * left) + 100)
    assert run.deviation > 0.003 and run.bank.remaining(*KEY, 0.003) == 0.0


def test_a_model_that_is_wrong_shows_while_it_rehearses(bench):
    """The tacho's scale is off by 3 %: the growth is as measured, so that the truth is within."""
    made = bench.design(bench.encoder(gain=1.03), names=NAMES)
    inside, outside = [], []
    for seed in range(6):
        run = Run(bench, made, 26.0, seed).until(20_000)
        computed = run.bank._batch.drift(0, np.array([2.5]))[0]
        run.bank.distrust({'angle'})
        run.until(22_000)
        assert run.deviation > 2 * computed
        inside.append(abs(run.error) <= 2 * run.deviation)
        outside.append(abs(run.error) > 2 * computed)
    assert np.mean(inside) >= 0.9 and np.mean(outside) > 0.5


def test_neither_a_fault_before_its_isolation_nor_a_spike_enters_what_was_rehearsed(bench, made):
    sound, faulty = (Run(bench, made, 24.0) for _ in range(2))
    sound.until(20_000)
    faulty.until(20_000, lambda k: faulty.y[k, 0] + 5.0 * (k * PERIOD > 19_200))
    for run in (sound, faulty):
        run.bank.distrust({'angle'})
        run.until(22_500)
    growth = [run.bank._measured.growth.measured for run in (sound, faulty)]
    assert np.isfinite(growth[0][0, :3]).all() and np.nanmax(growth[1]) < 0.01
    spiky = Run(bench, made, 90.0)
    spiky.until(90_000, lambda k: spiky.y[k, 0] + 5.0 * (k == 2000))
    assert np.nanmax(spiky.bank._measured.growth.measured[0, :3]) < 0.01


def _beside_a_command(bench, error):
    """Return a lag that a command drives: its independent run is good to an error."""
    slow = bench.encoder(grade='exact', noise=Noise(error, error, False))
    return bench.design(replace(
        slow, N=np.array([[-2.0]]), J=np.array([[0.0]]), B=np.array([[2.0]]), inputs=('u',),
        Qu=np.zeros((1, 1)), Gu=(), eigenvalues=np.array([-2.0 + 0j]), tracking=replace(
            slow.tracking, Qu=np.zeros((1, 1)), W=np.array([[4e-5]]))),
        names=NAMES, inputs=('u',))


def _lost_after(steps, bank, said):
    """Let the channel say this of each step, and lose it; yield after each step from then on."""
    for k in range(steps + 525):
        now = k * PERIOD * MS
        bank.take('u', now, 1.0)
        bank.take('angle', now, 1.0 - np.exp(-0.04 * k) + said(k))
        bank.advance(now)
        if k == steps:
            assert bank.ready(*KEY) and bank.run(*KEY) == ''
            bank.distrust({'angle'})
        if k >= steps:
            yield k


def test_what_is_lost_on_its_way_does_not_serve(bench, made, monkeypatch):
    """An infinite deviation is no deviation that nobody stated: it is known that nothing is."""
    run = Run(bench, made).until(3000)
    run.bank.distrust({'angle'})
    run.until(3100)
    assert run.bank.ready(*KEY)
    monkeypatch.setattr(run.bank._deviations, 'along', lambda i, state: np.inf)
    run.until(3200)
    assert not run.bank.ready(*KEY) and run.bank.why_not(*KEY) == Reason('lost on its way')


def test_a_copy_goes_on_by_itself(bench, made):
    """A replay copies the engine at each loss: the copy must not look at the original."""
    copied, alone = (Run(bench, made).until(3000) for _ in range(2))
    copied.bank = deepcopy(copied.bank)
    for run in (copied, alone):
        run.bank.distrust({'angle'})
        run.until(6000)
        assert run.bank.ready(*KEY)
    assert (copied.bank.estimate(*KEY), copied.deviation) == (alone.bank.estimate(*KEY),
                                                              alone.deviation)


def test_the_surer_of_two_runs_serves_and_not_by_turns(bench):
    """An independent run that is good to 0.002 takes over when the free one no longer is."""
    bank, runs, values = Bank(_beside_a_command(bench, 0.002), RATE), [], []
    for _ in _lost_after(75, bank, lambda k: 0.0):
        runs.append(bank.run(*KEY))
        values.append((bank.estimate(*KEY), bank.deviation(*KEY)))
    changes = [a != b for a, b in zip(runs, runs[1:])]
    assert runs[0] != '' and runs[-1] == '' and sum(changes) == 1
    at = changes.index(True)
    assert values[at + 1][1] < 0.8 * values[at][1] * 1.01


@pytest.mark.parametrize(('error', 'fault'), [
    (0.02, 0.5),  # the free run would be the surer, but they do not agree
    (0.003, 0.01)])  # it is hardly surer
def test_what_never_read_the_channel_serves_where_the_other_is_no_surer(bench, error, fault):
    """
    A fault that nobody noticed for longer than the guard is in the free run alone.

    But an independent run that was not compared for long may be off itself.
    """
    bank = Bank(_beside_a_command(bench, error), RATE)
    bank._runs._begins = frozenset()  # no rehearsal shows it
    for k in _lost_after(750, bank, lambda k: fault * (k > 690)):
        assert bank.run(*KEY) == ''
        assert abs(bank.estimate(*KEY) - 1.0 + np.exp(-0.04 * k)) < error
    bank = Bank(_beside_a_command(bench, error), RATE)
    next(_lost_after(250, bank, lambda k: 0.0))
    assert bank.run(*KEY) != ''


def test_each_kind_has_its_own(bench, made):
    """Batches of several kinds, one below the other, say what they say alone."""
    lag = bench.design(bench.virtual_sensor([[-2.0]], [[2.0]], fault_set=('tacho',),
                                            healthy=('angle',)), names=NAMES)
    exact = bench.design(bench.encoder(grade='exact'), names=NAMES)
    parts = [composite.batch_of(d, 1 / RATE, None) for d in (exact, lag, made)]
    composed = composite._composed(parts, 2, 0)
    assert composed.size == 3 and len(composed.runs_on) == 6 and len(composed.tracked) == 2
    rng = np.random.default_rng(0)
    z = rng.standard_normal((len(composed.runs_on), composed.width))
    before, after = (Told(rng.standard_normal(2), np.ones(2, dtype=bool), np.zeros(0))
                     for _ in range(2))
    stepped, _ = composed.step(z, before, after, np.zeros((3, 0)))
    for i, here in enumerate(composed.tracked):
        part, own = parts[composed.tracks[i][0]], composed.tracks[i][1]
        there = part.tracked[own]
        alone = np.zeros((len(part.runs_on), part.width))
        rows = [(here[n], there[n]) for n in range(3)]  # own, tracker, free
        for row, of_part in rows:
            alone[of_part] = z[row]
        alone, _ = part.step(alone, before, after, np.zeros((3, 0)))
        assert all((stepped[row] == alone[of_part]).all() for row, of_part in rows)
        assert here.temporary == there.temporary == (part is parts[2])
        assert (composed.drift(i, np.ones(1)) == part.drift(own, np.ones(1))).all()


def _after_a_gap(bench, seed, other=()):
    """Return a run that lost its channel just after a gap in both sensors of a quarter second."""
    run = Run(bench, bench.design(bench.encoder(), names=(*NAMES, *other)), 9.0, seed).until(6000)
    run.until(6240, silent=NAMES).until(6300, silent=('angle',)).bank.distrust({'angle'})
    return run.until(6500)


def test_a_gap_since_the_clean_state_is_in_the_deviation(bench):
    """Nobody knows what the joint did meanwhile, and that it was heard before says nothing."""
    runs = [_after_a_gap(bench, seed) for seed in range(12)]
    assert np.mean([abs(run.error) <= 2 * run.deviation for run in runs]) >= 0.9


def test_the_loss_of_another_sensor_takes_nothing_off_the_deviation(bench):
    run = _after_a_gap(bench, 0, other=('other',))
    before = run.deviation
    run.bank.distrust({'angle', 'other'})
    assert run.deviation == before and run.until(6600).deviation >= before


def test_gaps_from_before_the_clean_state_are_not_in_the_deviation(bench, made):
    """The channel corrected what they had left, also if the sensor only falls silent."""
    runs = [Run(bench, made, 12.0).until(4000) for _ in range(2)]
    runs[0].until(4240, silent=('tacho',))
    for run in runs:
        run.until(8000).until(9500, silent=('angle',))
        assert run.bank.run(*KEY) != '' and run.bank.ready(*KEY)
    assert runs[0].deviation == pytest.approx(runs[1].deviation, rel=0.1)


def test_nothing_grows_without_end(bench, made):
    run = Run(bench, made, 60.0, guard={'angle': 1.0}).until(5000)
    kept = len(run.bank._past)
    run.until(60_000)
    assert len(run.bank._past) <= kept + 1
    assert len(run.bank._told.samples['angle'].stamps) < 6 * kept
    assert len(run.bank._measured.growth._waiting) < 10
