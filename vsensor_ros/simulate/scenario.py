"""A demo scenario: a plant that is simulated or was recorded, and the sensor that dies in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.functions.expression import compile_expression, parse
from vsensor_ros.plant import Plant
from vsensor_ros.simulate.fault import Channel, FAULTS
from vsensor_ros.simulate.recording import find_recording, load_columns
from vsensor_ros.simulate.simulate import readings, simulate

TRUTH_PER_SAMPLE = 5    # the truth is computed this much finer than the sensors sample

_KEYS = {'title', 'failed_sensor', 'faults', 'isolated_at', 'speed', 'bar'}
_SIMULATION = {'duration', 'sensor_rate', 'command_rate', 'inputs'}
_RECORDING = {'file', 'url', 'sha256', 'sample_time', 'first', 'last', 'columns'}


@dataclass(frozen=True, eq=False)
class Scenario:
    """
    All that happens in one run; times in seconds of the run's own time.

    `channels` is what the raw topics carry, the fault included: every sensor and command of the
    plant. `truth` is what the failed sensor measures in fact. `bar` is the largest RMSE allowed,
    in the sensor's unit; `bar_text` says where it comes from.
    """

    title: str
    failed_sensor: str
    unit: str
    failed_at: float
    isolated_at: float
    speed: float
    bar: float
    bar_text: str
    channels: dict[str, Channel]
    truth: Channel
    marks: tuple[tuple[float, str], ...]   # (start, kind) of each fault, in time

    @property
    def start(self) -> float:
        """Return the time of the first row."""
        return float(self.truth.time[0])

    @property
    def end(self) -> float:
        """Return the time of the last row."""
        return float(self.truth.time[-1])

    @property
    def trusted(self) -> float:
        """Return the failed sensor's last reading before its fault."""
        channel = self.channels[self.failed_sensor]
        return float(channel.value[channel.sent & (channel.time < self.failed_at)][-1])


def load_scenario(path: Path, plant: Plant) -> Scenario:
    """Read a demo.yaml and compute, or load, its truth; raise BadInput."""
    given = _Reader.of(path)
    given.expect(_KEYS, {'simulation', 'recording'})
    failed = given.text('failed_sensor')
    if failed not in plant.sensors:
        raise given.bad('failed_sensor', f'{plant.name} has no sensor {failed}',
                        f'name one of {", ".join(plant.sensors)}')
    if 'simulation' in given.content:
        channels, truths = _simulated(given.inner('simulation'), plant)
    elif 'recording' in given.content:
        channels, truths = _recorded(given.inner('recording'), plant)
    else:
        raise given.bad('simulation', 'is missing', 'give a simulation or a recording')
    truth = truths[failed]

    marks = []
    for number, item in enumerate(given.list('faults')):
        fault = given.inner(f'faults[{number}]', item)
        fault.expect({'kind', 'start'}, {'end', 'size', 'rate', 'probability'})
        kind = fault.text('kind')
        if kind not in FAULTS:
            raise fault.bad('kind', f'there is no fault {kind}',
                            f'name one of {", ".join(FAULTS)}')
        numbers = {key: fault.number(key) for key in fault.content if key != 'kind'}
        try:
            channels[failed] = FAULTS[kind](channels[failed], **numbers)
        except TypeError as error:
            raise fault.bad(kind, str(error).split(') ')[-1], 'see simulate/fault.py') from None
        marks.append((fault.number('start'), kind))
    if not marks:
        raise given.bad('faults', 'is empty', 'give at least one')

    bar = given.inner('bar')
    bar.expect({'rmse', 'of'})
    span, text = 1.0, f'{bar.number("rmse"):g} {plant.units.get(failed, "")}'.strip()
    if bar.text('of') == 'range':
        span = float(np.ptp(truth.value))
        if span == 0.0:
            raise bar.bad('of', f'{failed} never moves', 'give inputs that move it')
        text = f'{bar.number("rmse"):g} of the range of {failed} over the run, {span:.3g} ' \
               f'{plant.units.get(failed, "")}'.rstrip()
    elif bar.text('of') != 'unit':
        raise bar.bad('of', f'{bar.text("of")} is not known', 'write range or unit')
    scenario = Scenario(given.text('title'), failed, plant.units.get(failed, ''),
                        min(start for start, _ in marks), given.number('isolated_at'),
                        given.number('speed'), bar.number('rmse') * span, text, channels, truth,
                        tuple(sorted(marks)))
    if not scenario.start < scenario.failed_at <= scenario.isolated_at < scenario.end:
        raise given.bad('isolated_at', 'start, fault, isolation, end are not in this order',
                        f'keep them between {scenario.start:g} and {scenario.end:g} s')
    if scenario.speed <= 0:
        raise given.bad('speed', 'is not positive', 'write 1 for real time')
    return scenario


def _simulated(given: _Reader, plant: Plant) -> tuple[dict[str, Channel], dict[str, Channel]]:
    """Return what every channel says and the truth of every sensor."""
    given.expect(_SIMULATION, {'initial', 'disturbances', 'noise'})
    step = 1.0 / given.number('sensor_rate')
    if plant.sample_time is not None and abs(step / plant.sample_time - 1.0) > 1e-6:
        raise given.bad('sensor_rate', f'{plant.name} is sampled every {plant.sample_time} s',
                        f'write {1.0 / plant.sample_time:g}')
    fine = TRUTH_PER_SAMPLE if plant.sample_time is None else 1
    rows = round(given.number('duration') / step) * fine + 1
    t = np.arange(rows) * step / fine
    held = np.floor(t * given.number('command_rate') + 1e-9) / given.number('command_rate')
    u = given.signals('inputs', plant.inputs)(held).T
    unknown = given.signals('disturbances', plant.disturbances)
    rho = unknown if plant.sample_time is None else unknown(t).T
    start = given.numbers('initial', plant.states)
    x = simulate(plant, t, u, rho, [start.get(name, value)
                                    for name, value in zip(plant.states, plant.initial)])
    noise, random = given.numbers('noise', plant.sensors), np.random.default_rng(0)
    channels, truths = {}, {}
    for name, y in zip(plant.sensors, readings(plant, t, x, u, rho).T):
        truths[name] = Channel.of(t, y)
        said = y[::fine] + noise.get(name, 0.0) * random.standard_normal(len(y[::fine]))
        channels[name] = Channel.of(t[::fine], said)
    first = np.unique(held, return_index=True)[1]
    for name, values in zip(plant.inputs, u.T):
        channels[name] = Channel.of(t[first], values[first])
    return channels, truths


def _recorded(given: _Reader, plant: Plant) -> tuple[dict[str, Channel], dict[str, Channel]]:
    given.expect(_RECORDING)
    columns = given.inner('columns')
    columns.expect({*plant.sensors, *plant.inputs})
    path = find_recording(given.text('file'), given.text('url'), given.text('sha256'))
    found = load_columns(path, {name: columns.text(name) for name in columns.content})
    first, last = int(given.number('first')), int(given.number('last'))
    if not 0 <= first < last < min(len(values) for values in found.values()):
        raise given.bad('last', f'samples {first} to {last} are not in the recording',
                        'see its length')
    index = np.arange(first, last + 1)
    channels = {name: Channel.of(index * given.number('sample_time'), values[index])
                for name, values in found.items()}
    return channels, {name: channels[name] for name in plant.sensors}


@dataclass(frozen=True)
class _Reader:
    """A mapping of a YAML file that answers in the right type, or with one clear line."""

    where: str
    place: str
    content: Mapping[str, Any]

    @classmethod
    def of(cls, path: Path) -> _Reader:
        try:
            content = yaml.safe_load(path.read_text(encoding='utf-8'))
        except OSError as error:
            raise BadInput(path, '', error.strerror or str(error), 'give a demo.yaml') from None
        except (yaml.YAMLError, UnicodeDecodeError) as error:
            raise BadInput(path, '', f'is not YAML: {error}'[:200], 'mend it') from None
        return cls(str(path), '', {}).inner('', content)

    def bad(self, key: str, problem: str, mend: str) -> BadInput:
        return BadInput(self.where, '.'.join(part for part in (self.place, key) if part),
                        problem, mend)

    def inner(self, key: str, content: Any = None) -> _Reader:
        content = self.content.get(key) if content is None else content
        if not isinstance(content, dict) or not all(isinstance(k, str) for k in content):
            raise self.bad(key, 'is not a mapping', 'write name: value pairs')
        return _Reader(self.where, '.'.join(p for p in (self.place, key) if p), content)

    def expect(self, needed: Set[str], optional: Set[str] = frozenset()) -> None:
        for key in sorted(needed - self.content.keys()):
            raise self.bad(key, 'is missing', 'add it')
        for key in sorted(self.content.keys() - needed - optional):
            raise self.bad(key, 'is not known here',
                           f'known are {", ".join(sorted(needed | optional))}')

    def text(self, key: str) -> str:
        value = self.content.get(key)
        if not isinstance(value, str):
            raise self.bad(key, 'is not a text', 'write a text')
        return value

    def number(self, key: str) -> float:
        value = self.content.get(key, np.nan)
        if type(value) not in (int, float) or not np.isfinite(value):
            raise self.bad(key, 'is not a finite number', 'write a number')
        return float(value)

    def list(self, key: str) -> list[Any]:
        value = self.content.get(key)
        if not isinstance(value, list):
            raise self.bad(key, 'is not a list', 'write a list')
        return value

    def numbers(self, key: str, names: tuple[str, ...]) -> dict[str, float]:
        part = self.inner(key, self.content.get(key, {}))
        part.expect(set(), set(names))
        return {name: part.number(name) for name in part.content}

    def signals(self, key: str, names: tuple[str, ...]) -> Callable[[Any], NDArray[np.float64]]:
        """Return expressions of t as a function to (len(names), ...); what is absent is zero."""
        part = self.inner(key, self.content.get(key, {}))
        part.expect(set(), set(names))
        functions = [compile_expression(parse(part.content.get(name, 0.0), self.where,
                                              f'{part.place}.{name}', ['t']), ['t'])
                     for name in names]

        def signals(t: Any) -> NDArray[np.float64]:
            shape = (len(names), *np.shape(t))
            return np.array([np.broadcast_to(f([t]), np.shape(t)) for f in functions]
                            ).reshape(shape)
        return signals
