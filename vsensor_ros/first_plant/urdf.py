"""A serial chain of a URDF as a plant file. Its bodies are put together by pinocchio."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
import math
from pathlib import Path
import re
from typing import Any
from xml.etree import ElementTree

import numpy as np

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.first_plant.chain import accelerations, Body, CLEAN
from vsensor_ros.first_plant.sheet import add, minus, times, vector
from vsensor_ros.functions.expression import Apply, Name, Node
from vsensor_ros.plant.checked import suggestion
from vsensor_ros.text_file import read_text

LARGEST = 4 * 2**20  # bytes
MOST = 9  # joints, so that their numbers are digits
FEW = 3  # joints: of more the masses have no spread, which would make the filters slow
MOVING = ('revolute', 'continuous', 'prismatic')
_XACRO = re.compile(r'<xacro:|xmlns:xacro=|\$\{|\$\(')
_DEFAULT_SPEED = 5.0  # rad/s or m/s, where the file has no limit


@dataclass(frozen=True)
class Joint:
    """What a URDF says of a joint."""

    name: str
    kind: str
    parent: str
    child: str
    axis: tuple[float, float, float]
    limit: Mapping[str, float]  # lower, upper, effort, velocity, where they are given
    damping: float
    friction: float


def urdf_plant(path: Path, base: str | None = None, tip: str | None = None,
               name: str | None = None) -> str:
    """
    Return the plant file of the chain from a link to another, by default the only one there is.

    Joints beside the chain are held at 0. Raises BadInput, also where pinocchio is missing.
    """
    robot = _robot(path)
    joints = _joints(robot, path)
    links = {link.get('name', '') for link in robot.iter('link')}
    chain = _chain(joints, links, path, base, tip)
    moving = [joint for joint in chain if joint.kind in MOVING]
    for joint in chain:
        if joint.kind not in (*MOVING, 'fixed'):
            raise BadInput(path, joint.name, f'is a joint of the type {shown(joint.kind)}',
                           f'only {", ".join(MOVING)} and fixed ones are known')
    if not 1 <= len(moving) <= MOST:
        raise BadInput(path, '', f'the chain has {len(moving)} joints that move',
                       f'choose one with 1 to {MOST}: --base LINK --tip LINK')
    model = _model(robot, path, [joint.name for joint in moving])
    bodies = _bodies(model, moving, path)
    heading = re.sub(r'\W', '_', name or robot.get('name') or 'robot', flags=re.ASCII)
    return _written(heading if heading[0].isalpha() else f'robot_{heading}', bodies, moving,
                    model, path)


def _robot(path: Path) -> Any:
    """Read the XML, without entities, and take out what has a shape."""
    text = read_text(path, '', 'name a URDF file', LARGEST)
    if _XACRO.search(text):
        raise BadInput(path, '', 'is a xacro file', 'expand it first: xacro FILE > robot.urdf')
    if '<!DOCTYPE' in text or '<!ENTITY' in text:
        raise BadInput(path, '', 'declares a document type or entities, which are not read here',
                       'take the declaration out')
    try:
        robot = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise BadInput(path, '', f'is not XML ({error})', 'name a URDF file') from None
    if robot.tag != 'robot':
        raise BadInput(path, '', f'holds <{robot.tag}>, not <robot>', 'name a URDF file')
    for link in robot.iter('link'):
        for shape in [*link.findall('visual'), *link.findall('collision')]:
            link.remove(shape)
    return robot


def _joints(robot: Any, path: Path) -> list[Joint]:
    found = []
    for element in robot.findall('joint'):
        name = element.get('name') or ''
        ends = [part.get('link') if (part := element.find(end)) is not None else None
                for end in ('parent', 'child')]
        if not name or None in ends:
            raise BadInput(path, name or 'a joint', 'has no name, parent or child',
                           'give all three')
        if element.find('mimic') is not None and element.get('type') in MOVING:
            raise BadInput(path, name, 'mimics another joint', 'make it fixed')

        def numbers(part: str, *keys: str, of: Any = element, joint: str = name,
                    ) -> dict[str, float]:
            there = of.find(part)
            return {} if there is None else {
                key: _number(there.get(key), path, f'{joint}.{part}.{key}')
                for key in keys if there.get(key) is not None}
        axis = element.find('axis')
        xyz = '1 0 0' if axis is None else axis.get('xyz', '1 0 0')
        direction = [_number(part, path, f'{name}.axis') for part in xyz.split()]
        size = math.hypot(*direction)
        if len(direction) != 3 or not size > 0.0:
            raise BadInput(path, f'{name}.axis', f'{shown(xyz)} is no direction',
                           'give three numbers, not all 0')
        dynamics = numbers('dynamics', 'damping', 'friction')
        found.append(Joint(
            name, element.get('type', ''), str(ends[0]), str(ends[1]),
            (direction[0] / size, direction[1] / size, direction[2] / size),
            numbers('limit', 'lower', 'upper', 'effort', 'velocity'),
            dynamics.get('damping', 0.0), dynamics.get('friction', 0.0)))
        if min(found[-1].damping, found[-1].friction) < 0.0:
            raise BadInput(path, f'{name}.dynamics', 'is negative', 'friction opposes the motion')
        low, high = (found[-1].limit.get(end, 0.0) for end in ('lower', 'upper'))
        if low > high:
            raise BadInput(path, f'{name}.limit', f'begins at {low:g}, above its end {high:g}',
                           'exchange lower and upper')
    return found


def _number(text: str | None, path: Path, key: str) -> float:
    try:
        value = float(text or '')
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise BadInput(path, key, f'{shown(text)} is not a number', 'correct it')
    return value


def _chain(joints: list[Joint], links: set[str], path: Path, base: str | None,
           tip: str | None) -> list[Joint]:
    """Return the joints from base to tip."""
    above: dict[str, Joint] = {}
    for joint in joints:
        for link in (joint.parent, joint.child):
            if link not in links:
                raise BadInput(path, joint.name, f'names the link {shown(link)}, which is not '
                               'there', suggestion(link, sorted(links)))
        if joint.child in above:
            raise BadInput(path, joint.child, 'hangs on two joints, '
                           f'{above[joint.child].name} and {joint.name}', 'a URDF is a tree')
        above[joint.child] = joint
    for option, asked in (('--base', base), ('--tip', tip)):
        if asked is not None and asked not in links:
            raise BadInput(path, option, f'{shown(asked)} is not a link',
                           suggestion(asked, sorted(links)))
    if tip is None:
        ends = sorted(links - {joint.parent for joint in joints})
        if len(ends) != 1:
            raise BadInput(path, '', f'has {len(ends)} ends', 'name the last link of the chain: '
                           f'--tip, one of {", ".join(ends[:20])}')
        tip = ends[0]
    chain, at = list[Joint](), str(tip)
    while at != base and at in above and len(chain) <= len(joints):
        chain.append(above[at])
        at = above[at].parent
    if base is not None and at != base or len(chain) > len(joints):
        raise BadInput(path, '--base', f'{shown(base)} does not carry {tip}',
                       'the chain goes from the base out to the tip')
    return chain[::-1]


def _model(robot: Any, path: Path, moving: list[str]) -> Any:
    """Return the chain as pinocchio has it: all that does not move in it is put together."""
    try:
        import pinocchio
    except ImportError:
        raise BadInput('', '', 'pinocchio is not installed, which reads URDF',
                       "pip install pin (or ROS's package ros-jazzy-pinocchio)") from None
    try:
        whole = pinocchio.buildModelFromXML(ElementTree.tostring(robot, encoding='unicode'))
        held = [index for index, name in enumerate(whole.names) if index and name not in moving]
        model = pinocchio.buildReducedModel(whole, held, pinocchio.neutral(whole))
    except (ValueError, RuntimeError, IndexError) as error:
        raise BadInput(path, '', f'is not read by pinocchio ({error})',
                       'check it with check_urdf') from None
    if list(model.names)[1:] != moving:
        raise BadInput(path, '', 'pinocchio knows other joints: ' + ', '.join(
            list(model.names)[1:]), 'give each joint a name of its own')
    return model


def _bodies(model: Any, moving: list[Joint], path: Path) -> list[Body]:
    names = _names(moving)
    turned = [_to_axis(joint.axis) for joint in moving]
    found = []
    for i, (joint, name) in enumerate(zip(moving, names), 1):
        placed, inertia = model.jointPlacements[i], model.inertias[i]
        mass = float(inertia.mass)
        if mass < 0.0:
            raise BadInput(path, joint.child, f'has the mass {mass:g}', 'correct it')
        least, *_, most = np.linalg.eigvalsh(np.array(inertia.inertia)).tolist()
        if least < -1e-9 * abs(most):
            raise BadInput(path, joint.child, f'has the principal inertia {least:g} kg m^2',
                           'correct it')
        if not mass and most > 0.0:
            raise BadInput(path, joint.child, 'has an inertia, but no mass', 'give it a small one')
        Q, before = turned[i - 1], turned[i - 2] if i > 1 else np.eye(3)
        centre = Q.T @ np.array(inertia.lever)
        about = Q.T @ np.array(inertia.inertia) @ Q / mass if mass else np.zeros((3, 3))
        found.append(Body(
            name, joint.kind == 'prismatic', _clean(before.T @ np.array(placed.rotation) @ Q),
            _clean(before.T @ np.array(placed.translation)), _clean(centre),
            _clean(about + centre @ centre * np.eye(3) - np.outer(centre, centre))))
    import pinocchio
    data = model.createData()
    for _ in range(5):
        M = pinocchio.crba(model, data, pinocchio.randomConfiguration(model))
        M = np.triu(M) + np.triu(M, 1).T
        if not np.linalg.eigvalsh(M).min() > 1e-9 * np.abs(M).max():
            weak = moving[int(np.argmin(np.diag(M)))]
            raise BadInput(path, weak.child, 'and what it carries have no inertia about '
                           f'{weak.name}', 'give the links their masses and inertias')
    return found


def _names(moving: list[Joint]) -> list[str]:
    """Return names of the expression language that are like those of the joints."""
    found: list[str] = []
    for i, joint in enumerate(moving, 1):
        name = re.sub(r'\W', '_', joint.name, flags=re.ASCII).strip('_')
        name = name if name[:1].isalpha() and len(name) > 1 else f'joint_{name or i}'
        found.append(name if name not in found else f'{name}_{i}')
    return found


def _to_axis(axis: tuple[float, float, float]) -> np.ndarray:
    """Return a rotation (3, 3) that takes z to an axis."""
    z = np.array(axis)
    side = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = np.cross(side, z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def _clean(values: np.ndarray) -> np.ndarray:
    nearest = np.rint(values)
    return np.where(np.abs(values - nearest) < CLEAN, nearest, values) + 0.0


def _written(name: str, bodies: list[Body], moving: list[Joint], model: Any, path: Path) -> str:
    efforts = _efforts(model, moving)
    speeds = [f'{body.joint}_speed' for body in bodies]
    drives: list[Node] = []
    for body, speed in zip(bodies, speeds):
        slow = Apply('tanh', (Apply('/', (Name(speed), Name('creep'))),))
        friction = add(times(Name(f'{body.joint}_viscous'), Name(speed)),
                       times(Name(f'{body.joint}_coulomb'), slow))
        drives.append(add(Name(f'{body.joint}_{_drive(body)}'), minus(friction)))
    direction = np.array(model.gravity.linear) / np.linalg.norm(model.gravity.linear)
    gravity = [times(Name('gravity'), part) for part in vector(_clean(direction))]
    definitions, found = accelerations(bodies, gravity, drives)
    lines = [f"""\
# Made of {path.name}: the chain {", ".join(joint.name for joint in moving)}.
# Masses, centres and inertias are those of the file, put together where nothing moves between.
name: {name}
description: Chain of {len(bodies)} joint{'s' * (len(bodies) > 1)} made of a URDF.
time: continuous
parameters:
  gravity: {{value: 9.81, unit: m/s^2}}
  # speed at which Coulomb friction is about full. Below it friction is a guess
  creep: {{value: 0.1}}
  # mass: of what moves with the joint up to the next one. viscous: torque or force a unit of
  # speed; coulomb: what is left at creeping speed. Most URDFs have guesses, or none: drive each
  # joint at several constant speeds, up and down, and draw its torque over speed.
  # fit: what a recording can tell; spread: how far off it may be, one standard deviation"""]
    for i, (body, joint, effort) in enumerate(zip(bodies, moving, efforts), 1):
        mass = float(model.inertias[i].mass)
        fit = f', fit: [{mass / 2:.4g}, {mass * 2:.4g}]' if mass else ''
        fit += f', spread: {0.03 * mass:.4g}' if mass and len(bodies) <= FEW else ''
        lines.append(f'  {body.joint}_mass: {{value: {mass!r}, unit: kg{fit}}}')
        for what, value, of in (('viscous', joint.damping, effort / _speed(joint)),
                                ('coulomb', joint.friction, effort)):
            lines.append(f'  {body.joint}_{what}: {{value: {value!r}, fit: [0.0, '
                         f'{max(10 * value, 0.2 * of):.4g}], spread: '
                         f'{value / 5 if value else 0.01 * of:.4g}}}')
    lines.append('states:')
    for body, joint in zip(bodies, moving):
        low, high = joint.limit.get('lower', 0.0), joint.limit.get('upper', 0.0)
        if not low < high or joint.kind == 'continuous':
            low, high = (-1.0, 1.0) if body.slides else (-3.2, 3.2)
        lines.append(f'  {body.joint}: {{unit: {_unit(body)}, process_noise: 1.0e-5, '
                     f'range: [{low!r}, {high!r}], initial: {_between(low, high)!r}}}')
    for body, joint, speed in zip(bodies, moving, speeds):
        most = _speed(joint)
        lines.append(f'  {speed}: {{unit: {_unit(body)}/s, process_noise: {0.01 * most:.4g}, '
                     f'range: [{-most!r}, {most!r}]}}')
    lines.append('inputs:')
    lines += [f'  {body.joint}_{_drive(body)}: {{unit: {"N" if body.slides else "N m"}, '
              f'range: [{-effort!r}, {effort!r}], process_noise: {0.001 * effort:.4g}}}'
              for body, effort in zip(bodies, efforts)]
    lines.append('definitions:      # Newton and Euler out and back, then the mass matrix')
    lines += [f'  {key}: {text}' for key, text in definitions.items()]
    lines.append('dynamics:')
    lines += [f'  {body.joint}: {speed}' for body, speed in zip(bodies, speeds)]
    lines += [f'  {speed}: {rate}' for speed, rate in zip(speeds, found)]
    lines.append('sensors:')
    lines.append('  # noise: standard deviation of a single reading at rest: a guess')
    lines += [f'  {body.joint}_encoder: {{measures: {body.joint}, unit: {_unit(body)}, noise: '
              '2.0e-4, tolerance: 0.05}' for body in bodies]
    lines += [f'  {body.joint}_tacho: {{measures: {speed}, unit: {_unit(body)}/s, noise: '
              '0.02, tolerance: 0.2}' for body, speed in zip(bodies, speeds)]
    return '\n'.join(lines) + '\n'


def _efforts(model: Any, moving: list[Joint]) -> list[float]:
    """Return the largest torques and forces; where the file has no limit, twice what holds it."""
    import pinocchio
    data = model.createData()
    held = np.max([np.abs(pinocchio.computeGeneralizedGravity(
        model, data, pinocchio.randomConfiguration(model))) for _ in range(50)], axis=0)
    return [joint.limit.get('effort') or float(f'{max(2.0 * most, 1.0):.3g}')
            for joint, most in zip(moving, held)]


def _speed(joint: Joint) -> float:
    return joint.limit.get('velocity') or _DEFAULT_SPEED


def _between(low: float, high: float) -> float:
    return 0.0 if low <= 0.0 <= high else (low + high) / 2


def _unit(body: Body) -> str:
    return 'm' if body.slides else 'rad'


def _drive(body: Body) -> str:
    return 'force' if body.slides else 'torque'
