"""
A kind of virtual sensors that stands in this file alone: a constant, trusted ever less.

It is registered here and goes from a design through the file, the bank, the engine and the node
onto a topic, with no other file of the package changed.
"""

from dataclasses import dataclass, replace
import json
import math
from pathlib import Path
from typing import ClassVar

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from rclpy.qos import ReliabilityPolicy
from sensor_msgs.msg import Range

from vsensor_ros import Design
from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Bank
from vsensor_ros.designer import design as make_design
from vsensor_ros.engine import Engine, IsolationReport, Live, Policy, Setup, StreamPlan
from vsensor_ros.lab.injection.under_test import read_under_test
from vsensor_ros.node.cdr import decode, Reading
from vsensor_ros.observers.kinds import Batch, Kind, kind_named, register
from vsensor_ros.plant import load_plant
from vsensor_ros.reason import add_sentences, Reason
from vsensor_ros.report.design_answer import answer
from vsensor_ros.report.page import page

MS = 1_000_000
SERVO = Path(__file__).parents[2] / 'config' / 'servo'


@dataclass(frozen=True)
class Constant:
    """What some failed sensors said last year; their error grows with time."""

    channel: str
    fault_set: tuple[str, ...]
    values: dict[str, float]  # by output
    growth: float  # of the standard deviation, 1/s
    good_for: float  # s

    kind: ClassVar[str] = 'constant'
    order: ClassVar[int] = 1
    method: ClassVar[str] = 'by looking it up'
    grade: ClassVar[str] = 'temporary'
    decay: ClassVar[float] = math.inf
    reads: ClassVar[tuple[str, ...]] = ()
    commands: ClassVar[tuple[str, ...]] = ()
    noise = proof = certificate = None

    @property
    def outputs(self):
        return tuple(self.values)


@dataclass(frozen=True, eq=False, kw_only=True)
class Constants(Batch):
    """V constants of O outputs in all; the state of each is whether it has started."""

    entries: tuple[Constant, ...]
    values: np.ndarray  # (O,)

    def start(self, told):
        return np.ones((len(self.entries), 1))

    def step(self, z, before, after, commands):
        return z, np.zeros(len(z), dtype=bool)

    def estimates(self, z, y, held):
        return z[..., self.of, 0] * self.values

    def invalid(self, output, z, told, age):
        limit = self.entries[self.of[output]].good_for
        return Reason.of('expired', seconds=limit) if age > limit else None

    def deviation(self, output, z, told, age):
        return self.entries[self.of[output]].growth * age

    def interval(self, output, z, told, age):
        reach = 3.0 * self.deviation(output, z, told, age)
        return self.values[output] - reach, self.values[output] + reach


def batch(entries, design, period, Cu):
    names = [(e.fault_set, name) for e in entries for name in e.outputs]
    V, outputs = len(entries), len(names)
    nothing = np.zeros((V, len(design.sensors) + len(design.inputs)), dtype=bool)
    return Constants(
        keys=tuple(names), of=np.repeat(np.arange(V), [len(e.values) for e in entries]), width=1,
        runs_on=nothing, starts_on=nothing,
        own=np.array([design.sensors.index(name) for _, name in names]),
        error=np.full(outputs, 0.1), assumed=np.ones(outputs, dtype=bool),
        slowest=np.zeros(outputs), warm_up=np.full(outputs, 0.25),
        proved=np.ones(outputs, dtype=bool), entries=tuple(entries),
        values=np.array([value for e in entries for value in e.values.values()]))


def write(entry):
    return {'values': entry.values, 'growth': entry.growth, 'good_for': entry.good_for}


def read(reader, channel, fault_set, design, version):
    reader.only(('values', 'growth', 'good_for'))
    values = reader.object('values')
    return Constant(channel, fault_set, {name: values.number(name) for name in values.record},
                    reader.size('growth'), reader.size('good_for'))


register(Kind('constant', write, read, batch))
add_sentences({'expired': 'no longer good after {seconds} s'})
BOTH = Constant('y2', ('y2', 'y3'), {'y2': 4.0, 'y3': -2.0}, 0.5, 1.0)


@pytest.fixture(name='mixed')
def _mixed(bench):
    """Make a design with two functional entries, of different orders, and two constants."""
    more = {'healthy': ('y2', 'y3'), 'inputs': ('u',)}
    made = bench.design(
        replace(bench.virtual_sensor([[-2.0]], [[2.0, 0.0]], **more), Phi=np.ones((1, 2))),
        bench.virtual_sensor([[-1.0, 1.0], [0.0, -2.0]], [[0.0], [1.0]], Q=[[0.5]], channel='v',
                             fault_set=('y1', 'y2'), healthy=('y3',), inputs=('u',)),
        names=('y1', 'y2', 'y3'), inputs=('u',), wanted=('v',))
    return replace(made, states=('x1', 'x2'), entries={
        **{(BOTH.fault_set, name): BOTH for name in BOTH.outputs}, **made.entries,
        (('y3',), 'y3'): Constant('y3', ('y3',), {'y3': 7.0}, 0.0, 1e9)})


@pytest.fixture(name='saved')
def _saved(mixed, tmp_path):
    path = tmp_path / 'mixed.design.json'
    mixed.save(path)
    return path


def test_it_goes_through_the_file(mixed, saved):
    loaded = Design.load(saved)
    assert list(loaded.entries) == list(mixed.entries)
    assert [v.kind for v in loaded.virtual_sensors] == [
        'constant', 'functional', 'functional', 'constant']
    assert loaded[('y2', 'y3'), 'y2'] is loaded[('y3', 'y2'), 'y3'] and \
        loaded[('y2', 'y3'), 'y2'] == BOTH
    record = json.loads(saved.read_text())
    assert [entry['kind'] for entry in record['entries']] == [
        'constant', 'functional', 'functional', 'constant']
    assert record['entries'][0] == {'kind': 'constant', 'channel': 'y2', 'fault_set': ['y2', 'y3'],
                                    'values': {'y2': 4.0, 'y3': -2.0}, 'growth': 0.5,
                                    'good_for': 1.0}


@pytest.mark.parametrize(('change', 'said'), [
    ({'kind': 'contsant'},
     r'entries\[0\].kind: contsant is not one of functional, .*constant'),
    ({'kind': 'vsensor_ros.node'}, r'entries\[0\].kind: vsensor_ros.node is not one of'),
    ({'growth': -1.0}, r'entries\[0\].growth: must not be negative'),
    ({'growth': 'fast'}, r'entries\[0\].growth: must be a number'),
    ({'values': {'y2': [4.0]}}, r'entries\[0\].values.y2: must be a number'),
    ({'values': {'y2': 4.0, 'y1': 1.0}}, r'entries\[0\].outputs: are not its channel and others'),
    ({'values': {'y3': 4.0}}, r'entries\[0\].outputs: are not its channel and others'),
    ({'N': [[-1.0]]}, r'entries\[0\].N: is not a key of the design file'),
    ({'fault_set': ['y2']}, r'entries\[0\].outputs: are not its channel'),
])
def test_what_is_wrong_with_it_is_one_line(saved, change, said):
    record = json.loads(saved.read_text())
    record['entries'][0].update(change)
    saved.write_text(json.dumps(record))
    with pytest.raises(BadInput, match=said) as caught:
        Design.load(saved)
    assert '\n' not in str(caught.value) and str(saved) in str(caught.value)


def test_an_output_of_another_entry_is_refused(saved):
    record = json.loads(saved.read_text())
    record['entries'].append({**record['entries'][0], 'channel': 'y3', 'values': {'y3': 1.0}})
    saved.write_text(json.dumps(record))
    with pytest.raises(BadInput, match='y3 stands there twice for this fault set'):
        Design.load(saved)


def test_it_goes_through_the_bank(saved):
    bank, key, other = Bank(Design.load(saved), 100), (('y2', 'y3'), 'y2'), (('y3', 'y2'), 'y3')
    assert bank.entry(*other) == BOTH
    assert bank.why_not(*key) == Reason.of('about to start') and bank.interval(*key) is None
    for now in range(0, 1510, 10):
        bank.take('y1', now * MS, 1.0)
        bank.advance(now * MS)
        age = now / 1000
        assert (bank.estimate(*key), bank.estimate(*other)) == (4.0, -2.0)
        # what the design says of its error, and what its kind says of its age
        assert bank.deviation(*key) == pytest.approx(math.hypot(0.1, 0.5 * age))
        assert bank.interval(*other) == pytest.approx((-2.0 - 1.5 * age, -2.0 + 1.5 * age))
        assert bank.waiting(*key) == pytest.approx(max(0.0, 0.25 - age))
        assert bank.ready(*key) is (0.25 <= age <= 1.0)
        if age < 0.25:
            assert bank.why_not(*key) == Reason.of('converging', seconds=bank.waiting(*key))
        else:
            assert bank.why_not(*key) == (
                None if age <= 1.0 else Reason.of('expired', seconds=1.0))
    assert str(bank.why_not(*other)) == 'no longer good after 1.0 s'
    assert bank.ready(('y3',), 'y3') and bank.deviation(('y3',), 'y3') == 0.1


def test_functional_ones_beside_it_say_what_they_say_alone(saved):
    mixed = Design.load(saved)
    alone = replace(mixed, entries={key: e for key, e in mixed.entries.items()
                                    if e.kind == 'functional'})
    banks, rng, said = [Bank(design, 100) for design in (mixed, alone)], \
        np.random.default_rng(1), 0
    for tick in range(600):
        now, late = tick * 10 * MS, int(rng.integers(0, 8)) * 10 * MS
        sample = {name: float(rng.normal()) for name in ('y1', 'y2', 'y3', 'u')}
        for bank in banks:
            for name, value in sample.items():
                if name != 'y2' or not 200 < tick < 280:  # longer than max_age
                    bank.take(name, max(0, now - late * (name == 'y3')), value)
            if tick in (300, 350):
                bank.distrust(['y3'] if tick == 300 else [])
            bank.advance(now)
        for key in alone.entries:
            ask = [(b.estimate(*key), b.ready(*key), b.waiting(*key), b.deviation(*key),
                    b.disagreement(*key), b.residual(*key), b.why_not(*key), b.started(*key),
                    b.outside_region(*key)) for b in banks]
            assert ask[0] == ask[1]
            said += ask[0][0] is not None
            assert banks[0].interval(*key) is None
    assert said > 800


def constant_for_y2(plan, tmp_path, good_for):
    """Save a design in which y2 is replaced by a constant; return the file."""
    path = tmp_path / 'constant.design.json'
    entry = Constant('y2', ('y2',), {'y2': 4.0}, 0.5, good_for)
    replace(plan, entries={**plan.entries, (('y2',), 'y2'): entry}).save(path)
    return str(path)


def test_it_goes_through_the_engine(plan, tmp_path):
    loaded = Design.load(constant_for_y2(plan, tmp_path, 1e9))
    streams = tuple(StreamPlan((s,), f'/{s}_raw', f'/{s}', False) for s in loaded.sensors)
    engine = Engine(Setup(loaded, 100.0, dict.fromkeys(loaded.sensors, 0.5), 10.0, streams, True,
                          Live('stop', 0.0, dict.fromkeys(loaded.sensors, Policy()),
                               dict.fromkeys(loaded.sensors, 0.0))))
    start, said = 1000 * 10**9, []
    engine.activate()
    for tick in range(100):
        now = start + tick * 10 * MS
        engine.look(now, 0.0)
        for i in range(3):
            reading = Reading(None, (1.0,), False, (None,))
            engine.judge(i, reading, None)
            engine.learn(i, reading, now)
        made = engine.isolate(IsolationReport({'y2': now}, frozenset(loaded.sensors))) \
            if tick == 50 else []
        for at in engine.ticks():
            made = [*made, *engine.tick(at)]
        for composition in made:
            engine.done(composition)
            said.append((composition.time, composition.fields[0][1]))
    assert len(said) >= 45
    for time, substitute in said:
        age = (time - start) * 1e-9
        assert substitute.value == 4.0 and substitute.grade == 'temporary'
        assert substitute.deviation == pytest.approx(math.hypot(0.1, 0.5 * age))
        assert substitute.interval == pytest.approx((4.0 - 1.5 * age, 4.0 + 1.5 * age))
    state = engine.snapshot(0.0).channels[1]
    assert (state.source, state.grade, state.serves.kind) == ('virtual', 'temporary', 'constant')
    assert state.interval == said[-1][1].interval and state.residual == -3.0


def test_it_goes_through_the_node_onto_a_topic(rig, parameters, plan, tmp_path):
    r = rig({**parameters, 'design_file': constant_for_y2(plan, tmp_path, 1.0)})
    heard = r.listen('sensor_msgs/msg/Range', '/y2')
    estimates = r.listen('diagnostic_msgs/msg/DiagnosticArray', '/replacer/estimates',
                         ReliabilityPolicy.BEST_EFFORT)
    r.step(*r.healthy(), periods=50)
    r.isolate('y2')
    r.step(*r.healthy(y2=9.0), periods=20)
    told = r.told()['y2']
    assert (told.source, told.grade, told.serves.kind) == ('virtual', 'temporary', 'constant')
    virtual = [decode(Range, raw) for raw in heard[50:]]
    assert len(virtual) >= 20 and {message.range for message in virtual} == {4.0}
    variances = [message.variance for message in virtual]
    assert np.all(np.diff(variances) > 0.0)
    assert variances[-1] == pytest.approx(told.deviation**2, rel=1e-6)
    said = {v.key: float(v.value) for v in decode(DiagnosticArray, estimates[-1]).status[0].values}
    assert (said['low'], said['high']) == pytest.approx(told.interval)
    assert said['high'] - said['low'] == pytest.approx(2 * 3.0 * math.sqrt(
        said['deviation']**2 - 0.1**2))
    r.step(*r.healthy(y2=9.0), periods=60)  # it says itself when it is no longer good
    told = r.told()['y2']
    assert told.source == 'none' and 'no longer good after 1.0 s' in told.reason


def test_people_are_told_of_it(mixed):
    text = answer(mixed)
    for line in ('y2 when y2 and y3 failed: can be replaced for a time\n',
                 'kind              constant', 'found as          by looking it up'):
        assert line in text


@pytest.fixture(name='servo')
def _servo():
    """Return the servo, and a design of it that has constants alone."""
    plant = load_plant(SERVO / 'plant.yaml')
    made = make_design(plant, [('y2',)])
    return plant, replace(made, entries={
        **{(BOTH.fault_set, name): BOTH for name in BOTH.outputs},
        (('y3',), 'y3'): Constant('y3', ('y3',), {'y3': 7.0}, 0.0, 1e9)})


def test_the_report_has_a_section_of_it(servo):
    plant, made = servo
    text = page(plant, made)
    assert text.count('<section') == 3
    assert text.count('<tr><th>kind</th><td>constant</td></tr>') == 3
    assert text.count('<tr><th>found as</th><td>by looking it up</td></tr>') == 3


def test_faults_can_be_injected_into_a_replacer_that_has_it(servo, tmp_path):
    servo[1].save(tmp_path / 'servo.design.json')
    parameters = tmp_path / 'replacer.yaml'
    parameters.write_text((SERVO / 'replacer.yaml').read_text().replace(
        'servo.design.json', str(tmp_path / 'servo.design.json')))
    (tmp_path / 'demo.yaml').write_text('{failed_sensor: y3, simulation: {}}')
    tested = read_under_test(SERVO / 'plant.yaml', parameters, tmp_path / 'demo.yaml', tmp_path,
                             [])
    assert tested.design_file == tmp_path / 'servo.design.json'
    assert (tested.target, tested.virtual.kind, tested.virtual.reads) == ('y3', 'constant', ())
    assert [tested.serves(faulty, 'y3') for faulty in (
        ('y2',), ('y3',), ('y2', 'y3'), ('y1', 'y3'))] == ['real', 'virtual', 'virtual', 'none']
    (tmp_path / 'demo.yaml').write_text('{failed_sensor: y1, simulation: {}}')
    with pytest.raises(BadInput, match='y1 cannot be replaced; let one of y3 fail'):
        read_under_test(SERVO / 'plant.yaml', parameters, tmp_path / 'demo.yaml', tmp_path, [])


def test_a_name_is_taken_once():
    with pytest.raises(ValueError, match='functional: there is a kind of this name already'):
        register(Kind('functional', write, read, batch))
    register(kind_named('constant'))  # the same once more does no harm


def test_a_kind_that_nobody_knows_is_one_line(mixed, tmp_path):
    entry = Strange('y3', ('y3',), {'y3': 7.0}, 0.0, 1.0)
    strange = replace(mixed, entries={(('y3',), 'y3'): entry})
    with pytest.raises(BadInput, match='strange is not one of functional, .*constant'):
        strange.save(tmp_path / 'strange.json')
    with pytest.raises(BadInput, match='strange is not one of functional, .*constant'):
        Bank(strange, 100)


def test_entries_stand_under_just_their_outputs(mixed, tmp_path):
    path = tmp_path / 'x.json'
    copies = {key: replace(BOTH) for key in mixed.entries if key[0] == BOTH.fault_set}
    replace(mixed, entries={**mixed.entries, **copies}).save(path)  # equal, if not the same
    assert Design.load(path)[('y2', 'y3'), 'y3'] == BOTH
    one = {key: e for key, e in mixed.entries.items() if key != (('y2', 'y3'), 'y3')}
    foreign = {**one, (('y3',), 'y3'): BOTH}
    for entries in (one, foreign):
        with pytest.raises(BadInput, match='does not stand under just its fault set and outputs'):
            replace(mixed, entries=entries).save(path)


class Strange(Constant):
    """Of a kind that is not registered."""

    kind = 'strange'
