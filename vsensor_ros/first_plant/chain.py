"""
A chain of rigid bodies: its equations of motion as definitions.

Each frame is turned so that z is its joint's axis. The right-hand side is the recursion of Newton
and Euler, from the base out and back; the mass matrix is made of bodies put together from the tip
in (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapters 5 and 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vsensor_ros.first_plant.elimination import solved
from vsensor_ros.first_plant.sheet import (
    add,
    cross,
    minus,
    ONE,
    plus,
    product,
    scaled,
    Sheet,
    times,
    turned,
    Vector,
    vector,
    ZERO,
)
from vsensor_ros.functions.expression import Apply, Name, Node, Number, to_text

CLEAN = 1e-12  # entries of rotations below are rounding


@dataclass(frozen=True, eq=False)
class Body:
    """A body that moves with a joint, in the frame of the joint, of which z is the axis."""

    joint: str  # name of its angle or way; there are also <joint>_speed and <joint>_mass
    slides: bool  # along z, instead of turning about it
    rotation: np.ndarray  # (3, 3) from this frame to the one before, where the joint is at 0
    place: np.ndarray  # (3,) m, of this frame in the one before
    centre: np.ndarray  # (3,) m, of mass
    inertia: np.ndarray  # (3, 3) m^2, about the frame's origin, of each kg


def accelerations(bodies: Sequence[Body], gravity: Sequence[Node], drives: Sequence[Node],
                  ) -> tuple[dict[str, str], list[str]]:
    """
    Return definitions, and the names of the accelerations of the joints.

    gravity (3,): in the base's frame; drives: torques and forces on the joints, less friction.
    """
    sheet = Sheet()
    turns = [_turn(sheet, i, body) for i, body in enumerate(bodies, 1)]
    steady = _newton_euler(sheet, bodies, turns, gravity)
    right = [to_text(sheet.let(f'b{i}', add(drive, minus(bias))))
             for i, (drive, bias) in enumerate(zip(drives, steady), 1)]
    mass = {at: to_text(node) for at, node in _mass_matrix(sheet, bodies, turns).items()
            if node != ZERO}
    made, found = solved(mass, right, Sheet.END)
    return {**sheet.texts, **made}, found


@dataclass(frozen=True, eq=False)
class _Turn:
    """From the frame of a body to the one before, and back."""

    body: Body
    cos: Node
    sin: Node
    place: Vector

    def out(self, v: Vector) -> Vector:
        """Return a vector of the frame before in this frame."""
        x, y, z = turned(self.body.rotation.T, v)
        return [add(times(self.cos, x), times(self.sin, y)),
                add(times(self.cos, y), minus(times(self.sin, x))), z]

    def back(self, v: Vector) -> Vector:
        """Return a vector of this frame in the one before."""
        x, y, z = v
        return turned(self.body.rotation, [
            add(times(self.cos, x), minus(times(self.sin, y))),
            add(times(self.sin, x), times(self.cos, y)), z])


def _turn(sheet: Sheet, i: int, body: Body) -> _Turn:
    angle, place = Name(body.joint), vector(body.place)
    if body.slides:
        way = scaled(angle, vector(body.rotation[:, 2]))
        return _Turn(body, ONE, ZERO, sheet.let_vector(f'p{i}', plus(place, way)))
    return _Turn(body, sheet.let(f'c{i}', Apply('cos', (angle,))),
                 sheet.let(f's{i}', Apply('sin', (angle,))), place)


def _newton_euler(sheet: Sheet, bodies: Sequence[Body], turns: Sequence[_Turn],
                  gravity: Sequence[Node]) -> list[Node]:
    """Return what the joints must give without acceleration: for gravity, and for turning."""
    w, dw, a = vector([0.0] * 3), vector([0.0] * 3), [minus(g) for g in gravity]
    bends: list[list[Vector]] = []  # of each frame, what a point at r has more of a: bend r
    bend: list[Vector] = [vector([0.0] * 3)] * 3
    forces, moments = [], []
    for i, (body, turn) in enumerate(zip(bodies, turns), 1):
        speed = Name(f'{body.joint}_speed')
        a = turn.out(sheet.let_vector(f'o{i}', plus(a, product(bend, turn.place))))
        w, dw = (sheet.let_vector(f'{name}{i}', turn.out(v)) for name, v in (('e', w), ('g', dw)))
        if body.slides:
            a = plus(a, scaled(Number(2.0), cross(w, [ZERO, ZERO, speed])))
        else:
            dw = plus(dw, cross(w, [ZERO, ZERO, speed]))
            w = plus(w, [ZERO, ZERO, speed])
        w, dw, a = (sheet.let_vector(f'{name}{i}', v) for name, v in (
            ('w', w), ('z', dw), ('a', a)))
        bend = _bend(sheet, i, w, dw)
        bends.append(bend)
        mass = Name(f'{body.joint}_mass')
        centre, inertia = vector(body.centre), [vector(row) for row in body.inertia]
        force = scaled(mass, plus(a, product(bend, centre)))
        spin = sheet.let_vector(f'j{i}', product(inertia, w))
        moment = scaled(mass, plus(cross(centre, a), product(inertia, dw), cross(w, spin)))
        forces.append(sheet.let_vector(f'f{i}', force))
        moments.append(sheet.let_vector(f'n{i}', moment))
    found: list[Node] = []
    force, moment = vector([0.0] * 3), vector([0.0] * 3)
    for i, (body, turn) in reversed([*enumerate(zip(bodies, turns), 1)]):
        force = sheet.let_vector(f'r{i}', plus(forces[i - 1], force))
        moment = sheet.let_vector(f't{i}', plus(moments[i - 1], moment))
        found.insert(0, force[2] if body.slides else moment[2])
        force = sheet.let_vector(f'q{i}', turn.back(force))
        moment = plus(turn.back(moment), cross(turn.place, force))
    return found


def _bend(sheet: Sheet, i: int, w: Vector, dw: Vector) -> list[Vector]:
    """Return the matrix that gives dw x r + w x (w x r) of r."""
    xx, yy, zz = (sheet.let(f'w{i}{axis * 2}', times(v, v)) for axis, v in zip('xyz', w))
    xy, yz, zx = (sheet.let(f'w{i}{a}{b}', times(w['xyz'.index(a)], w['xyz'.index(b)]))
                  for a, b in ('xy', 'yz', 'zx'))
    x, y, z = dw
    rows = [[minus(add(yy, zz)), add(xy, minus(z)), add(zx, y)],
            [add(xy, z), minus(add(zz, xx)), add(yz, minus(x))],
            [add(zx, minus(y)), add(yz, x), minus(add(xx, yy))]]
    return [sheet.let_vector(f'v{i}{axis}', row) for axis, row in zip('xyz', rows)]


def _mass_matrix(sheet: Sheet, bodies: Sequence[Body],
                 turns: Sequence[_Turn]) -> dict[tuple[int, int], Node]:
    """Return what stands at (i, j), j <= i, counted from 0."""
    found: dict[tuple[int, int], Node] = {}
    m: Node = ZERO
    first, second = vector([0.0] * 3), [vector([0.0] * 3)] * 3  # moments of mass of what is beyond
    for i in reversed(range(len(bodies))):
        body, at = bodies[i], i + 1
        own = Name(f'{body.joint}_mass')
        m = sheet.let(f'm{at}', add(own, m))
        first = sheet.let_vector(f'h{at}', plus(scaled(own, vector(body.centre)), first))
        rows = [plus(scaled(own, vector(row)), beyond) for row, beyond in zip(
            body.inertia, second)]
        second = _symmetric(sheet, f'i{at}', rows)
        if body.slides:
            force, moment = [ZERO, ZERO, m], [first[1], minus(first[0]), ZERO]
            found[i, i] = m
        else:
            force, moment = [minus(first[1]), first[0], ZERO], [row[2] for row in second]
            found[i, i] = second[2][2]
        for j in reversed(range(i)):
            turn = turns[j + 1]
            force = sheet.let_vector(f'x{at}{j + 1}', turn.back(force))
            moment = sheet.let_vector(f'k{at}{j + 1}', plus(turn.back(moment),
                                                            cross(turn.place, force)))
            found[i, j] = force[2] if bodies[j].slides else moment[2]
        if i:
            second, first = _before(sheet, at, turns[i], m, first, second)
    return found


def _before(sheet: Sheet, at: int, turn: _Turn, m: Node, first: Vector,
            second: list[Vector]) -> tuple[list[Vector], Vector]:
    """Return moments of mass in the frame before, about its origin."""
    half = [turn.back(row) for row in second]  # J R'
    half = [sheet.let_vector(f'y{at}{axis}', row) for axis, row in zip('xyz', half)]
    both = list(zip(*[turn.back([half[k][column] for k in range(3)]) for column in range(3)]))
    first = sheet.let_vector(f'u{at}', turn.back(first))
    p = turn.place
    # of each mass at p + r: (p + r)^2 1 - (p + r) (p + r)', where r^2 1 - r r' is in `both`
    mixed = [[add(times(p[i], first[j]), times(first[i], p[j])) for j in range(3)]
             for i in range(3)]
    square = [[times(m, times(p[i], p[j])) for j in range(3)] for i in range(3)]
    one = add(add(add(mixed[0][0], mixed[1][1]), mixed[2][2]),
              add(add(square[0][0], square[1][1]), square[2][2]))
    one = sheet.let(f'l{at}', one)
    rows = [[add(both[i][j], add(one if i == j else ZERO,
                                 minus(add(mixed[i][j], square[i][j]))))
             for j in range(3)] for i in range(3)]
    return _symmetric(sheet, f'g{at}', rows), plus(first, scaled(m, p))


def _symmetric(sheet: Sheet, name: str, rows: Sequence[Sequence[Node]]) -> list[Vector]:
    """Write down a symmetric matrix, each entry once."""
    made: dict[tuple[int, int], Node] = {}
    for i in range(3):
        for j in range(i + 1):
            made[i, j] = made[j, i] = sheet.let(f'{name}{"xyz"[i]}{"xyz"[j]}', rows[i][j])
    return [[made[i, j] for j in range(3)] for i in range(3)]
