"""
A planar arm of n joints from masses and lengths: its plant file.

The equations are of Lagrange, in angles from the vertical, in which the mass matrix is short:
sum_j k_ij cos(t_i - t_j) t_j'' = torque_i - torque_(i+1) - sum_j k_ij sin(t_i - t_j) t_j'^2
- g h_i sin(t_i). The states are the angles of the joints, 0 where the arm hangs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from vsensor_ros.bad_input import BadInput
from vsensor_ros.first_plant.elimination import solved

MOST = 9  # joints, so that their numbers are digits
GRAVITY = 9.81
# s, until friction has taken most of the speed of a link alone: a guess. Of a light one beyond a
# heavy one it must not be so large that a step of 10 ms is too long
COASTS = 0.1


@dataclass(frozen=True)
class Arm:
    """n links; centres [m] of mass from each joint, inertias [kg m^2] about these centres."""

    masses: Sequence[float]  # kg
    lengths: Sequence[float]  # m
    centres: Sequence[float] = ()  # the middle where there are none
    inertias: Sequence[float] = ()  # of slender rods where there are none
    gravity: float = GRAVITY  # m/s^2; 0 where the axes are vertical

    def __post_init__(self) -> None:
        n = len(self.masses)
        if not 1 <= n <= MOST:
            raise BadInput('', '--masses', f'are {n}', f'give 1 to {MOST}, one a link')
        for what, given in (('--lengths', self.lengths), ('--centres', self.centres),
                            ('--inertias', self.inertias)):
            if len(given) != n and (given or what == '--lengths'):
                raise BadInput('', what, f'are {len(given)}, masses {n}', 'give one a link')
        for what, given in (('--masses', self.masses), ('--lengths', self.lengths),
                            ('--centres', self.centres), ('--inertias', self.inertias)):
            for value in given:
                if not value > 0.0 and (what != '--centres' or value < 0.0):
                    raise BadInput('', what, f'{value:g} is not positive', 'give kg, m, kg m^2')
        if self.gravity < 0.0:
            raise BadInput('', '--gravity', f'{self.gravity:g} is negative',
                           'angles are counted from where the arm hangs')


def arm_plant(arm: Arm, name: str = 'arm') -> str:
    """Return the plant file of an arm."""
    n = len(arm.masses)
    joints = range(1, n + 1)
    centres = arm.centres or [length / 2 for length in arm.lengths]
    inertias = arm.inertias or [m * length**2 / 12 for m, length in zip(arm.masses, arm.lengths)]
    lines = [f"""\
# A planar arm, link 1 from the base on. angle1 is counted from where the arm hangs, the others
# from the link before: all 0 is the arm hanging straight down.
name: {name}
description: Planar arm of {n} joint{'s' * (n > 1)}, with gravity and friction.
time: continuous
parameters:
  gravity: {{value: {arm.gravity!r}, unit: m/s^2}}     # 0 where the axes are vertical
  # speed at which Coulomb friction is about full. Below it friction is a guess
  creep: {{value: 0.3, unit: rad/s}}
  # mass of each link with the motor that it carries, its length from joint to joint, how far its
  # centre of mass is from its joint, and its inertia about that centre: CAD, or scale and tape.
  # viscous: torque a rad/s; coulomb: what is left at creeping speed. Both are a guess here: drive
  # each joint at several constant speeds, up and down, and draw torque over speed.
  # fit: what a recording can tell; spread: how far off it may be, one standard deviation"""]
    helds = [GRAVITY * sum(m * length for m, length in zip(arm.masses[i:], arm.lengths[i:]))
             for i in range(n)]  # N m, about what holds the arm stretched out
    turned = [inertia + m * centre**2 for inertia, m, centre in zip(inertias, arm.masses, centres)]
    for i, mass, length, centre, inertia, held, much in zip(
            joints, arm.masses, arm.lengths, centres, inertias, helds, turned):
        coulomb, viscous = _round(0.01 * held), _round(much / COASTS)
        lines.append(f"""\
  mass{i}: {{value: {mass!r}, unit: kg, fit: {_within(mass, 2)}, spread: {_round(0.03 * mass)!r}}}
  length{i}: {{value: {length!r}, unit: m}}
  centre{i}: {{value: {centre!r}, unit: m, fit: {_within(max(centre, length / 10), 2)}}}
  inertia{i}: {{value: {_round(inertia)!r}, unit: kg m^2, fit: {_within(inertia, 3)}}}
  viscous{i}: {{value: {viscous!r}, unit: N m s/rad, fit: {_within(viscous, 10)}, \
spread: {_round(viscous / 5)!r}}}
  coulomb{i}: {{value: {coulomb!r}, unit: N m, fit: {_within(coulomb, 10)}, \
spread: {_round(coulomb / 5)!r}}}""")
    lines.append("""\
states:
  # process_noise: what moves a state besides the equations, per sqrt(s)""")
    lines += [f'  angle{i}: {{unit: rad, process_noise: 1.0e-5, range: [-6.3, 6.3]}}'
              for i in joints]
    lines += [f'  velocity{i}: {{unit: rad/s, process_noise: 0.05, range: [-8.0, 8.0]}}'
              for i in joints]
    lines.append('inputs:')
    for i, held in zip(joints, helds):
        lines.append(f'  torque{i}: {{unit: N m, process_noise: {_round(0.002 * held)!r}}}')
    lines.append('definitions:')
    definitions, accelerations = _equations(n)
    lines += [f'  {key}: {text}' for key, text in definitions.items()]
    lines.append('dynamics:')
    lines += [f'  angle{i}: velocity{i}' for i in joints]
    lines += [f'  velocity{i}: {text}' for i, text in zip(joints, accelerations)]
    lines.append("""\
sensors:
  # noise: standard deviation of a single reading at rest; of an encoder a step over sqrt(12)""")
    lines += [f'  encoder{i}: {{measures: angle{i}, unit: rad, noise: 2.0e-4, tolerance: 0.05}}'
              for i in joints]
    lines += [f'  tacho{i}: {{measures: velocity{i}, unit: rad/s, noise: 0.02, tolerance: 0.2}}'
              for i in joints]
    return '\n'.join(lines) + '\n'


def _equations(n: int) -> tuple[dict[str, str], list[str]]:
    """Return the definitions, and what the velocities' rates are."""
    made: dict[str, str] = {}
    links = range(1, n + 1)
    for i in links:  # angles from the vertical, and their rates
        made[f't{i}'] = ' + '.join(f'angle{k}' for k in range(1, i + 1))
        made[f'w{i}_squared'] = '(' + ' + '.join(f'velocity{k}' for k in range(1, i + 1)) + ')**2'
    for i in links:  # what link i and those that it carries weigh at its end
        made[f'h{i}'] = ' + '.join([f'mass{i}*centre{i}', *(
            f'mass{k}*length{i}' for k in range(i + 1, n + 1))])
        made[f'k{i}{i}'] = ' + '.join([f'inertia{i} + mass{i}*centre{i}**2', *(
            f'mass{k}*length{i}**2' for k in range(i + 1, n + 1))])
        for j in range(1, i):
            made[f'k{i}{j}'] = f'h{i}*length{j}'
            between = ' + '.join(f'angle{k}' for k in range(j + 1, i + 1))
            made[f'm{i}{j}'] = f'k{i}{j}*cos({between})'
            made[f's{i}{j}'] = f'k{i}{j}*sin({between})'
    for i in links:
        made[f'f{i}'] = f'viscous{i}*velocity{i} + coulomb{i}*tanh(velocity{i}/creep)'
    for i in links:
        beyond = f' - (torque{i + 1} - f{i + 1})' if i < n else ''
        turning = ''.join(f' - s{i}{j}*w{j}_squared' for j in range(1, i)) + ''.join(
            f' + s{j}{i}*w{j}_squared' for j in range(i + 1, n + 1))
        made[f'b{i}'] = f'torque{i} - f{i}{beyond}{turning} - gravity*h{i}*sin(t{i})'
    mass = {(i - 1, j - 1): f'{"k" if i == j else "m"}{i}{j}' for i in links
            for j in range(1, i + 1)}
    definitions, found = solved(mass, [f'b{i}' for i in links])
    return {**made, **definitions}, [
        found[0], *(f'{found[i]} - {found[i - 1]}' for i in range(1, n))]


def _round(value: float) -> float:
    return float(f'{value:.4g}')


def _within(value: float, factor: float) -> str:
    return f'[{value / factor:.4g}, {value * factor:.4g}]'
