"""What a design says, in words that the terminal and the report share. Plain text, not escaped."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from math import comb

import numpy as np

from vsensor_ros.designer.location import Location
from vsensor_ros.observers import (
    Certificate,
    Design,
    Entry,
    Refusal,
    Rung,
    settling_time,
    VirtualSensor,
)
from vsensor_ros.observers.kinds.functional import short_name

NEARLY = 1e-9  # 1/s: a mode that grows more slowly stays
DEAD = 20.0  # times the sample time: a faster decay than by exp(-20) a step is none
SHOWN = 6  # eigenvalues, of many
LISTED = 12  # fault sets, of many
COUNTS = {1: 'one', 2: 'two', 3: 'three', 4: 'four', 5: 'five'}
VERDICTS = ('yes', 'bounded', 'temporary', 'no')


def number(value: float, unit: str = '') -> str:
    """Return a figure of three digits with its unit."""
    return f'{value:.3g} {unit}'.rstrip()


def joined(fault_set: Iterable[str]) -> str:
    """Return a fault set as one word: 'y1+y2'."""
    return '+'.join(fault_set) or 'nothing'


def verdict(design: Design, fault_set: tuple[str, ...]) -> str:
    """
    Say whether a set can be lost: 'yes', 'bounded', 'temporary' or 'no'.

    Every sensor of it must be replaceable; 'bounded': unknown inputs disturb one; 'temporary': one
    serves for a time only.
    """
    entries = [e for (s, channel), e in design.entries.items() if s == fault_set]
    if any(isinstance(e, Refusal) for e in entries):
        return 'no'
    grades = {e.grade for e in entries if not isinstance(e, Refusal)}
    return next((grade for grade in ('temporary', 'bounded') if grade in grades), 'yes')


def losses(design: Design) -> dict[int, dict[tuple[str, ...], str]]:
    """Return by size the verdict on every set of sensors that was designed for."""
    found: dict[int, dict[tuple[str, ...], str]] = {}
    for fault_set in design.fault_sets:
        if fault_set:
            found.setdefault(len(fault_set), {})[fault_set] = verdict(design, fault_set)
    return dict(sorted(found.items()))


def loss_lines(design: Design) -> list[tuple[str, list[str]]]:
    """Return for each size ('one', ..) the sentences on which sets can be lost."""
    lines = []
    lost: list[tuple[str, ...]] = []  # sets that cannot be lost and hold no smaller such set
    for size, sets in losses(design).items():
        by = {v: [s for s, said in sets.items() if said == v] for v in VERDICTS}
        news = [s for s in by['no'] if not any(set(fewer) < set(s) for fewer in lost)]
        able = [s for s in sets if s in {*by['yes'], *by['bounded']}]
        good = ' for good' if by['temporary'] else ''
        if not able:
            said = [('none' if len(sets) == 1 else f'none of {len(sets)}') + good]
        elif len(able) == len(sets):
            said = [f'all {len(sets)}' + (f': {_list(able)}' if len(able) <= LISTED or size == 1
                                          else '')]
        elif size == 1 or len(able) <= LISTED:
            said = [f'{len(able)} of {len(sets)}{good}: {_list(able, size == 1)}']
        else:
            said = [f'{len(able)} of {len(sets)}{good}']
        if by['temporary']:
            many = f'{len(by["temporary"])} ' if len(by['temporary']) > LISTED else ''
            said.append(f'{many}for a time: {_list(by["temporary"], size == 1)}')
        if by['no'] and size == 1:
            said.append(f'not {_list(by["no"], True)}')
        elif by['no'] and len(able) + len(by['temporary']) > LISTED:
            holds = [s for s in lost if any(set(s) < set(other) for other in by['no'])]
            parts = ([f'none that holds {_list(holds)}'] if holds else []) + (
                [f'not {_list(news)}'] if news else [])
            said.append('; '.join(parts))
        if by['bounded']:
            said.append(f'of these disturbed by unknown inputs, within a bound: '
                        f'{_list(by["bounded"], size == 1)}')
        if design.isolability is not None and len(sets) < comb(len(design.sensors), size):
            said.append('others of this size were not looked at')
        lines.append((COUNTS.get(size, str(size)), said))
        lost += news
    return lines


def _list(sets: Sequence[tuple[str, ...]], whole: bool = False) -> str:
    shown = sets if whole else sets[:LISTED]
    more = f' and {len(sets) - len(shown)} more' if len(shown) < len(sets) else ''
    return ', '.join(map(joined, shown)) + more


def title(design: Design, fault_set: tuple[str, ...], channel: str) -> str:
    """Name a virtual sensor: its channel, the unit, and what has failed besides."""
    unit = design.units.get(channel)
    text = f'{channel} [{unit}]' if unit else channel
    if not fault_set:
        return text
    if channel not in fault_set:
        return f'{text} when {" and ".join(fault_set)} failed'
    if any(len(s) > 1 for s in design.fault_sets):
        text += (f' when {" and ".join(fault_set)} failed' if len(fault_set) > 1
                 else ' when it alone failed')
    return text


def state_of(entry: Entry | Refusal) -> str:
    """Say in three words what became of a channel."""
    done = 'replaced' if entry.channel in entry.fault_set else 'computed'
    if isinstance(entry, Refusal):
        return f'cannot be {done}'
    return f'can be {done}' + {'bounded': ' within a bound, disturbed by unknown inputs',
                               'temporary': ' for a time'}.get(entry.grade, '')


def left_out(entry: Entry | Refusal) -> str:
    """Say where in the declared ranges nothing is proved of it, and whether it is unstable."""
    c = None if isinstance(entry, Refusal) else entry.certificate
    return f', BUT NOT PROVED {c.uncovered}' if c is not None and c.uncovered else ''


def order(entry: Entry) -> str:
    """Say the order and what is proved of it."""
    proof = entry.proof
    if proof is None:
        return f'{entry.order} (nothing proved of the least)'
    least = (f'the least is {proof.upper}, proved' if proof.least
             else f'the least is between {proof.lower} and {proof.upper}')
    if proof.least and entry.order == proof.upper:
        return f'{entry.order} (proved least)'
    if entry.order > proof.upper:
        least += '; this one is quieter or faster'
    return f'{entry.order} ({least})'


def noise(entry: Entry, unit: str) -> str:
    """Say the noise error, and how it stands to the floor."""
    if entry.noise is None:
        return 'not computed'
    n = entry.noise
    text = number(n.error, unit)
    if not np.isfinite(n.floor):
        text += '; no Kalman filter on these sensors to compare with'
    elif n.floor == 0.0:
        text += '; no noise at all reaches a Kalman filter on the same sensors'
    else:
        text += f', {n.ratio:.2f} x the floor of {number(n.floor, unit)}'
    return text + ('; assumed noise' if n.assumed else '')


def decay(entry: Entry) -> str:
    """Say how fast an error dies out, judged by the eigenvalues."""
    if not entry.order:
        return 'at once: it has no state'
    if entry.grade == 'temporary':
        return ('none: an error that is there at the loss does not die out'
                if entry.decay > -NEARLY else
                f'none: an error doubles in {number(np.log(2.0) / -entry.decay, "s")}')
    settled = settling_time(entry) if isinstance(entry, VirtualSensor) else 3.0 / entry.decay
    step = entry.sample_time if isinstance(entry, VirtualSensor) else None
    dead = step is not None and entry.decay * step > DEAD
    rate = 'dead beat' if dead else number(entry.decay, '1/s')
    return f'{rate} (an error is down to 5 % in {number(settled, "s")})'


def eigenvalues(entry: VirtualSensor, shown: int = SHOWN) -> str:
    """Return the eigenvalues of N, the slowest first, pairs as one, of many the first few."""
    slow = (np.real if entry.sample_time is None else np.abs)(entry.eigenvalues)
    upper = [complex(entry.eigenvalues[i]) for i in np.argsort(-slow, kind='stable')]
    texts = []
    for value in upper:
        if abs(value) < NEARLY:
            texts.append('0')
        elif np.isclose(value.imag, 0.0):
            texts.append(f'{value.real:.4g}')
        elif value.imag > 0:
            texts.append(f'{value.real:.4g} +- {value.imag:.4g}i')
    if len(texts) > shown:
        texts[shown - 1:] = [f'.. {len(texts) - shown} more ..', texts[-1]]
    return ', '.join(texts) or 'none'


def reads(entry: Entry) -> str:
    """Name the sensors and commands it needs."""
    return ', '.join([*entry.reads, *entry.commands]) or 'nothing: it is a constant'


def certificate(entry: VirtualSensor) -> list[str]:
    """Say in sentences how far its stability is proved."""
    c = entry.certificate
    if entry.grade == 'temporary':
        return ['nothing is certified: it starts from the last good readings of '
                f'{", ".join(entry.tracking.channels) if entry.tracking else "its channel"}']
    if c is None:
        terms = ', '.join(short_name(i, entry.terms[i].name) for i in entry.active)
        if not terms:
            return ['stable everywhere: its error is linear, and the eigenvalues decide']
        return [f'not certified: judged by the linear part alone, without {terms}']
    if not entry.order:
        said = ['certified everywhere: it is made of readings alone' + _bound(c)]
    elif c.status == 'none':
        said = [f'NOT CERTIFIED: {c.reason}']
    else:
        region = ', '.join(map(_between, entry.region))
        where = 'everywhere' if c.status == 'global' else f'only while {region}'
        said = [f'certified {where}: {c.reason}',
                f'proved decay rate {number(c.rate, "1/s")}' + _bound(c)]
    if c.lipschitz is not None and entry.order:
        left, right = c.lipschitz
        said.append(f"the papers' Lipschitz condition {'holds' if left < right else 'fails'}: "
                    f'{number(left)} {"<" if left < right else "is not below"} {number(right)}')
    return said


def _between(place: tuple[str, float, float]) -> str:
    of, low, high = place
    if np.isfinite(low):
        of = f'{number(low)} <= {of}'
    return f'{of} <= {number(high)}' if np.isfinite(high) else of


def _bound(c: Certificate) -> str:
    if not np.isfinite(c.bound):
        return '; no bound is proved on what wrong readings do'
    return f'; readings wrong by 1 put it out by at most {number(c.bound)}'


def certified(entry: Entry) -> str:
    """Return the certificate in a word, for a table."""
    if entry.grade == 'temporary':
        return 'for a time only'
    if entry.certificate is None:
        linear = isinstance(entry, VirtualSensor) and not entry.active
        return 'linear: everywhere' if linear else 'not certified'
    return {'global': 'everywhere', 'region': 'in a region'}.get(
        entry.certificate.status, 'NOT certified')


def facts(entry: Entry, unit: str) -> list[tuple[str, str]]:
    """Say what there is to say of a virtual sensor of any kind: names and texts."""
    return [('kind', entry.kind), ('order', order(entry)), ('noise error', noise(entry, unit)),
            ('decay', decay(entry)), ('reads', reads(entry)), ('stability', certified(entry)),
            ('grade', entry.grade), ('found as', entry.method)]


def disturbance(entry: VirtualSensor, unit: str) -> str:
    """Say what unknown inputs do to the estimate."""
    if entry.grade in ('exact', 'temporary'):
        return 'do not reach it'
    near = ' (near the operating point)' if entry.active else ''
    return (f'reach it: one of size 1, at the worst frequency, puts it out by at most '
            f'{number(entry.disturbance_gain, unit)}{near}')


def rungs(entry: VirtualSensor) -> list[tuple[Rung, bool]]:
    """Return the ladder, each rung with whether it is the one taken."""
    return [(rung, rung.order == entry.order) for rung in entry.ladder]


def doubts(entry: Entry | Refusal) -> tuple[str, ...]:
    """Return the decisions that were ambiguous."""
    if isinstance(entry, Refusal):
        return entry.doubts
    return entry.proof.doubts if entry.proof is not None else ()


def gained(location: Location) -> str:
    """Say what one more sensor would be good for; what follows from fewer faults is left out."""
    if not location.gained:
        return 'would let you lose nothing more'
    by: dict[tuple[str, ...], list[str]] = {}
    for fault_set, channel in location.gained:
        if not any(of == channel and set(fewer) < set(fault_set)
                   for fewer, of in location.gained):
            by.setdefault(fault_set, []).append(channel)
    whole = [s for s, channels in by.items() if len(channels) == len(s)]
    parts = [f'{", ".join(by[s])} when {joined(s)} failed' for s in by if s not in whole]
    more = f' and {len(parts) - LISTED} more' if len(parts) > LISTED else ''
    said = [f'lose {_list(whole)}'] if whole else []
    if parts:
        said.append(f'replace {", ".join(parts[:LISTED])}{more}')
    shown = sum(map(len, by.values()))
    rest = len(location.gained) - shown
    return f'would let you {" and ".join(said)}' + (
        f' ({rest} more in larger sets)' if rest else '')
