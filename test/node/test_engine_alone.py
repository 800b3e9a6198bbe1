"""What a node's engine was told, told to a bare one: it says the same, to the last bit."""

from dataclasses import replace
import math

import pytest
from sensor_msgs.msg import JointState

from vsensor_ros.engine import Composition, Engine
from vsensor_ros.node import hearing as node_module

RANGE, JOINTS = 'sensor_msgs/msg/Range', 'sensor_msgs/msg/JointState'
ASKED = ('look', 'resume', 'activate', 'judge', 'failed_templates', 'learn', 'unreadable',
         'command', 'count', 'isolate', 'force', 'release', 'clear', 'reset', 'apply', 'ticks',
         'send_at', 'tick', 'done', 'remarks', 'changed', 'heard_any', 'snapshot',
         'reserves')


class Recorded(Engine):
    """An engine that keeps what it was told and what it answered."""

    def __init__(self, setup):
        super().__init__(setup)
        self.setup, self.tape, self.busy = setup, [], False


def recording(name):
    def ask(self, *given, **named):
        if self.busy:  # it asks itself
            return getattr(Engine, name)(self, *given, **named)
        self.busy = True
        try:
            answer = getattr(Engine, name)(self, *given, **named)
        finally:
            self.busy = False
        if name == 'ticks':
            return recorded_ticks(self, answer)
        self.tape.append((name, given, named, kept(answer)))
        return answer
    return ask


def recorded_ticks(engine, ticks):
    """Note each tick when it is asked for: what happens between two of them matters."""
    engine.tape.append(('ticks', (), {}, None))
    for at in ticks:
        engine.tape.append(('next tick', (), {}, at))
        yield at
    engine.tape.append(('next tick', (), {}, None))


for name in ASKED:
    setattr(Recorded, name, recording(name))


def kept(answer):
    """Return an answer as it is now; lists go on changing."""
    return list(answer) if isinstance(answer, list) else answer


def bits(answer):
    """Return what two answers must have in common: all, NaN and the sign of 0 included."""
    return repr(answer)


def played(setup, tape):
    """Tell a bare engine what is on the tape; yield what it says beside what was said."""
    engine, ticks = Engine(setup), iter(())
    for name, given, named, said in tape:
        if name == 'ticks':
            ticks = engine.ticks()
            continue
        answer = next(ticks, None) if name == 'next tick' else \
            getattr(engine, name)(*given, **named)
        yield name, kept(answer), said


@pytest.fixture
def recorded(rig, monkeypatch):
    monkeypatch.setattr(node_module, 'Engine', Recorded)
    return rig


def a_day(r, messages):
    """Let everything happen that an engine is told of."""
    r.step(*messages(0.5), periods=12)
    r.command(1.5)
    r.step(*messages(0.55), periods=60)
    r.isolate('y2')
    r.step(*messages(0.75, 9.0), periods=8)
    for topic in ('/y3_raw', '/joint_states_raw'):
        if topic in r.publishers:
            r.publishers[topic].publish(b'garbage')
    r.step(*messages(0.75, 9.0))
    r.replacer.snapshot()
    r.isolate('y1', 'y2')
    r.command(2.0)
    r.step(*messages(9.0, math.nan), periods=5)
    r.isolate('y2', 'y3')
    r.step(*messages(0.8, 9.0), periods=5)
    r.isolate()
    r.step(*messages(0.8), periods=30)
    with pytest.raises(ValueError, match='cannot be forced'):
        r.replacer.force('y3')
    r.replacer.force('y2')
    r.step(*messages(0.9), periods=8)
    r.step(periods=70)  # all fall silent
    r.step(*messages(0.9), periods=8)
    r.replacer.apply(replace(r.replacer.settings.live, time_constant=0.1,
                             without_estimate='nan'))
    r.replacer.release('y2')
    r.now += 90_000_000_000  # the clock jumps ahead
    r.step(*messages(0.9), periods=8)
    r.isolate('y3')
    r.now -= 95_000_000_000  # and back
    r.step(*messages(0.9), periods=8)
    r.replacer.reset()
    r.replacer.deactivate()
    r.step(*messages(0.9), periods=3)
    r.replacer.activate()
    r.step(*messages(0.9), periods=12)
    r.replacer.snapshot()


@pytest.mark.parametrize('shared', [False, True])
def test_a_bare_engine_says_what_the_node_said(recorded, parameters, joint_parameters, shared):
    given = {**(joint_parameters if shared else parameters), 'recovery.dwell': 0.1,
             'time_constant': 0.2}
    r = recorded(given)

    def messages(y1, y2=None):
        y2 = 2.0 * y1 if y2 is None else y2
        if not shared:
            return r.healthy(y1, y2)
        gripper = JointState(name=['gripper'], position=[y1])  # of another driver
        return [r.arm(y1, y2), r.healthy()[2], ('/joint_states_raw', gripper)]
    heard = r.listen(JOINTS, '/joint_states') if shared else r.listen(RANGE, '/y2')
    a_day(r, messages)
    engine = r.replacer.engine
    made = [m for name, _, _, said in engine.tape if name in ('tick', 'isolate', 'force')
            for m in said]
    assert len(heard) > 100 and len(made) > 50 and isinstance(made[0], Composition)
    assert any(name == 'unreadable' for name, *_ in engine.tape)
    assert shared == any(name == 'judge' and given[1].foreign for name, given, _, _ in
                         engine.tape)
    for name, says, said in played(engine.setup, engine.tape):
        assert bits(says) == bits(said), name


def test_the_tape_would_show_a_difference(recorded, parameters):
    r = recorded({**parameters, 'recovery.dwell': 0.1})
    r.step(*r.healthy(), periods=20)
    r.isolate('y2')
    r.step(*r.healthy(0.75, 9.0), periods=5)
    tape = [(name, given, named, said) if name != 'learn' else
            (name, (given[0], given[1]._replace(values=tuple(
                v + 1e-15 for v in given[1].values)), given[2]), named, said)
            for name, given, named, said in r.replacer.engine.tape]
    assert any(bits(says) != bits(said)
               for _, says, said in played(r.replacer.engine.setup, tape))
