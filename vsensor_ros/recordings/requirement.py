"""
What is asked of a verdict: ``T1: rmse < 0.8, coverage > 0.9; T2: median < 0.5``.

It is taken apart by hand: a channel (or * for all), and comparisons of what is measured with
numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import operator
import re
from typing import NamedTuple

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.recordings.judgement import Judgement

MEASURED = ('rmse', 'median', 'p90', 'p99', 'served', 'windows_served', 'coverage1', 'coverage',
            'coverage3', 'deviation', 'noise', 'step', 'until', 'found', 'delay', 'blamed',
            'alarms', 'hold', 'regression', 'arx')
SIGNS: dict[str, Callable[[float, float], bool]] = {
    '<': operator.lt, '<=': operator.le, '>': operator.gt, '>=': operator.ge}

_COMPARISON = re.compile(r'\s*(\w+)\s*(<=|>=|<|>)\s*(\S+)\s*')


class Requirement(NamedTuple):
    """One comparison."""

    channel: str  # *: all
    measured: str
    sign: str
    bound: float | str  # a number, or something else that is measured

    def __str__(self) -> str:
        bound = f'{self.bound:g}' if isinstance(self.bound, float) else self.bound
        return f'{self.channel}: {self.measured} {self.sign} {bound}'


class Outcome(NamedTuple):
    """How a requirement was met by one judgement."""

    requirement: Requirement
    judgement: Judgement
    passed: bool


def read_requirements(text: str, channels: Sequence[str]) -> list[Requirement]:
    """Take a text apart; raises BadInput."""
    found: list[Requirement] = []
    for part in filter(str.strip, text.split(';')):
        channel, colon, comparisons = (piece.strip() for piece in part.partition(':'))
        if not colon or not comparisons:
            raise BadInput('--require', '', f'{shown(part)} says of no channel what it asks',
                           'write it like T1: rmse < 0.8, coverage > 0.9')
        if channel != '*' and channel not in channels:
            raise BadInput('--require', channel, 'is no channel that is judged',
                           f'choose from {", ".join(channels)}, or * for all')
        found += [_requirement(channel, comparison) for comparison in comparisons.split(',')]
    if not found:
        raise BadInput('--require', '', 'asks nothing',
                       'write it like T1: rmse < 0.8, coverage > 0.9')
    return found


def _requirement(channel: str, text: str) -> Requirement:
    match = _COMPARISON.fullmatch(text)
    if match is None:
        raise BadInput('--require', channel, f'{shown(text.strip())} is no comparison',
                       'write it like rmse < 0.8')
    measured, sign, bound = match.groups()
    if measured not in MEASURED:
        raise BadInput('--require', channel, f'{shown(measured)} is not measured',
                       f'choose from {", ".join(MEASURED)}')
    if bound in MEASURED:
        return Requirement(channel, measured, sign, bound)
    try:
        number = float(bound)
    except ValueError:
        number = float('nan')
    if number != number:
        raise BadInput('--require', channel, f'{shown(bound)} is no number',
                       'write it like rmse < 0.8')
    return Requirement(channel, measured, sign, number)


def check(requirements: Sequence[Requirement], judgements: Sequence[Judgement]) -> list[Outcome]:
    """Return how each judgement meets what is asked of its channel; what is not known does not."""
    return [Outcome(r, j, bool(SIGNS[r.sign](
        getattr(j, r.measured), r.bound if isinstance(r.bound, float) else getattr(j, r.bound))))
        for r in requirements for j in judgements if r.channel in ('*', j.channel)]
