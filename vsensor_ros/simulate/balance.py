"""The story of a machine that falls when it is told nonsense: a demo.yaml that names a model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vsensor_ros.plant import Plant
from vsensor_ros.simulate.section import Section

_KEYS = {'title', 'model', 'rate', 'initial', 'gusts', 'travel', 'even', 'fault', 'fallen', 'bar'}


@dataclass(frozen=True)
class Balance:
    """
    What happens in each run; times in seconds of the run's own time.

    Each sensor in `bar` (the largest RMSE allowed of its replacement, in its unit) freezes in two
    runs, at `failed_at`: nobody replaces it in the first, and the replacer does in the second.
    `even` are deviations of states and commands that cost the controller the same.
    """

    title: str
    model: Path
    period: float
    initial: dict[str, float]   # by joint, m or rad
    gusts: dict[str, float]     # N or N m by joint, standard deviation
    travels: str                # the state that is to go to and fro
    amplitude: float
    to_and_fro: float           # s
    even: dict[str, float]
    failed_at: float
    isolated_at: float
    end: float
    fallen: dict[str, float]    # size of readings from which on it does not stand
    bar: dict[str, float]

    @property
    def leans(self) -> str:
        """Return the state that is to stay near 0: the other one in which it falls."""
        return next(name for name in self.fallen if name != self.travels)

    def step(self, time: float) -> int:
        """Return the number of the period that begins at a time."""
        return round(time / self.period)


def is_balance(path: Path) -> bool:
    """Tell whether a demo.yaml is such a story; raise BadInput."""
    return 'model' in Section.of(path).content


def load_balance(path: Path, plant: Plant) -> Balance:
    """Read a demo.yaml; raise BadInput."""
    given = Section.of(path)
    given.expect(_KEYS)
    travel = given.numbers('travel', (*plant.states, 'period'))
    swings = [name for name in travel if name != 'period']
    if len(swings) != 1:
        raise given.bad('travel', 'does not name one state', 'write state: amplitude, period: s')
    fault = given.inner('fault')
    fault.expect({'start', 'isolated_after', 'stands'})
    start = _positive(fault, 'start')
    even, bar = given.inner('even'), given.inner('bar')
    even.expect(set(plant.inputs), set(plant.states))
    bar.expect(set(), set(plant.sensors))
    fallen = given.numbers('fallen', plant.sensors)
    if set(fallen) == {swings[0]} or not fallen:
        raise given.bad('fallen', f'names nothing but {swings[0]}', 'name what leans, too')
    if not bar.content:
        raise given.bad('bar', 'is empty', 'name the sensors that fail, and the RMSE allowed')
    return Balance(
        given.text('title'), path.parent / given.text('model'), 1.0 / _positive(given, 'rate'),
        _numbers(given.inner('initial')), _numbers(given.inner('gusts')), swings[0],
        travel[swings[0]], _positive(given.inner('travel'), 'period'),
        {name: _positive(even, name) for name in even.content}, start,
        start + _positive(fault, 'isolated_after'), start + _positive(fault, 'stands'),
        fallen,
        {name: _positive(bar, name) for name in bar.content})


def _numbers(part: Section) -> dict[str, float]:
    return {name: part.number(name) for name in part.content}


def _positive(part: Section, key: str) -> float:
    value = part.number(key)
    if value <= 0.0:
        raise part.bad(key, 'is not positive', 'write a number above 0')
    return value
