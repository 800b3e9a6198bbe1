"""What a closed loop says, in words that the terminal and the report share. Plain text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from vsensor_ros.control import Case, ClosedLoop
from vsensor_ros.control.loop import rates
from vsensor_ros.control.uncertainty import SEED
from vsensor_ros.plant import Plant
from vsensor_ros.report.design_text import joined, number, spectrum

FRAGILE = 5.0  # a sensitivity peak from which on a loop is called hardly stable
NOT_THE_LOOPS = "certificates and eigenvalues of N are the observer's, not the loop's"
UNHELD = 'the loop has a mode that no reading holds'


def headlines(loop: ClosedLoop) -> list[str]:
    """Return what comes first of all, the worst in front, a line each."""
    lines = []
    for verdict, case in (('unstable', 'UNSTABLE'), ('not closed', 'NOT LOOKED AT')):
        of = [c for c in loop.cases if c.verdict == verdict]
        if of:
            lines.append(f'IN THE LOOP {case} with {_sets(of)}: ' + (
                f'it grows by {number(max(c.growth for c in of), "1/s")}; {NOT_THE_LOOPS}'
                if verdict == 'unstable' else '; '.join(dict.fromkeys(c.reason for c in of))))
    off = [c for c in loop.cases if c.unstable_corners and c.verdict != 'unstable']
    if off:
        worst = max(off, key=_at_worst)
        lines.insert(any(c.verdict == 'unstable' for c in loop.cases), (
            f'IN THE LOOP UNSTABLE with {_sets(off)}, where the parameters are '
            f'off{_by(loop.shares)}: it grows by {number(_at_worst(worst), "1/s")} '
            f'({_from(worst, loop.shares)}); {NOT_THE_LOOPS}'))
    of = [c for c in loop.cases if c.verdict == 'for a time']
    if of:
        lines.append(f'In the loop good for a time only with {_sets(of)}: {UNHELD}')
    of = [c for c in loop.cases if c.holds and c.peak > FRAGILE]
    if of:
        peak = max(c.peak for c in of)
        lines.append(
            f'In the loop HARDLY STABLE with {_sets(of)}: sensitivity peak {number(peak)}, so '
            f'that a model that is wrong by {number(100.0 / peak, "%")} may end it; '
            f'{NOT_THE_LOOPS}')
    of = [c for c in loop.cases if c.verdict == 'stays' and not c.unstable_corners]
    if of:
        lines.append(f'In the loop a mode neither dies out nor grows with {_sets(of)}: the '
                     'controller does not hold it')
    if not lines:
        lines.append(f'In the loop stable with {_sets([c for c in loop.cases if c.holds])}'
                     f'{_looked_at(loop)}')
    return lines


def closed_how(loop: ClosedLoop) -> str:
    """Say what was closed, and how."""
    said = [loop.controller.name]
    if loop.sample_time is not None:
        said.append(f'each {number(loop.sample_time, "s")}')
    if loop.between:
        said.append('exact from sample to sample with its commands held (zero-order hold)')
    if not loop.linear:
        said.append('linear about the operating point')
    return ', '.join(said)


def notes(loop: ClosedLoop) -> list[str]:
    """Return what is to be known besides, a line each."""
    said = []
    replaced = [c for c in loop.cases if c.lost and not c.unread and len(c.poles)]
    if replaced and all(c.separate for c in replaced):
        said.append('While the model is right the poles are those with healthy sensors and the '
                    'eigenvalues of N: the virtual sensors hear the commands that the plant gets. '
                    'With a model that is wrong they are not.')
    elif replaced:
        why = (f': the virtual sensors do not hear {", ".join(loop.controller.unheard)}'
               if loop.controller.unheard else '')
        said.append('The poles are not those with healthy sensors and the eigenvalues of N, even '
                    f'while the model is right{why}.')
    if loop.left_out:
        said.append(f'Left out, because it has no slope at the operating point: '
                    f'{", ".join(loop.left_out)}.')
    if loop.corners < loop.all_corners:
        said.append(f'{loop.corners} of {loop.all_corners:.3g} corners were looked at, drawn at '
                    f'random with seed {SEED}.')
    if loop.assumed:
        said.append('The noise of the commands is made of noise that is assumed.')
    return said


def facts(loop: ClosedLoop, case: Case, plant: Plant | None,
          shown: int) -> list[tuple[str, str]]:
    """Return names and texts of one loop; shown: how many poles."""
    if case.reason:
        return [('why', case.reason)]
    units = {} if plant is None else plant.units
    said = [('poles' if loop.sample_time is None else 'poles of z',
             f'{spectrum(case.poles, loop.sample_time, shown)}; {_slowest(loop, case)}')]
    if case.worst is not None:
        corners = f'{case.unstable_corners or "none"} of {loop.corners} unstable'
        at = ', '.join(f'{name} {100.0 * (factor - 1.0):+.3g} %'
                       for name, factor in case.worst.factors.items())
        since = f', {_from(case, loop.shares)}' if case.unstable_corners else ''
        said.append(('at the corners', f'{corners}{since}; the worst '
                                       f'{_moves(case.worst.growth)}, with {at}'))
    if case.sensitivity is not None:
        said.append(('sensitivity', ', '.join(
            f'peak {number(size)}' + (f' at {number(at, "rad/s")}' if np.isfinite(at) else '')
            + (f' of {name}' if len(case.sensitivity) > 1 else '')
            for name, (size, at) in case.sensitivity.items())))
    if case.noise is not None:
        said.append(('noise of', ', '.join(
            f'{name} {number(size, units.get(name, ""))}' for name, size in case.noise.items())))
    return said


def title(case: Case) -> str:
    """Name a loop by what is replaced in it, with its verdict."""
    words = {'unstable': 'UNSTABLE', 'for a time': f'for a time only: {UNHELD}',
             'stays': 'a mode stays that the controller does not hold',
             'not closed': 'not looked at', 'not replaced': 'cannot be replaced'}
    said = words.get(case.verdict, 'stable')
    if case.states:
        said += f', in {", ".join(case.states)}'
    if case.unstable_corners and case.verdict != 'unstable':
        said += ', UNSTABLE at corners'
    return f'{joined(case.lost) if case.reason else _replaced(case)}: {said}' + (
        ' (the controller reads nothing of it)' if case.unread else '')


def row(loop: ClosedLoop, case: Case, plant: Plant) -> tuple[str, ...]:
    """Return a loop as cells of a table: lost, verdict, rates, corners, sensitivity, noise."""
    noise = '' if case.noise is None else ', '.join(
        number(size, plant.units.get(name, '')) for name, size in case.noise.items())
    verdict = 'UNSTABLE at corners' if case.unstable_corners and case.verdict != 'unstable' \
        else case.verdict
    return (joined(case.lost) if case.lost else 'none', verdict,
            '' if np.isnan(case.growth) else f'{case.growth:+.3g}',
            '' if case.worst is None else f'{case.worst.growth:+.3g}',
            '' if case.worst is None else f'{case.unstable_corners} of {loop.corners}',
            '' if np.isnan(case.peak) else number(case.peak), noise)


def _slowest(loop: ClosedLoop, case: Case) -> str:
    """Say at which rate it dies out, or grows."""
    if case.verdict != 'for a time':
        return _moves(case.growth)
    held = f'the rest {_moves(case.growth)}'
    free = rates(case.unheld, loop.sample_time).max()
    if free > 1e-9:
        return f'what no reading holds {_moves(free)}; {held}'
    return f'what no reading holds stays; {held}'


def _moves(growth: float) -> str:
    if not np.isfinite(growth):
        return 'dies out at once' if growth < 0.0 else 'has no solution'
    return f'grows by {number(growth, "1/s")}' if growth > 0.0 else \
        f'dies out at {number(-growth, "1/s")}'


def _replaced(case: Case) -> str:
    return f'{joined(case.lost)} replaced' if case.lost else 'all sensors healthy'


def _sets(cases: Sequence[Case]) -> str:
    lost = ', '.join(joined(c.lost) for c in cases if c.lost)
    parts = [] if all(c.lost for c in cases) else ['all sensors healthy']
    return ' and with '.join([*parts, *([f'{lost} replaced'] if lost else [])])


def _at_worst(case: Case) -> float:
    return case.worst.growth if case.worst is not None else -np.inf


def _by(shares: Mapping[str, float]) -> str:
    sizes = set(shares.values())
    return f' by {number(100.0 * sizes.pop(), "%")}' if len(sizes) == 1 else ' as far as given'


def _from(case: Case, shares: Mapping[str, float]) -> str:
    """Say from which errors on it is unstable."""
    part = case.unstable_from or 0.0
    sizes = set(shares.values())
    if len(sizes) == 1:
        return f'from {number(100.0 * part * sizes.pop(), "%")} on'
    return f'from {number(part)} times that on'


def _looked_at(loop: ClosedLoop) -> str:
    peak = max((c.peak for c in loop.cases), default=np.nan)
    sharp = f'; sensitivity peak {number(peak)} at most' if np.isfinite(peak) else ''
    if not loop.corners:
        return f', with the parameters as they are{sharp}'
    return f', also at {loop.corners} corners of parameters off{_by(loop.shares)}{sharp}'
