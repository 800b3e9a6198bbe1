"""What a replay says to people, on a terminal and in JSON."""

from __future__ import annotations

from collections.abc import Sequence
import json
import math
from typing import Any

from vsensor_ros.recordings.judgement import Judgement, PEERS
from vsensor_ros.recordings.requirement import Outcome
from vsensor_ros.recordings.trials import Trials

NAMES = {'hold': 'holding the last reading', 'regression': 'a static regression on the other '
         'channels', 'arx': 'an ARX model'}


def title(j: Judgement) -> str:
    """Return of what a judgement is."""
    unit = f' [{j.unit}]' if j.unit else ''
    return f'{j.channel}{unit}, {", ".join(j.fault_set)} lost ({j.kind.replace("_", "-")})'


def lines_of(j: Judgement) -> list[str]:
    """Return what there is to say of one judgement, a line each."""
    said = [f'served        in {_share(j.windows_served)} of {j.windows} windows, for '
            f'{_share(j.served)} of the time' + (f' ({j.grade})' if j.grade else '')]
    if not math.isnan(j.rmse):
        said += [
            f'error         rmse {j.rmse:.3g}; at the end median {j.median:.3g}, '
            f'90 % {j.p90:.3g}, 99 % {j.p99:.3g}',
            f'stated        {j.deviation:.3g}{_reading(j)}; within 1, 2, 3 deviations '
            f'{_share(j.coverage1)}, {_share(j.coverage)}, {_share(j.coverage3)}',
            f'step          {_number(j.step)} at the switch']
    if math.isfinite(j.until):
        said.append(f'until         {j.until:.3g} s after the loss, where it ends in the window')
    if j.best_peer:
        said.append('simple peers  ' + ', '.join(
            f'{name} {value:.3g}' for name in PEERS if not math.isnan(value := getattr(j, name))))
    if not j.served and j.best_peer:
        said.append(f'NOTHING WENT OUT: {NAMES[j.best_peer]} comes to '
                    f'{float(getattr(j, j.best_peer)):.3g}')
    if j.beaten:
        best = float(getattr(j, j.best_peer))
        digits = 3 if f'{best:.3g}' != f'{j.rmse:.3g}' else 6  # it is to be seen which is less
        better = sorted((value, NAMES[name]) for name in PEERS
                        if (value := float(getattr(j, name))) < j.rmse)
        said.append('A SIMPLE PEER WINS: ' + ', '.join(
            f'{name} {value:.{digits}g}' for value, name in better)
            + f' against {j.rmse:.{digits}g}')
    if not math.isnan(j.found):
        said.append(f'isolator      found in {_share(j.found)} of the windows, after '
                    f'{_number(j.delay)} s; others blamed in {_share(j.blamed)}; '
                    f'{j.alarms:.3g} false alarms a day')
    return said + [f'not at end    {count} of {j.windows} windows: {why}'
                   for why, count in j.why.items()]


def replay_text(judgements: Sequence[Judgement], outcomes: Sequence[Outcome],
                trials: Trials) -> str:
    """Return the verdict."""
    blocks = ['\n'.join([title(j), *(f'    {line}' for line in lines_of(j))]) for j in judgements]
    w = trials.windows
    blocks.append(f'windows of {w.length:g} s every {w.every:g} s; peers were fitted on what lies '
                  'between them')
    if outcomes:
        blocks.append('\n'.join(outcome_line(o) for o in outcomes))
        failed = sum(not o.passed for o in outcomes)
        blocks.append(f'FAIL: {failed} of {len(outcomes)} are not met' if failed else
                      f'PASS: all {len(outcomes)} are met')
    return '\n\n'.join(blocks)


def outcome_line(o: Outcome) -> str:
    """Return whether a requirement was met, and by what."""
    j = o.judgement
    said = f'{"PASS" if o.passed else "FAIL"}  {o.requirement}  ' \
           f'({_number(getattr(j, o.requirement.measured))}'
    if isinstance(o.requirement.bound, str):
        said += f' and {_number(getattr(j, o.requirement.bound))}'
    return f'{said}; {", ".join(j.fault_set)} lost, {j.kind.replace("_", "-")})'


def replay_json(judgements: Sequence[Judgement], outcomes: Sequence[Outcome],
                trials: Trials) -> str:
    """Return all that is known, as JSON; what is not is null."""
    return json.dumps({
        'windows': {key: _plain(getattr(trials.windows, key))
                    for key in ('every', 'length', 'start', 'end')},
        'verdicts': [{**{key: _plain(value) for key, value in vars(j).items() if key != 'shown'},
                      'best_peer': j.best_peer, 'beaten': j.beaten} for j in judgements],
        'false_alarms': [{'recording': name, 'time': at, 'blamed': list(names)}
                         for name, at, names in trials.alarms],
        'requirements': [{'requirement': str(o.requirement), 'fault_set': o.judgement.fault_set,
                          'kind': o.judgement.kind, 'passed': o.passed} for o in outcomes],
        'passed': all(o.passed for o in outcomes)}, indent=1, allow_nan=False)


def _reading(j: Judgement) -> str:
    """Say what the noise of a reading, by which an error is judged, adds to what is stated."""
    both = f'{math.hypot(j.deviation, j.noise):.3g}'
    return '' if both == f'{j.deviation:.3g}' else f', with the noise of a reading {both}'


def _plain(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _share(value: float) -> str:
    return '-' if math.isnan(value) else f'{100.0 * value:.3g} %'


def _number(value: float) -> str:
    return '-' if math.isnan(value) else f'{value:.3g}'
