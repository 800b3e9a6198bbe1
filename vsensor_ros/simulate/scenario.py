"""A demo scenario: a plant that is simulated or was recorded, and the sensor that dies in it."""

from __future__ import annotations

from dataclasses import dataclass
from inspect import signature
from pathlib import Path

import numpy as np

from vsensor_ros.plant import Plant
from vsensor_ros.simulate.drive import DRIVE, read_drive
from vsensor_ros.simulate.fault import FAULTS, Recorded
from vsensor_ros.simulate.recording import find_recording, load_columns
from vsensor_ros.simulate.section import Section

TRUTH_PER_SAMPLE = 5    # the truth is computed this much finer than the sensors sample

ALONE = 'by itself'  # in place of a time: nobody isolates the sensor
_KEYS = {'title', 'failed_sensor', 'faults', 'isolated_at', 'speed', 'bar'}
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
    channels: dict[str, Recorded]
    truth: Recorded
    marks: tuple[tuple[float, str], ...]   # (start, kind) of each fault, in time
    alone: bool = False   # nobody isolates it: the replacer's own isolator has to

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
    given = Section.of(path)
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
        kind = fault.text('kind')
        if kind not in FAULTS:
            raise fault.bad('kind', f'there is no fault {kind}',
                            f'name one of {", ".join(FAULTS)}')
        fault.expect({'kind', 'start', *_sizes_of(kind)}, {'end'})
        numbers = {key: fault.number(key) for key in fault.content if key != 'kind'}
        channels[failed] = FAULTS[kind](channels[failed], **numbers)
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
    failed_at = min(start for start, _ in marks)
    alone = given.content['isolated_at'] == ALONE
    scenario = Scenario(given.text('title'), failed, plant.units.get(failed, ''), failed_at,
                        failed_at if alone else given.number('isolated_at'),
                        given.number('speed'), bar.number('rmse') * span, text, channels, truth,
                        tuple(sorted(marks)), alone)
    if not scenario.start < scenario.failed_at <= scenario.isolated_at < scenario.end:
        raise given.bad('isolated_at', 'start, fault, isolation, end are not in this order',
                        f'keep them between {scenario.start:g} and {scenario.end:g} s')
    if scenario.speed <= 0:
        raise given.bad('speed', 'is not positive', 'write 1 for real time')
    return scenario


def _sizes_of(kind: str) -> list[str]:
    """Return the names of the numbers that a kind of fault needs, besides its times."""
    return [p.name for p in signature(FAULTS[kind]).parameters.values()
            if p.kind is p.KEYWORD_ONLY and p.default is p.empty]


def _simulated(given: Section, plant: Plant) -> tuple[dict[str, Recorded], dict[str, Recorded]]:
    """Return what every channel says and the truth of every sensor."""
    given.expect({'duration', 'sensor_rate', 'command_rate', 'inputs'}, DRIVE)
    drive = read_drive(given, plant, given.number('sensor_rate'), given.number('command_rate'))
    fine = TRUTH_PER_SAMPLE if plant.sample_time is None else 1
    rows = round(given.number('duration') * drive.sensor_rate) * fine + 1
    run = drive.run(plant, np.arange(rows) / drive.sensor_rate / fine)
    truths = {name: Recorded.of(run.time, y) for name, y in run.readings.items()}
    return drive.said(run, fine) | run.commands, truths


def _recorded(given: Section, plant: Plant) -> tuple[dict[str, Recorded], dict[str, Recorded]]:
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
    channels = {name: Recorded.of(index * given.number('sample_time'), values[index])
                for name, values in found.items()}
    return channels, {name: channels[name] for name in plant.sensors}
