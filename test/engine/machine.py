"""An engine that a test drives: two sensors, one twice the other."""

from dataclasses import replace
from typing import NamedTuple

from vsensor_ros.engine import (
    Engine,
    IsolationReport,
    Live,
    Policy,
    Setup,
    StreamPlan,
)
from vsensor_ros.reason import Reason

SECOND = 10**9
PERIOD = SECOND // 100
ABSENT = Reason.of('not in the message', field='position[a]')


class Said(NamedTuple):
    """A message, as far as an engine is concerned."""

    stamp: int | None
    values: tuple
    foreign: bool = False


def faulty(*names):
    return IsolationReport(dict.fromkeys(names, 0), frozenset(names))


class Machine:
    """Two sensors, y2 twice y1, in one message or each in its own; time goes on by periods."""

    def __init__(self, bench, shared=False, simulated=True, wrap=(), told=None, noise=None,
                 **live):
        twice = [bench.virtual_sensor([], [], Q=[[2.0]], fault_set=('y2',), healthy=('y1',),
                                      noise=noise),
                 bench.virtual_sensor([], [], Q=[[0.5]], fault_set=('y1',), healthy=('y2',),
                                      noise=noise)]
        settings = {'without_estimate': 'stop', 'time_constant': 0.0,
                    'policies': {s: Policy(dwell=0.0) for s in ('y1', 'y2')},
                    'max_deviation': {'y1': 0.0, 'y2': 0.0}, **live}
        streams = (StreamPlan(('y1', 'y2'), '/in', '/out', True),) if shared else (
            StreamPlan(('y1',), '/y1_raw', '/y1', True),
            StreamPlan(('y2',), '/y2_raw', '/y2', True))
        self.setup = Setup(replace(bench.design(*twice), wrap=wrap, **(told or {})), 100.0,
                           {'y1': 0.5, 'y2': 0.5}, 10.0, streams, simulated, Live(**settings))
        self.engine = Engine(self.setup)
        self.shared, self.now, self.sent = shared, 1000 * SECOND, []
        self.engine.look(self.now, 0.0)
        self.engine.activate()

    def hear(self, stream, *values, stamp=None, token='message', received=None, **more):
        message = Said(self.now if stamp is None else stamp, values, **more)
        verdict = self.engine.judge(stream, message, token)
        self.engine.learn(stream, message, received or self.now)
        return verdict

    def step(self, y1, y2, periods=1):
        """Let both sensors speak and time go on; return the verdicts on the last messages."""
        for _ in range(periods):
            self.now += PERIOD
            verdicts = [self.hear(0, y1, y2)] if self.shared else \
                [self.hear(0, y1), self.hear(1, y2)]
            self.pass_time()
        return verdicts

    def pass_time(self, periods=0):
        self.now += periods * PERIOD
        self.engine.look(self.now, 1e-9 * self.now)
        for at in self.engine.ticks():
            self.send(self.engine.tick(at))

    def isolate(self, *names):
        self.send(self.engine.isolate(faulty(*names)))

    def send(self, made):
        for composition in made:
            self.sent.append(composition)
            self.engine.done(composition)

    def state(self, name):
        return next(c for c in self.engine.snapshot(1e-9 * self.now).channels if c.name == name)
