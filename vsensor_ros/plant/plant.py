"""What is known of a plant: matrices, nonlinear terms, names and units."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
import hashlib
import re
from typing import Any

import numpy as np

from vsensor_ros.bad_input import BadInput, check_text, shown
from vsensor_ros.functions.curve import Curve
from vsensor_ros.functions.equations import Equations
from vsensor_ros.functions.expression import Apply, fold, Node, parse, substitute
from vsensor_ros.functions.nonlinearity import evaluate, NonlinearTerm
from vsensor_ros.plant.checked import (
    as_list,
    check_distinct,
    checked_columns,
    checked_curves,
    checked_delays,
    checked_direct,
    checked_equations,
    checked_marks,
    checked_matrix,
    checked_names,
    checked_noise,
    checked_ranges,
    checked_rates,
    checked_sample_time,
    checked_spreads,
    checked_terms,
    checked_tolerances,
    checked_turns,
    checked_vector,
    suggestion,
)
from vsensor_ros.plant.plain_name import affine_node
from vsensor_ros.plant.unknown_inputs import UnknownInputs

_ARGUMENT = re.compile(r'w[0-9]+')


@dataclass(frozen=True, eq=False)
class Plant:
    """
    d x = A x + B u + sum_i P[:, i] psi_i(G_i x, u) + D rho,  y = C x + Cu u + Cd rho.

    d is the derivative, or the shift by `sample_time` seconds when that is not None; rho is
    unknown. n states, m inputs, l sensors, d disturbances, q nonlinear terms; the entries
    of every array are in the units of its names. Source: the method, section 1.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    sensors: tuple[str, ...]
    disturbances: tuple[str, ...]
    A: np.ndarray                       # (n, n)
    B: np.ndarray                       # (n, m)
    C: np.ndarray                       # (l, n)
    D: np.ndarray                       # (n, d)
    P: np.ndarray                       # (n, q)
    G: tuple[np.ndarray, ...]           # q arrays (r_i, n)
    terms: tuple[NonlinearTerm, ...]    # q
    sample_time: float | None           # s
    units: dict[str, str]               # of every name; '' when unknown
    initial: np.ndarray                 # (n,), the initial guess
    noise: np.ndarray                   # (l,), standard deviations, NaN where unknown
    parameters: dict[str, float]
    operating_point: np.ndarray         # (n,), where the formal addends were taken
    operating_input: np.ndarray         # (m,), with it
    Cu: np.ndarray                      # (l, m), what the sensors read directly of the inputs
    Cd: np.ndarray                      # (l, d), and of the unknown inputs
    # (n,), intensity of white noise that drives each state, NaN where unknown: [unit of the
    # state per sqrt(s)], discrete: [unit of the state per step]
    process_noise: np.ndarray
    ranges: np.ndarray                  # (n, 2), where the states live; -inf, inf where unknown
    input_range: np.ndarray             # (m, 2), where the inputs live, as ranges
    disturbance_range: np.ndarray       # (d, 2), and the unknown inputs
    slow: np.ndarray                    # (n,) bool: offsets, which only drift
    tolerances: dict[str, float]        # by sensor: how far off an estimate of it may be
    wrap: np.ndarray                    # (l,), what a turn is in each reading, NaN: it wraps not
    curves: dict[str, Curve]            # by sensor that shows an offset, or a curve, of its y
    input_delay: np.ndarray             # (m,) s, u acts so much later than it is given
    sensor_delay: np.ndarray            # (l,) s, what is stamped t tells of t less this
    sensor_rate: np.ndarray             # (l,) Hz, of readings, NaN where unknown
    # intensity of white noise as process_noise, NaN where unknown:
    input_noise: np.ndarray             # (m,), by which what acts is off the inputs
    disturbance_noise: np.ndarray       # (d,), that the unknown inputs are
    spreads: dict[str, float]           # by parameter not known exactly: its standard deviation
    # n right-hand sides over states, inputs, disturbances and parameters; () where not known
    equations: tuple[str, ...]
    remarks: tuple[str, ...]            # what is to be told of how the file was read
    # makes it anew, of parameters that are so many times as large; None: not known how
    remake: Callable[[Mapping[str, float]], Plant] | None = None
    # names and texts that equations use, of which a later one may use earlier ones; () where
    # equations are written out
    definitions: tuple[tuple[str, str], ...] = ()
    # unknown inputs that stand for rates of states whose equations are too large to be terms
    unwritten: tuple[str, ...] = ()
    # of what the columns of D and Cd are made where that is nonlinear; None: of `disturbances`
    unknown: UnknownInputs | None = None

    @classmethod
    def from_matrices(cls, A: Any, B: Any, C: Any, *fourth: Any, D: Any = None,
                      sample_time: float | None = None, P: Any = None, G: Any = None,
                      nonlinearities: Sequence[str | NonlinearTerm] | None = None,
                      states: Sequence[str] | None = None, inputs: Sequence[str] | None = None,
                      sensors: Sequence[str] | None = None,
                      disturbances: Sequence[str] | None = None,
                      units: Mapping[str, str] | None = None, initial: Any = None,
                      noise: Any = None, parameters: Mapping[str, float] | None = None,
                      operating_point: Any = None, operating_input: Any = None,
                      Cu: Any = None, Cd: Any = None, process_noise: Any = None,
                      ranges: Any = None, input_range: Any = None,
                      disturbance_range: Any = None, slow: Sequence[str] = (),
                      tolerances: Mapping[str, float] | None = None, wrap: Any = None,
                      curves: Mapping[str, Curve] | None = None, input_delay: Any = None,
                      sensor_delay: Any = None, sensor_rate: Any = None,
                      input_noise: Any = None, disturbance_noise: Any = None,
                      spreads: Mapping[str, float] | None = None,
                      equations: Sequence[str] = (),
                      definitions: Sequence[tuple[str, str]] = (),
                      unwritten: Sequence[str] = (),
                      remarks: Sequence[str] = (),
                      remake: Callable[[Mapping[str, float]], Plant] | None = None,
                      unknown: UnknownInputs | None = None, name: str = 'plant',
                      where: object = 'Plant.from_matrices') -> Plant:
        """
        Make a plant of arrays; all after C by keyword.

        A (n, n), B (n, m) or None, C (l, n), D (n, d) or None: unknown inputs; one column
        of B, D, P and one row of C may be given flat. P (n, q), G: q arrays (r_i, n) or
        rows (n,), nonlinearities: q texts over w1..wr (w = G_i x) and the inputs' names, or
        terms. Names default to x1.., u1.., y1.., rho1..; a sensor may be called as a state.
        A is taken as it stands: no formal addend is moved into it. Cu (l, m), Cd (l, d): zero
        when None; flat for one sensor or one column. process_noise (n,), NaN where unknown;
        ranges (n, 2), low < high, -inf and inf where unknown; input_range (m, 2) and
        disturbance_range (d, 2) likewise. slow: names of states that only drift; tolerances: how
        far off an estimate may be, by sensor. wrap (l,): of a heading that jumps at +-pi 2 pi,
        NaN where nothing wraps. curves: by sensor what it shows of its row of C, Cu and Cd.
        input_delay (m,): dead times [s], whole samples when discrete; sensor_delay (l,): with
        how late their stamps are; sensor_rate (l,): readings a second, NaN where unknown.
        input_noise (m,), disturbance_noise (d,): as process_noise. spreads: standard deviations
        of parameters that are not known exactly; equations: the same as the arrays in n texts over
        states, inputs, disturbances, parameters and definitions, which are names and texts in
        order; unwritten: names of unknown inputs that are what these say. remake: makes the plant
        anew from factors of its parameters, by name. unknown: what the columns of D and Cd are
        made of, where that is nonlinear. where: what error lines call the source. Raises BadInput.
        """
        if fourth:  # D is the feedthrough to all who come from control packages
            raise BadInput(where, 'D', 'a fourth argument without a name could mean either',
                           'feedthrough is Cu=, unknown inputs are D=')
        if not check_text(name, where, 'name'):
            raise BadInput(where, 'name', 'is empty', 'give the plant a name')
        for key, mapping in (('units', units), ('parameters', parameters),
                             ('tolerances', tolerances), ('curves', curves)):
            if not isinstance(mapping, Mapping | None):
                raise BadInput(where, key, f'{shown(mapping)} is not a mapping',
                               'give {name: value, ...}')
        parameters = parameters or {}
        a = checked_matrix(A, where, 'A')
        n = len(a)
        if n == 0 or a.shape != (n, n):
            raise BadInput(where, 'A', f'has shape {a.shape}', 'give n rows of n numbers')
        b = checked_columns(B, n, where, 'B')
        c = checked_matrix(C, where, 'C', row=True)
        if len(c) == 0 or c.shape[1] != n:
            raise BadInput(where, 'C', f'has shape {c.shape}',
                           f'give one row of {n} numbers a sensor')
        d = checked_columns(D, n, where, 'D')
        p = checked_columns(P, n, where, 'P')
        state_names = checked_names(states, 'x', n, where, 'states')
        input_names = checked_names(inputs, 'u', b.shape[1], where, 'inputs')
        sensor_names = checked_names(sensors, 'y', len(c), where, 'sensors')
        disturbance_names = checked_names(disturbances, 'rho', d.shape[1], where, 'disturbances')
        given = disturbance_names if unknown is None else unknown.names
        check_distinct(where, {'states': state_names, 'inputs': input_names,
                               'disturbances': disturbance_names,
                               'parameters': tuple(parameters)})
        check_distinct(where, {'inputs': input_names, 'disturbances': disturbance_names,
                               'sensors': sensor_names})
        for text in input_names:
            if _ARGUMENT.fullmatch(text):
                raise BadInput(where, 'inputs', f'{text} is the name of an argument of the '
                               'nonlinearities (w = G x)', 'choose another name')
        rows, terms = checked_terms(G, nonlinearities, p, state_names, input_names, where)
        everything = (*state_names, *input_names, *sensor_names, *disturbance_names)
        units = {**dict.fromkeys(everything, ''), **(units or {})}
        for known, unit in units.items():
            if known not in everything:
                raise BadInput(where, 'units', f'unknown name {shown(known)}',
                               suggestion(known, everything))
            check_text(unit, where, f'units.{known}')
        start = checked_vector(initial, np.zeros(n), where, 'initial')
        return cls(
            name=name, states=state_names, inputs=input_names, sensors=sensor_names,
            disturbances=disturbance_names, A=a, B=b, C=c, D=d, P=p, G=rows, terms=terms,
            sample_time=checked_sample_time(sample_time, where),
            units=units, initial=start, noise=checked_noise(noise, len(c), where),
            parameters=dict(zip(parameters, checked_vector(
                list(parameters.values()), np.zeros(len(parameters)), where,
                'parameters').tolist())),
            operating_point=checked_vector(operating_point, start, where, 'operating_point'),
            operating_input=checked_vector(operating_input, np.zeros(len(input_names)), where,
                                           'operating_input'),
            Cu=checked_direct(Cu, len(c), b.shape[1], where, 'Cu'),
            Cd=checked_direct(Cd, len(c), d.shape[1], where, 'Cd'),
            process_noise=checked_noise(process_noise, n, where, 'process_noise'),
            ranges=checked_ranges(ranges, n, where, 'ranges', 'a state'),
            input_range=checked_ranges(input_range, b.shape[1], where, 'input_range', 'an input'),
            disturbance_range=checked_ranges(disturbance_range, d.shape[1], where,
                                             'disturbance_range', 'an unknown input'),
            slow=checked_marks(slow, state_names, where),
            tolerances=checked_tolerances(tolerances or {}, sensor_names, where),
            wrap=checked_turns(wrap, len(c), where),
            curves=checked_curves(curves or {}, sensor_names, where),
            input_delay=checked_delays(input_delay, b.shape[1], sample_time, where, 'input_delay'),
            sensor_delay=checked_delays(sensor_delay, len(c), None, where, 'sensor_delay'),
            sensor_rate=checked_rates(sensor_rate, len(c), where),
            input_noise=checked_noise(input_noise, b.shape[1], where, 'input_noise'),
            disturbance_noise=checked_noise(disturbance_noise, d.shape[1], where,
                                            'disturbance_noise'),
            spreads=checked_spreads(spreads or {}, parameters, where),
            equations=checked_equations(equations, (*state_names, *input_names, *given,
                                                    *parameters), definitions, n, where),
            definitions=tuple(definitions), unwritten=tuple(unwritten),
            remarks=tuple(check_text(text, where, 'remarks')
                          for text in as_list(remarks, where, 'remarks')),
            remake=remake, unknown=unknown)

    @property
    def unknown_inputs(self) -> tuple[str, ...]:
        """Names of the unknown inputs as they were given; what each comes to: `acting`."""
        return self.disturbances if self.unknown is None else self.unknown.names

    @property
    def unknown_noise(self) -> np.ndarray:
        """Intensity of the white noise that `unknown_inputs` are, NaN where unknown."""
        return self.disturbance_noise if self.unknown is None else np.array(self.unknown.noise)

    def acting(self, x: np.ndarray, u: np.ndarray, rho: np.ndarray) -> np.ndarray:
        """Return what the columns of D and Cd are multiplied by, of rho as they were given."""
        if self.unknown is None:
            return rho
        at = [np.broadcast_to(_beside(v, x), (len(v), *np.shape(x)[1:])) for v in (x, u, rho)]
        return self.unknown.acting(np.concatenate(at), (*self.states, *self.inputs))

    def rate_of_change(self, x: Any, u: Any, rho: Any = None) -> np.ndarray:
        """
        Return the right-hand side (n,): the derivative, or the next state when discrete.

        x (n,), u (m,), rho (d,) of `unknown_inputs`, zero when None; for N points at once
        x (n, N), and u and rho for all of them or (m, N), (d, N).
        """
        x = np.asarray(x, dtype=float)
        u = _beside(np.zeros(0) if u is None else u, x)
        if self.unwritten:
            return self._by_equations(x, u, np.zeros(len(self.unknown_inputs)) if rho is None
                                      else rho)
        total = self.A @ x + self.B @ u
        for term, g, column in zip(self.terms, self.G, self.P.T):
            psi = np.broadcast_to(evaluate(term, g @ x, self.inputs, u), x.shape[1:])
            total = total + np.multiply.outer(column, psi)
        if rho is None:
            if self.unknown is None:
                return total
            rho = np.zeros(len(self.unknown.names))
        return total + self.D @ self.acting(x, u, _beside(rho, x))

    def _by_equations(self, x: np.ndarray, u: np.ndarray, rho: Any) -> np.ndarray:
        """Return the right-hand side, of which not all is known as terms."""
        given = (*self.states, *self.inputs, *self.unknown_inputs, *self.parameters)
        values = np.concatenate([values.reshape(len(values), -1) + np.zeros(
            (1, x[0].size)) for values in (x, u, _beside(rho, x), _beside(list(
                self.parameters.values()), x))])
        return _equations(self.equations, self.definitions, given).values(values).reshape(x.shape)

    def part(self, states: Sequence[int], sensors: Sequence[int], disturbances: Sequence[int],
             terms: Sequence[int]) -> Plant:
        """
        Return a part of the plant with all its inputs, by the indices of what belongs to it.

        Nothing else may act on these states, nor on what these sensors read.
        """
        x, y, rho, q = (list(chosen) for chosen in (states, sensors, disturbances, terms))
        names = tuple(self.sensors[i] for i in y)
        return replace(
            self, states=tuple(self.states[i] for i in x), sensors=names,
            disturbances=tuple(self.disturbances[i] for i in rho),
            A=self.A[np.ix_(x, x)], B=self.B[x], C=self.C[np.ix_(y, x)], D=self.D[np.ix_(x, rho)],
            P=self.P[np.ix_(x, q)], G=tuple(self.G[i][:, x] for i in q),
            terms=tuple(self.terms[i] for i in q), initial=self.initial[x], noise=self.noise[y],
            operating_point=self.operating_point[x], Cu=self.Cu[y], Cd=self.Cd[np.ix_(y, rho)],
            process_noise=self.process_noise[x], ranges=self.ranges[x], slow=self.slow[x],
            tolerances={name: size for name, size in self.tolerances.items() if name in names},
            wrap=self.wrap[y], disturbance_range=self.disturbance_range[rho],
            curves={name: curve for name, curve in self.curves.items() if name in names},
            sensor_delay=self.sensor_delay[y], sensor_rate=self.sensor_rate[y],
            disturbance_noise=self.disturbance_noise[rho], equations=(), definitions=(),
            unwritten=(), remake=None, unknown=None)

    def angles(self) -> tuple[dict[str, float], ...]:
        """
        Return of each angle that sensors wrap who reads it: by name, what a turn is there.

        Sensors of the same functional read the same angle, whatever their units. A turn is
        negative where the reading runs the other way than that of the first.
        """
        found: list[tuple[np.ndarray, dict[str, float]]] = []
        for i in np.flatnonzero(~np.isnan(self.wrap)):
            name, turn = self.sensors[i], float(self.wrap[i])
            row = np.concatenate([self.C[i], self.Cu[i], self.Cd[i]]) / turn
            for first, turns in found:
                sign = np.sign(row @ first)
                if np.allclose(sign * row, first, 1e-9, 0.0):
                    turns[name] = float(sign) * turn
                    break
            else:
                found.append((row, {name: turn}))
        return tuple(turns for _, turns in found)

    def reading_ranges(self) -> dict[str, tuple[float, float]]:
        """Return between what readings lie by the ranges, of sensors that these tell."""
        ranges = {}
        rows = np.hstack([self.C, self.Cu, self.Cd])
        known = np.vstack([self.ranges, self.input_range, self.disturbance_range])
        for name, row in zip(self.sensors, rows):
            of = np.flatnonzero(row)
            ends = np.sort(row[of, None] * known[of], axis=1).sum(axis=0)
            if len(of) and np.isfinite(ends).all():
                low, high = float(ends[0]), float(ends[1])
                curve = self.curves.get(name)
                if curve is not None and not curve.beside:
                    low, high = sorted((curve.shown(low), curve.shown(high)))
                ranges[name] = low, high
        return ranges

    def delays(self) -> dict[str, float]:
        """Return the dead times [s] of inputs and sensors, by name, of those that have one."""
        every = zip((*self.inputs, *self.sensors), (*self.input_delay, *self.sensor_delay))
        return {name: float(delay) for name, delay in every if delay}

    def noises(self) -> dict[str, float]:
        """Return the standard deviation of one reading, by name, of sensors where it is known."""
        return {name: float(noise) for name, noise in zip(self.sensors, self.noise) if noise > 0.0}

    def hash(self) -> str:
        """Return the SHA-256 of what a design depends on: names, arrays, terms, noise, start."""
        digest = hashlib.sha256()

        def add(*parts: object) -> None:
            for part in parts:
                if isinstance(part, np.ndarray):
                    hexed = ' '.join(float(v + 0.0).hex() for v in part.ravel())
                    part = f'{part.shape} {hexed}'
                digest.update(f'{len(str(part))}:{part};'.encode())

        add(self.name, self.states, self.inputs, self.sensors, self.disturbances,
            self.A, self.B, self.C, self.D, self.P, self.Cu, self.Cd, self.initial,
            self.noise, self.process_noise, self.ranges,
            'continuous' if self.sample_time is None else float(self.sample_time).hex())
        if not np.isnan(self.wrap).all():
            add('wrap', self.wrap)
        if np.isfinite(self.input_range).any() or np.isfinite(self.disturbance_range).any():
            add('ranges', self.input_range, self.disturbance_range)
        for name, curve in sorted(self.curves.items()):
            add('curve', name, curve.offset, curve.text, curve.low, curve.high,
                sorted(curve.beside.items()))
        if self.delays() or not np.isnan(self.sensor_rate).all():
            add('delays', sorted(self.delays().items()), self.sensor_rate)
        if self.spreads:
            add('spreads', sorted(self.spreads.items()), self.equations, self.input_noise,
                self.disturbance_noise)
        if self.definitions:
            add('definitions', self.definitions, self.equations)
        if self.unknown is not None:
            add('unknown', self.unknown)
        for term, g in zip(self.terms, self.G):
            add(term.text, term.slope, g)
        if self.slow.any() or self.tolerances:  # what has neither keeps its hash
            add(self.slow, sorted(self.tolerances.items()))
        return digest.hexdigest()


@lru_cache(maxsize=4)
def _equations(texts: tuple[str, ...], definitions: tuple[tuple[str, str], ...],
               names: tuple[str, ...]) -> Equations:
    return Equations([parse(text) for text in texts], names,
                     [(name, parse(text)) for name, text in definitions])


def reading_node(plant: Plant, i: int) -> Node:
    """Return the linear reading of the i-th sensor, or what it shows if it is no curve of one."""
    names = (*plant.states, *plant.inputs, *plant.disturbances)
    node = affine_node(np.concatenate([plant.C[i], plant.Cu[i], plant.Cd[i]]), names)
    if plant.unknown is None or not plant.Cd[i].any():
        return node
    return fold(substitute(node, {name: parse(text) for name, text in zip(
        plant.disturbances, plant.unknown.texts)}))


def measures_node(plant: Plant, i: int) -> Node:
    """Return what the i-th sensor shows, in the plant's names."""
    names = (*plant.states, *plant.inputs, *plant.disturbances)
    row = np.concatenate([plant.C[i], plant.Cu[i], plant.Cd[i]])
    curve = plant.curves.get(plant.sensors[i], Curve())
    if plant.unknown is not None and plant.Cd[i].any():
        return reading_node(plant, i)
    if not curve.text:
        return affine_node(row, names, curve.offset)
    beside = np.array([curve.beside.get(name, 0.0) for name in names])
    bent = substitute(parse(curve.text), {'w1': affine_node(row - beside, names)})
    return Apply('+', (bent, affine_node(beside, names))) if beside.any() else bent


def _beside(values: Any, x: np.ndarray) -> np.ndarray:
    # one vector for all columns of x, or a column each
    values = np.asarray(values, dtype=float)
    return values[:, np.newaxis] if values.ndim < x.ndim else values
