"""What is known of the replacer under test: its parameter file and its design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer import design as make_design
from vsensor_ros.lab.wiring import read_wiring, Wiring
from vsensor_ros.observers import Design, VirtualSensor
from vsensor_ros.plant import load_plant, Plant


class Policy(NamedTuple):
    """When a sensor is believed again."""

    recovery: str           # 'automatic', 'hold' or 'latched'
    dwell: float            # s
    silent_is_faulty: bool


@dataclass(frozen=True, eq=False)
class Setup:
    """The set-up that faults are injected into."""

    plant: Plant
    design: Design
    design_file: Path
    params_file: Path
    wiring: Wiring
    policies: dict[str, Policy]     # by sensor
    max_age: dict[str, float]       # s, by sensor
    without_estimate: str
    target: str                     # the sensor that fails
    ros_args: tuple[str, ...]       # for all nodes

    @property
    def virtual(self) -> VirtualSensor:
        """Return the virtual sensor of the target."""
        found = self.design[(self.target,), self.target]
        assert isinstance(found, VirtualSensor)
        return found

    def serves(self, faulty: Sequence[str], name: str) -> str:
        """Return who must serve a channel in the end: 'real', 'virtual' or 'none'."""
        if name not in faulty:
            return 'real'
        return 'virtual' if any(
            v.channel == name and set(v.fault_set) >= set(faulty)
            for v in self.design.virtual_sensors) else 'none'

    def arguments(self, *more: str) -> list[str]:
        """Return the command line of a replacer."""
        return ['--ros-args', '--params-file', str(self.params_file),
                '-p', f'design_file:={self.design_file}', *more, *self.ros_args]


def read_setup(plant_file: Path, params_file: Path, scenario: Path | None, work: Path,
               ros_args: Sequence[str]) -> Setup:
    """Read all, design what is not designed into `work`; raise BadInput."""
    plant, wiring = load_plant(plant_file), read_wiring(params_file)
    for name in (*plant.sensors, *plant.inputs):
        if name not in wiring.ports:
            raise BadInput(params_file, name, 'has no topic', f'wire what {plant_file} names')
    given = yaml.safe_load(params_file.read_text(encoding='utf-8'))['replacer']['ros__parameters']

    def look(path: str, default: Any) -> Any:
        at = given
        for key in path.split('.'):
            if path in at:  # written with dots
                return at[path]
            at = at.get(key) if isinstance(at, dict) else None
            if at is None:
                return default
        return default if at == '' else at

    def own(name: str, key: str, general: str, default: Any) -> Any:
        return look(f'sensors.{name}.{key}', look(general, default))

    design_file = Path(look('design_file', ''))
    if design_file.is_file():
        design = Design.load(design_file)
    else:
        design, design_file = make_design(plant), work / f'{plant.name}.design.json'
        design.save(design_file)
    policies = {name: Policy(own(name, 'recovery', 'recovery.policy', 'automatic'),
                             float(own(name, 'dwell', 'recovery.dwell', 2.0)),
                             own(name, 'silent', 'silent_sensor', 'wait') == 'replace')
                for name in plant.sensors}
    max_age = {name: max(float(own(name, 'max_age', 'max_age', 0.5)),
                         3.0 / float(look('rate', 100.0))) for name in plant.sensors}
    return Setup(plant, design, design_file, params_file, wiring, policies, max_age,
                 look('without_estimate', 'stop'), _target(design, plant, scenario),
                 tuple(ros_args))


def _target(design: Design, plant: Plant, scenario: Path | None) -> str:
    """Return the scenario's failed sensor, else the first that can be replaced."""
    replaceable = [s for s in plant.sensors
                   if isinstance(design.entries.get(((s,), s)), VirtualSensor)]
    if not replaceable:
        raise BadInput(plant.name, 'sensors', 'none of them can be replaced',
                       'nothing can be tried; see what the designer says')
    if scenario is not None:
        content = yaml.safe_load(scenario.read_text(encoding='utf-8'))
        named = content.get('failed_sensor') if isinstance(content, dict) else None
        if named in replaceable:
            return str(named)
    return replaceable[0]
