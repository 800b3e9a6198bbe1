"""What the bank asks of the virtual sensors of one kind, all of a design at once."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from vsensor_ros.observers.entry import Key
from vsensor_ros.reason import Reason


class Told(NamedTuple):
    """What L sensors and m commands said at one time of the bank's grid."""

    y: np.ndarray  # (L,) readings, 0 where there is none
    there: np.ndarray  # (L + m,) bool: which readings and commands there are
    held: np.ndarray  # (m,) commands that hold from then on; (0,) when nobody asks for them
    # (L,) s, how far from readings y is, see Samples.age; (0,) when nobody asks
    ages: np.ndarray = np.zeros(0)


class Tracked(NamedTuple):
    """A virtual sensor that its failed channels correct while they are believed (method, 8)."""

    own: int  # its row below V; of a temporary one that is the free run
    tracker: int  # row of the run that the channels correct
    free: int  # row of the run that goes on from a state of the tracker, without the channels
    channels: tuple[int, ...]  # the sensors that correct
    warm_up: float  # s until the tracker has forgotten its start; inf: not known

    @property
    def temporary(self) -> bool:
        """Whether there is no run that never needed the channels."""
        return self.free == self.own


class Bent(NamedTuple):
    """How the error of a free run begins and grows whose nonlinear terms bend it; k is its own."""

    start: np.ndarray  # (k, k) covariance of z at its start
    growth: np.ndarray  # (k, k) what a step adds
    row: np.ndarray  # (k,) of z in what it says
    direct: float  # variance of what it says beside that


# takes the states (n, k) of n runs, and what was told, as `Batch.step`
StepOfSome = Callable[[np.ndarray, Told, Told, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Batch(ABC):
    """
    V virtual sensors with O outputs, O >= V, and R >= V runs of them, with states z (R, k).

    Run i < V is that of virtual sensor i, those beyond help them: see `tracked`. Arrays of V are
    by virtual sensor, those of O by output, those of R by run. Where z is (V, k) it is what
    serves: of each virtual sensor one of its runs. What a kind has nothing to say of keeps its
    default. Methods must not change what they are given, and must not fail for numbers that are
    not finite.
    """

    keys: tuple[Key, ...]  # O: fault set and name of each output
    of: np.ndarray  # (O,) int: which virtual sensor says it
    width: int  # k, states of a virtual sensor at most; all else is 0
    runs_on: np.ndarray  # (R, L + m) bool: readings and commands without which each stops
    starts_on: np.ndarray  # (R, L + m) bool: and those it needs to start
    own: np.ndarray  # (O,) int: the sensor that an output stands in for; -1: none
    # (O,) steady-state standard deviation, beyond what `deviation` says; NaN: not known
    error: np.ndarray
    assumed: np.ndarray  # (O,) bool: that is made of default figures
    slowest: np.ndarray  # (O,) s, the largest time constant: over which deviations die out
    warm_up: np.ndarray  # (O,) s from its start until nothing of that is left; inf: not known
    proved: np.ndarray  # (O,) bool: that it converges
    wants_held: bool = False  # whether it reads Told.held
    wants_ages: bool = False  # whether it reads Told.ages
    tracked: tuple[Tracked, ...] = ()
    # entries that cannot be run, and why
    left_out: Mapping[Key, Reason] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """V."""
        return int(self.of.max(initial=-1)) + 1

    @abstractmethod
    def start(self, told: Told) -> np.ndarray:
        """Return the states (R, k) with which to start; what is not finite does not start."""

    @abstractmethod
    def step(self, z: np.ndarray, before: Told, after: Told,
             commands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """
        Step the states (R, k) over one period.

        Commands (3, m): at both ends, as a straight line, and their mean. Return the states, and
        who saw an argument outside of a function's domain (R,) bool.
        """

    def step_of(self, rows: np.ndarray) -> StepOfSome:
        """
        Return what steps the states of some runs alone; rows (n,) int may repeat.

        It is asked of kinds with `tracked` ones only.
        """
        raise NotImplementedError

    @abstractmethod
    def estimates(self, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return the outputs (.., O) of states (.., V, k), readings (.., L), commands (.., m)."""

    def estimate(self, output: int, z: np.ndarray, y: np.ndarray, held: np.ndarray) -> np.ndarray:
        """Return one output (..) of states (.., k) of one of its runs; see `step_of`."""
        raise NotImplementedError

    def waiting(self, output: int, z: np.ndarray, age: float) -> float:
        """Return the time [s] until it is ready, at an age [s]; inf: that is not known."""
        return max(0.0, float(self.warm_up[output]) - age)

    def invalid(self, output: int, z: np.ndarray, told: Told, age: float) -> Reason | None:
        """Return why its estimate is not to be used, now or any more; None: it is."""
        return None

    def outside_region(self, output: int, z: np.ndarray, told: Told) -> bool:
        """Tell whether it runs where nothing is proved of it."""
        return False

    def deviation(self, output: int, z: np.ndarray, told: Told, age: float) -> float:
        """Return the standard deviation at an age [s], beside `error` and what was measured."""
        return 0.0

    def drift(self, i: int, ages: np.ndarray) -> np.ndarray:
        """Return the standard deviation of what a free run says, so long [s] after its start."""
        return np.full(np.shape(ages), np.inf)

    def along(self, i: int, z: np.ndarray) -> float:
        """Return the standard deviation that a free run's own state (k,) tells; 0: none."""
        return 0.0

    def bent(self, i: int) -> Bent | None:
        """Return how the error of a free run grows along its way; None: `drift` tells all."""
        return None

    def interval(self, output: int, z: np.ndarray, told: Told,
                 age: float) -> tuple[float, float] | None:
        """Return between what bounds the truth is for certain; None: there are none."""
        return None

    def reach(self, slopes: np.ndarray, ages: np.ndarray, direct: bool = True,
              output: int | None = None) -> np.ndarray:
        """
        Return how far outputs (O,), or one (1,), may be off, one standard deviation.

        That is when readings have moved at these slopes (L,) [1/s], unseen for these ages (L,)
        [s]; direct: they are still held, and not only felt in the states.
        """
        return np.zeros(len(self.keys) if output is None else 1)
