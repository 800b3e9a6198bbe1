"""
Close plant, controller and virtual sensors, and look whether that holds.

The eigenvalues of N are those of an observer's error. Those of the loop are theirs and those with
healthy sensors only where the virtual sensor hears the command that the plant gets, and the model
is right. So the loop is closed as it is, and with the plant's parameters off.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.control.controller import Controller
from vsensor_ros.control.loop import close, IllPosed, Law, limit, rates
from vsensor_ros.control.machine import linear_sensor, Machine, machine, separate
from vsensor_ros.control.sampling import as_it_is, Errors, Late, sampled, Steps
from vsensor_ros.control.uncertainty import chosen, corners, varied
from vsensor_ros.designer.noise import noise_model
from vsensor_ros.designer.problem import pose
from vsensor_ros.functions.expression import names, parse
from vsensor_ros.observers import Design, Refusal, VirtualSensor
from vsensor_ros.plant import Plant
from vsensor_ros.plant.checked import suggestion
from vsensor_ros.plant.linear import kinked

BISECTIONS = 12  # of the way to a corner


@dataclass(frozen=True)
class Corner:
    """The corner of the parameters at which the loop is worst."""

    factors: Mapping[str, float]  # by parameter
    growth: float  # 1/s, of what grows fastest


@dataclass(frozen=True, eq=False)
class Case:
    """
    The loop with some sensors lost, and virtual sensors in their place.

    verdict: 'stable'; 'stays' (a mode neither dies out nor grows); 'for a time' (so, or growing,
    and no reading holds it: the virtual sensor is temporary); 'unstable'; 'not replaced' and
    'not closed' (see reason). Poles are of s [1/s], or of z when the controller is sampled. Of a
    loop that is not stable noise and sensitivity are None.
    """

    lost: tuple[str, ...]
    verdict: str
    reason: str = ''
    unread: bool = False  # the controller reads nothing of what is lost
    growth: float = np.nan  # 1/s, of what grows fastest, or dies out last; without `unheld`
    poles: np.ndarray = field(default_factory=lambda: np.zeros(0))
    # those of the poles that no reading holds
    unheld: np.ndarray = field(default_factory=lambda: np.zeros(0))
    # the poles are those with healthy sensors and the eigenvalues of N
    separate: bool = True
    states: tuple[str, ...] = ()  # in which the mode that is not stable shows most
    sensitivity: Mapping[str, tuple[float, float]] | None = None  # by command: peak, at [rad/s]
    noise: Mapping[str, float] | None = None  # by command, standard deviation in its unit
    corner_poles: tuple[np.ndarray, ...] = ()  # at each corner
    unstable_corners: int = 0
    worst: Corner | None = None
    # the least part of the way to a corner at which it is unstable; None: nowhere
    unstable_from: float | None = None

    @property
    def holds(self) -> bool:
        """Whether it is stable, nominally and at all corners that were looked at."""
        return self.verdict == 'stable' and not self.unstable_corners

    @property
    def peak(self) -> float:
        """The largest sensitivity peak of its commands, NaN where it is not known."""
        return max((size for size, _ in (self.sensitivity or {}).values()), default=np.nan)


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """A controller with each set of virtual sensors in place; the healthy loop comes first."""

    controller: Controller
    cases: tuple[Case, ...]
    sample_time: float | None  # s, at which the loop is looked at; None: continuous
    shares: Mapping[str, float]  # by parameter, how far off it may be
    corners: int  # that were looked at
    all_corners: int  # that there are
    assumed: bool  # some of the noise
    left_out: tuple[str, ...]  # terms without a slope at the operating point
    linear: bool  # the plant has neither terms nor curves
    between: bool  # a continuous plant, and a controller of samples

    def __getitem__(self, lost: Iterable[str]) -> Case:
        """Look up the loop with these sensors lost; raise KeyError."""
        wanted = {lost} if isinstance(lost, str) else set(lost)
        for case in self.cases:
            if set(case.lost) == wanted:
                return case
        raise KeyError(f'{", ".join(sorted(map(str, wanted)))}: no such fault set')

    @property
    def healthy(self) -> Case:
        """The loop with all sensors."""
        return self.cases[0]


def closed_loop(plant: Plant, result: Design, controller: Controller,
                uncertainty: str | float | Mapping[str, float] | None = None) -> ClosedLoop:
    """
    Close the loop with all sensors healthy, and with each fault set of a design replaced.

    ``uncertainty``: '10%' of all parameters of the plant file, or 'mass=10%,length=5%' (or 0.1, or
    by name): the plant's parameters are put off to all corners, while controller and virtual
    sensors stay what they are. Terms have their slopes at the operating point. A continuous plant
    with a controller of samples is taken from sample to sample exactly, its commands held. Raises
    BadInput.
    """
    law, shares = check_loop(plant, controller, uncertainty)
    if result.plant_hash != plant.hash():
        raise BadInput('closed_loop', 'result', 'is the design of another plant',
                       'design this one anew')
    around = [(factors, varied(plant, factors)) for factors in corners(shares)] if shares else []
    errors, assumed = _errors(plant, law.sample_time)
    sets = [(), *(lost for lost in result.fault_sets if lost)]
    cases = tuple(_case(plant, result, controller, law, errors, lost, around) for lost in sets)
    used = [(term, g) for term, g, column in zip(plant.terms, plant.G, plant.P.T)
            if column.any() and names(parse(term.text))]
    left_out = tuple(term.name for term, g in used if kinked(
        term, g @ plant.operating_point, plant.inputs, plant.operating_input))
    bent = bool(used) or any(curve.text for curve in plant.curves.values())
    return ClosedLoop(controller, cases, law.sample_time, shares, len(around),
                      2**len(shares) if shares else 0, assumed, left_out, not bent,
                      plant.sample_time is None and law.sample_time is not None)


def check_loop(plant: Plant, controller: Controller,
               uncertainty: str | float | Mapping[str, float] | None = None
               ) -> tuple[Law, dict[str, float]]:
    """
    Return the controller in the plant's order, at its sample time, and by how much what is off.

    Raises BadInput, as ``closed_loop`` would.
    """
    where = controller.name
    for key, of, known in (('reads', controller.reads, plant.sensors),
                           ('writes', controller.writes, plant.inputs)):
        for name in of:
            if name not in known:
                raise BadInput(where, key, f'unknown name {shown(name)}',
                               suggestion(name, known))
    step, h = plant.sample_time, controller.sample_time
    if step is not None:
        if h is None and len(controller.A):
            raise BadInput(where, 'sample_time', 'is missing, and the plant is sampled',
                           f'give {step:g}, or a multiple of it')
        h = step if h is None else h
        if abs(h / step - round(h / step)) > 1e-6 * h / step or round(h / step) < 1:
            raise BadInput(where, 'sample_time', f'{h:g} s is no multiple of that of the plant, '
                           f'{step:g} s', 'give one')
    elif h is None and plant.delays():
        raise BadInput(where, 'sample_time', 'is missing, and the plant has dead times',
                       'give the seconds at which the controller works')
    heard = [plant.sensors.index(name) for name in controller.reads]
    told = [plant.inputs.index(name) for name in controller.writes]
    r, count, m = len(controller.A), len(plant.sensors), len(plant.inputs)
    B, C, D = np.zeros((r, count)), np.zeros((m, r)), np.zeros((m, count))
    B[:, heard], C[told], D[np.ix_(told, heard)] = controller.B, controller.C, controller.D
    return (Law(controller.A, B, C, D, h),
            {} if uncertainty is None else chosen(plant, uncertainty))


def _errors(plant: Plant, h: float | None) -> tuple[Errors, bool]:
    """Return the noise of a plant, as designs take it, and whether some of it is assumed."""
    problem = pose(plant, (), 'all', plant.C)
    model = noise_model(problem)
    lasts = model.lasts
    if h is not None and plant.sample_time is None:  # a reading comes with each sample
        lasts = np.where(np.isnan(plant.sensor_rate), h, 1.0 / plant.sensor_rate)
    return Errors(model.reading * problem.y0_size, lasts, model.process * problem.scale), \
        model.assumed


def _case(plant: Plant, result: Design, controller: Controller, law: Law, errors: Errors,
          lost: tuple[str, ...], around: Sequence[tuple[Mapping[str, float], Plant]]) -> Case:
    needed = [name for name in lost if name in controller.reads]
    entries = [result[lost, name] for name in needed]
    for entry in entries:
        if isinstance(entry, Refusal):
            return Case(lost, 'not replaced', f'there is no virtual sensor for {entry.channel}')
        if not isinstance(entry, VirtualSensor):
            return Case(lost, 'not closed', f'the one for {entry.channel} is of the kind '
                        f'{entry.kind}, which is not looked at')
        if late := _later(plant, entry):
            return Case(lost, 'not closed', f'the one for {entry.channel} reads {late}, which '
                        'tells of an earlier time than it would')
    sensors = [entry for entry in entries if isinstance(entry, VirtualSensor)]
    h = law.sample_time
    here = machine(plant, plant, sensors, controller.unheard)
    try:
        loop = close(_steps(plant, here, errors, h, added=False), law)
    except IllPosed:
        return Case(lost, 'not closed', 'a command depends on itself in the same instant, and has '
                    'no solution')
    forgotten = _modes(plant, [s for s in sensors if s.grade == 'temporary'], h)
    poles = loop.poles
    unheld = _matched(poles, forgotten[rates(forgotten, h) > -limit(poles, h)])
    growth, stays = _growth(poles, unheld, h), limit(poles, h)
    verdict = ('unstable' if growth > stays else 'for a time' if unheld.any() else
               'stays' if growth >= -stays else 'stable')
    found = Case(
        lost, verdict, unread=bool(lost) and not needed, growth=growth, poles=poles,
        unheld=poles[unheld], separate=separate(plant, here, sensors),
        states=() if verdict == 'stable' else _shown(plant, loop.A, poles, unheld, verdict, h))
    if verdict == 'stable':
        cut = close(_steps(plant, here, errors, h, added=True), law)
        found = replace(
            found, sensitivity={name: cut.sensitivity(plant.inputs.index(name))
                                for name in controller.writes},
            noise={name: float(size) for name, size in zip(plant.inputs, loop.noise())
                   if name in controller.writes})
    return found if not around else _around(plant, law, errors, controller, sensors, found,
                                            forgotten, around)


def _later(plant: Plant, sensor: VirtualSensor) -> str:
    """Return a sensor that it reads and that is later than its own channel, or ''."""
    late = dict(zip(plant.sensors, plant.sensor_delay))
    return next((name for name in sensor.reads if late[name] > late[sensor.channel]), '')


def _steps(plant: Plant, here: Machine, errors: Errors, h: float | None, added: bool) -> Steps:
    """Return what the controller has before it; `added`: with what is added to the commands."""
    m = len(plant.inputs)
    one, none = np.eye(m), np.zeros((m, m))
    columns = np.block([[one, one], [one, none]]) if added else np.vstack([one, one])
    if h is None:
        return as_it_is(here, columns, errors)
    late = Late(np.tile(plant.input_delay, 1 + added), plant.sensor_delay)
    return sampled(here, columns, errors, late, h, plant.sample_time)


def _around(plant: Plant, law: Law, errors: Errors, controller: Controller,
            sensors: Sequence[VirtualSensor], case: Case, forgotten: np.ndarray,
            around: Sequence[tuple[Mapping[str, float], Plant]]) -> Case:
    """Add to a case what becomes of it at the corners of the parameters."""
    h = law.sample_time

    def at(other: Plant) -> tuple[np.ndarray, float, bool]:
        here = machine(other, plant, sensors, controller.unheard)
        try:
            poles = close(_steps(other, here, errors, h, added=False), law).poles
        except IllPosed:
            return np.zeros(0), np.inf, True
        unheld = _matched(poles, forgotten[rates(forgotten, h) > -limit(poles, h)])
        growth = _growth(poles, unheld, h)
        return poles, growth, growth > limit(poles, h)

    found = [at(other) for _, other in around]
    by_growth = np.argsort([-growth for _, growth, _ in found], kind='stable')
    worst = int(by_growth[0])
    since: float | None = None
    if case.verdict == 'unstable':
        since = 0.0
    elif found[worst][2]:
        since = 1.0

        def unstable(corner: int, part: float) -> bool:
            return at(varied(plant, {name: 1.0 + part * (factor - 1.0)
                                     for name, factor in around[corner][0].items()}))[2]
        for corner in map(int, by_growth):
            if not found[corner][2] or (since < 1.0 and not unstable(corner, since)):
                continue
            stable = 0.0
            for _ in range(BISECTIONS):
                middle = 0.5 * (stable + since)
                stable, since = ((stable, middle) if unstable(corner, middle)
                                 else (middle, since))
    return replace(case, corner_poles=tuple(poles for poles, _, _ in found),
                   unstable_corners=sum(unstable for _, _, unstable in found),
                   worst=Corner(around[worst][0], found[worst][1]), unstable_from=since)


def _modes(plant: Plant, sensors: Sequence[VirtualSensor], h: float | None) -> np.ndarray:
    """Return the eigenvalues of N of virtual sensors, from sample to sample of the controller."""
    values = np.concatenate([np.zeros(0, complex), *(
        np.linalg.eigvals(linear_sensor(plant, sensor)[0]) for sensor in sensors)])
    if h is None:
        return values
    if plant.sample_time is None:
        return np.asarray(np.exp(values * h))
    return np.asarray(values ** round(h / plant.sample_time))


def _matched(poles: np.ndarray, modes: np.ndarray) -> np.ndarray:
    """Return which of the poles (S,) bool are next to these modes, each of another one."""
    chosen_ = np.zeros(len(poles), dtype=bool)
    if len(modes) and len(poles):
        rows, _ = linear_sum_assignment(np.abs(poles[:, None] - modes))
        chosen_[rows] = True
    return chosen_


def _growth(poles: np.ndarray, unheld: np.ndarray, h: float | None) -> float:
    return float(rates(poles[~unheld], h).max(initial=-np.inf))


def _shown(plant: Plant, A: np.ndarray, poles: np.ndarray, unheld: np.ndarray, verdict: str,
           h: float | None) -> tuple[str, ...]:
    """Return the states of the plant in which the mode that is not stable shows most."""
    values, vectors = np.linalg.eig(A)
    among = poles[unheld] if verdict == 'for a time' else poles[~unheld]
    mode = among[int(np.argmax(rates(among, h)))]
    size = np.abs(vectors[:len(plant.states), int(np.argmin(np.abs(values - mode)))])
    if not size.max(initial=0.0) > 1e-9:
        return ()
    return tuple(name for name, part in zip(plant.states, size) if part > 0.3 * size.max())
