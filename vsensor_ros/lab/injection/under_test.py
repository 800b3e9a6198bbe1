"""What is known of the replacer under test: its plant, its parameters and its design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer import design as make_design
from vsensor_ros.lab.parameter_file import Parameters, read_parameters
from vsensor_ros.lab.wiring import Wiring, wiring_of
from vsensor_ros.observers import Design, Entry, Refusal
from vsensor_ros.plant import load_plant, Plant
from vsensor_ros.simulate.section import Section


class Belief(NamedTuple):
    """When a sensor is believed again, as its parameters say."""

    recovery: str           # 'automatic', 'hold' or 'latched'
    dwell: float            # s
    silent_is_faulty: bool


@dataclass(frozen=True, eq=False)
class UnderTest:
    """The replacer that faults are injected into, as its files describe it."""

    plant: Plant
    scenario: Path | None           # what drives the plant
    design: Design
    design_file: Path
    parameters: Parameters
    wiring: Wiring
    beliefs: dict[str, Belief]      # by sensor
    max_age: dict[str, float]       # s, by sensor
    without_estimate: str
    target: str                     # the sensor that fails
    alone: bool                     # its own isolator acts, and nobody else isolates
    work: Path                      # an existing folder, for logs

    @property
    def virtual(self) -> Entry:
        """Return the virtual sensor of the target, of whatever kind."""
        found = self.design[(self.target,), self.target]
        assert not isinstance(found, Refusal)
        return found

    @property
    def dwell(self) -> float:
        """Return the longest dwell [s]."""
        return max(belief.dwell for belief in self.beliefs.values())

    @property
    def record(self) -> Path:
        """Return the file in which its own isolator keeps what it has learnt."""
        return self.work / 'isolator.json'

    def serves(self, faulty: Sequence[str], name: str) -> str:
        """Return who must serve a channel in the end: 'real', 'virtual' or 'none'."""
        if name not in faulty:
            return 'real'
        return 'virtual' if any(
            name in v.outputs and set(v.fault_set) >= set(faulty)
            for v in self.design.virtual_sensors) else 'none'

    def arguments(self, simulated: bool) -> list[str]:
        """Return the command line of a replacer; simulated: its time is that of /clock."""
        changed: dict[str, object] = {'use_sim_time': True} if simulated else {}
        if self.alone:
            changed |= {'isolator.mode': 'act', 'isolator.recovery': 'hold',
                        'isolator.record': str(self.record)}
        return self.parameters.command_line(
            self.work / 'changed.yaml', design_file=str(self.design_file), **changed)


def read_under_test(plant_file: Path, params_file: Path, scenario: Path | None, work: Path,
                    ros_args: Sequence[str], alone: bool = False) -> UnderTest:
    """
    Read all, design what is not designed into `work`; raise BadInput.

    scenario: None for the one beside the plant file, if there is one that is simulated. alone:
    nobody but its own isolator isolates.
    """
    plant, parameters = load_plant(plant_file), read_parameters(params_file, ros_args)
    wiring = wiring_of(parameters)
    for name in (*plant.sensors, *plant.inputs):
        if name not in wiring.ports:
            raise BadInput(params_file, name, 'has no topic', f'wire what {plant_file} names')
    for name in ('demo_alone.yaml', 'demo.yaml')[0 if alone else 1:]:
        beside = plant_file.parent / name
        if scenario is None and beside.is_file() and 'simulation' in Section.of(beside).content:
            scenario = beside
    design_file = Path(str(parameters.given.get('design_file', '')))
    if design_file.is_file():
        design = Design.load(design_file)
    else:
        design, design_file = make_design(plant, isolate=alone), work / f'{plant.name}.design.json'
        design.save(design_file)
    if alone and (design.isolability is None or not design.isolability.residuals):
        raise BadInput(design_file, 'isolability', 'no residual tells of a fault',
                       'design with designer --isolate, or leave out --alone')
    beliefs = {name: Belief(parameters.of(name, 'recovery'), parameters.of(name, 'dwell'),
                            parameters.of(name, 'silent') == 'replace') for name in plant.sensors}
    max_age = {name: max(parameters.of(name, 'max_age'), 3.0 / parameters.general('rate'))
               for name in plant.sensors}
    return UnderTest(plant, scenario, design, design_file, parameters, wiring, beliefs, max_age,
                     parameters.general('without_estimate'), _target(design, plant, scenario),
                     alone, work)


def _target(design: Design, plant: Plant, scenario: Path | None) -> str:
    """Return the scenario's failed sensor, else the first that can be replaced."""
    replaceable = [s for s in plant.sensors
                   if any(v.fault_set == (s,) and s in v.outputs for v in design.virtual_sensors)]
    if not replaceable:
        raise BadInput(plant.name, 'sensors', 'none of them can be replaced',
                       'nothing can be tried; see what the designer says')
    given = None if scenario is None else Section.of(scenario)
    if given is None or 'failed_sensor' not in given.content:
        return replaceable[0]
    named = given.text('failed_sensor')
    if named not in replaceable:
        raise given.bad('failed_sensor', f'{named} cannot be replaced',
                        f'let one of {", ".join(replaceable)} fail')
    return named
