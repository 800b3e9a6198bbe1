"""How the states of a model move over a step, by Runge and Kutta, and its slopes halfway."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from vsensor_ros.functions.equations import Slopes
from vsensor_ros.functions.expression import parse
from vsensor_ros.functions.tape import Program, Tape
from vsensor_ros.observers.kinds.extended.sensor import Model


class Motion:
    """
    Moves R points by a step of h [s]; of a model in discrete time h counts for nothing.

    Slopes (R, n, V) are by the n states, by inputs and unknown inputs that have noise, and by the
    p parameters.
    """

    def __init__(self, model: Model, h: float) -> None:
        """Prepare for the equations of a model."""
        self._model, self._h = model, h
        self._nodes = [parse(text) for text in model.equations]
        self._definitions = [(name, parse(text)) for name, text in model.definitions]
        driving = (*model.inputs, *model.unknown)
        noise = np.concatenate([model.input_noise, model.unknown_noise])
        self._driving = [name for name, of_it in zip(driving, noise) if of_it]
        self.drive = noise[noise != 0.0]  # of those
        self._rest = [*[0.0] * len(model.unknown), *model.values.tolist()]

    def step(self, x: np.ndarray, commands: np.ndarray) -> tuple[np.ndarray, np.ndarray,
                                                                 np.ndarray]:
        """
        Return states (R, n) a step on, those halfway, and the slopes there.

        commands (3, m) at both ends, and their mean; of a model with an angle no slopes.
        """
        slopes, program = self._step
        n = x.shape[1]
        found = program.run(x, [*commands.ravel().tolist(), *self._rest])
        return found[:, :n], found[:, n:2 * n], slopes.of(found)

    def slopes(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return the slopes at states (R, n) and commands (m,)."""
        slopes, program = self._slopes
        return slopes.of(program.run(x, [*u.tolist(), *self._rest]))

    @cached_property
    def _step(self) -> tuple[Slopes, Program]:
        n, m, h = len(self._nodes), len(self._model.inputs), self._h
        tape = Tape(n + 3 * m + len(self._rest))
        x = range(n)
        begin, end, mean = (range(n + i * m, n + (i + 1) * m) for i in range(3))

        def beyond(share: float, slopes: Sequence[int]) -> list[int]:
            much = tape.number(share)
            return [tape.operator('+', a, tape.operator('*', much, k)) for a, k in zip(x, slopes)]

        def slopes_at(x: Sequence[int], u: Sequence[int]) -> list[int]:
            names = self._names(x, u, n + 3 * m)
            tape.define(self._definitions, names)
            return [tape.place(node, names) for node in self._nodes]
        if self._model.sample_time is not None:
            middle: Sequence[int] = x
            halfway = after = slopes_at(x, mean)
        else:
            first = slopes_at(x, begin)
            second = slopes_at(beyond(h / 2, first), mean)
            middle = beyond(h / 2, second)
            halfway = slopes_at(middle, mean)
            fourth = slopes_at(beyond(h, halfway), end)
            twice = [tape.operator('*', tape.number(2.0), tape.operator('+', a, b))
                     for a, b in zip(second, halfway)]
            after = beyond(h / 6, [
                tape.operator('+', tape.operator('+', a, b), c)
                for a, b, c in zip(first, twice, fourth)])
        slopes = Slopes(tape, halfway if not self._model.angle else [],
                        self._by(self._names(middle, mean, n + 3 * m)))
        return slopes, Program(tape, [*after, *middle, *slopes.places])

    @cached_property
    def _slopes(self) -> tuple[Slopes, Program]:
        n, m = len(self._nodes), len(self._model.inputs)
        tape = Tape(n + m + len(self._rest))
        names = self._names(range(n), range(n, n + m), n + m)
        tape.define(self._definitions, names)
        slopes = Slopes(tape, [tape.place(node, names) for node in self._nodes], self._by(names))
        return slopes, Program(tape, slopes.places)

    def _names(self, x: Sequence[int], u: Sequence[int], rest: int) -> dict[str, int]:
        """Return where each name stands: states, inputs, and all others from a place on."""
        m = self._model
        return dict(zip((*m.states, *m.inputs, *m.unknown, *m.parameters),
                        (*x, *u, *range(rest, rest + len(self._rest)))))

    def _by(self, names: dict[str, int]) -> list[int]:
        m = self._model
        return [names[name] for name in (*m.states, *self._driving, *m.parameters)]
