"""What a design says, in words that the terminal and the report share. Plain text, not escaped."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from math import comb

import numpy as np

from vsensor_ros.bad_input import BadInput
from vsensor_ros.designer.location import Location
from vsensor_ros.functions.expression import names, parse, to_words
from vsensor_ros.functions.nonlinearity import NonlinearTerm
from vsensor_ros.observers import (
    Certificate,
    Design,
    Entry,
    ExtendedSensor,
    FaultObserver,
    NonlinearSensor,
    Refusal,
    Rung,
    ScheduledSensor,
    settling_time,
    VirtualSensor,
)
from vsensor_ros.plant import Plant

NEARLY = 1e-9  # 1/s: a mode that grows more slowly stays
DEAD = 20.0  # times the sample time: a faster decay than by exp(-20) a step is none
FURTHEST = 300.0  # s after the loss of which is said how good a filter is then
SHOWN = 6  # eigenvalues, of many
LISTED = 12  # fault sets, of many
UNITS_OF_TIME = ((1e3, 1.0, 's'), (7200.0, 60.0, 'min'), (172800.0, 3600.0, 'h'),
                 (np.inf, 86400.0, 'days'))  # up to so many s, a unit of so many
UNBROKEN = '\xa0'  # a space at which no line ends
FILTERED = ('nothing is proved, from a wrong start it may stay wrong; its deviation is worked out '
            'on the machine, and nothing is served when healthy sensors contradict its model')
IMMERSED = ('nothing is proved, but it needs no start: the equations are linear in cosine and '
            'sine of {angle}, which is told while these move what is read; while they do not, its '
            'deviation grows, and at last nothing is served')
COUNTS = {1: 'one', 2: 'two', 3: 'three', 4: 'four', 5: 'five'}
UNPROVED = 'by a filter of which nothing is proved'
VERDICTS = ('yes', 'bounded', 'filtered', 'temporary', 'no')


def number(value: float, unit: str = '') -> str:
    """Return a figure of three digits with its unit."""
    text = f'{value:.3g}'
    if 1e3 <= abs(float(text)) < 1e6:  # 1460 reads better than 1.46e+03
        text = f'{float(text):.0f}'
    return f'{text} {unit}'.rstrip()


def joined(fault_set: Iterable[str]) -> str:
    """Return a fault set as one word: 'y1+y2'."""
    return '+'.join(fault_set) or 'nothing'


def verdict(design: Design, fault_set: tuple[str, ...]) -> str:
    """
    Say whether a set can be lost: 'yes', 'bounded', 'filtered', 'temporary' or 'no'.

    Every sensor of it must be replaceable; 'bounded': unknown inputs disturb one; 'filtered':
    nothing is proved of one; 'temporary': one serves for a time only.
    """
    entries = [e for (s, channel), e in design.entries.items() if s == fault_set]
    if any(isinstance(e, Refusal) for e in entries):
        return 'no'
    grades = {e.grade for e in entries if not isinstance(e, Refusal)}
    return next((grade for grade in reversed(VERDICTS) if grade in grades), 'yes')


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
        if by['filtered']:
            many = f'{len(by["filtered"])} ' if len(by['filtered']) > LISTED else ''
            said.append(f'{many}{UNPROVED}: {_list(by["filtered"], size == 1)}')
        if by['no'] and size == 1:
            said.append(f'not {_list(by["no"], True)}')
        elif by['no'] and len(able) + len(by['temporary']) + len(by['filtered']) > LISTED:
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
                               'temporary': ' for a time', 'filtered':
                               f' {UNPROVED}'}.get(entry.grade, '')


def left_out(entry: Entry | Refusal) -> str:
    """Say where in the declared ranges nothing is proved of it, or why nothing is anywhere."""
    c = None if isinstance(entry, Refusal) else entry.certificate
    if c is None or isinstance(entry, Refusal) or entry.grade == 'temporary':
        return ''
    if c.uncovered:
        return f', BUT NOT PROVED {c.uncovered}'
    return f', BUT NOT CERTIFIED: {c.reason}' if c.status == 'none' and entry.order else ''


def order(entry: Entry) -> str:
    """Say the order and what is proved of it."""
    proof = entry.proof
    if proof is None:
        return f'{entry.order} (nothing proved of the least)'
    how = 'modulo two primes' if proof.modulo else 'proved'
    least = (f'the least is {proof.upper}, {how}' if proof.least
             else f'the least is between {proof.lower} and {proof.upper}')
    if proof.least and entry.order == proof.upper:
        return f'{entry.order} ({"least, modulo two primes" if proof.modulo else "proved least"})'
    ladder = entry.ladder if isinstance(entry, VirtualSensor) else ()
    if ladder and proof.upper not in {rung.order for rung in ladder}:
        least += ', but of no use: its gains are beyond double precision'
    elif entry.order > proof.upper:
        worse = entry.noise is not None and any(
            rung.order == proof.upper and rung.noise < entry.noise.error for rung in ladder)
        least += ('; this one is faster, or proved where that is not' if worse
                  else '; this one is quieter or faster')
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
    if isinstance(entry, ExtendedSensor) and entry.decay < NEARLY:
        return 'none at the operating point: an error that is there at the loss stays'
    settled = settling_time(entry) if isinstance(entry, VirtualSensor) else 3.0 / entry.decay
    said = rate(entry.decay, entry, '1/s')
    return f'{said} (an error is down to 5 % in {seconds(settled)})'


def seconds(value: float) -> str:
    """Return a time of three digits, long ones in min, h or days."""
    size, unit = next(((size, unit) for limit, size, unit in UNITS_OF_TIME if value < limit),
                      UNITS_OF_TIME[0][1:])
    return number(value / size, unit)


def rate(decay: float, entry: Entry, unit: str = '') -> str:
    """Say how fast errors die out, of an entry or a rung of its ladder."""
    step = (entry.sample_time if isinstance(entry, VirtualSensor)
            else entry.model.sample_time if isinstance(entry, ExtendedSensor) else None)
    if entry.grade == 'temporary' or isinstance(entry, ExtendedSensor) and decay < NEARLY:
        return 'none'
    if np.isinf(decay):
        return 'at once'
    return 'dead beat' if step is not None and decay * step > DEAD else number(decay, unit)


def eigenvalues(entry: VirtualSensor, shown: int = SHOWN) -> str:
    """Return the eigenvalues of N, the slowest first, pairs as one, of many the first few."""
    return spectrum(entry.eigenvalues, entry.sample_time, shown)


def spectrum(values: np.ndarray, sample_time: float | None, shown: int = SHOWN) -> str:
    """Return eigenvalues, of s or of z, as those of N."""
    slow = (np.real if sample_time is None else np.abs)(values)
    upper = [complex(values[i]) for i in np.argsort(-slow, kind='stable')]
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


def certificate(entry: VirtualSensor, units: Mapping[str, str]) -> list[str]:
    """Say in sentences how far its stability is proved; units: of states and inputs."""
    c = entry.certificate
    if entry.grade == 'temporary':
        return ['nothing is certified: it starts from the last good readings of '
                f'{", ".join(entry.tracking.channels) if entry.tracking else "its channel"}']
    if c is None:
        terms = ', '.join(entry.terms[i].short for i in entry.active)
        if not terms:
            return ['stable everywhere: its error is linear, and the eigenvalues decide']
        return [f'not certified: judged by the linear part alone, without {terms}']
    if not entry.order:
        made = 'readings' if entry.reads else 'commands'
        bound = _bound(c) if entry.reads else ''
        said = [f'certified everywhere: it is made of {made} alone{bound}']
    elif c.status == 'none':
        said = [f'NOT CERTIFIED: {c.reason}']
    else:
        region = ', '.join(_between(place, units) for place in entry.region)
        where = 'everywhere' if c.status == 'global' else f'only while {region}'
        said = [f'certified {where}: {c.reason}',
                f'proved decay rate {number(c.rate, "1/s")}' + _bound(c)]
    if c.lipschitz is not None and entry.order:
        left, right = c.lipschitz
        said.append(f"the papers' Lipschitz condition {'holds' if left < right else 'fails'}: "
                    f'{number(left)} {"<" if left < right else "is not below"} {number(right)}')
    return said


def _between(place: tuple[str, float, float], units: Mapping[str, str]) -> str:
    of, low, high = place
    unit = _unit(of, units)
    if np.isfinite(high):
        least = f'{number(low)} <= ' if np.isfinite(low) else ''
        of = f'{least}{of} <= {number(high, unit)}'
    elif np.isfinite(low):
        of = f'{of} >= {number(low, unit)}'
    return of.replace(' ', UNBROKEN)


def _unit(of: str, units: Mapping[str, str]) -> str:
    """Return the unit of a quantity, or of a sum of such with the same one; '' when unknown."""
    try:
        found = {units.get(name, '') for name in names(parse(of))}
    except BadInput:  # an argument that has no name
        return ''
    return found.pop() if len(found) == 1 else ''


def _bound(c: Certificate) -> str:
    if not np.isfinite(c.bound):
        return '; no bound is proved on what wrong readings do'
    return f'; readings wrong by 1 put it out by at most {number(c.bound)}'


def certified(entry: Entry) -> str:
    """Return the certificate in a word, for a table."""
    if entry.grade == 'temporary':
        return 'for a time only'
    if isinstance(entry, (ScheduledSensor, FaultObserver)):
        return 'over the ranges'
    if isinstance(entry, NonlinearSensor):
        return 'in a region' if entry.proved else 'not certified'
    if entry.certificate is None:
        linear = isinstance(entry, VirtualSensor) and not entry.active
        return 'linear: everywhere' if linear else 'not certified'
    return {'global': 'everywhere', 'region': 'in a region'}.get(
        entry.certificate.status, 'NOT certified')


def facts(entry: Entry, unit: str, units: Mapping[str, str]) -> list[tuple[str, str]]:
    """Say what there is to say of a virtual sensor of any kind: names and texts."""
    if isinstance(entry, ExtendedSensor):
        angle = entry.model.angle
        said = [('order', f'{entry.order}, the states of the plant'
                 + (f', {angle} as two' if angle else '')),
                ('good', grows(entry, unit)), ('tried', tried(entry, unit)),
                ('decay', decay(entry)), ('reads', reads(entry)), ('found as', entry.method),
                ('stability', IMMERSED.format(angle=angle) if angle else FILTERED),
                ('why a filter', entry.why)]
        return [(name, text) for name, text in said if text]
    if isinstance(entry, NonlinearSensor):
        return _function(entry, unit, units)
    if isinstance(entry, ScheduledSensor):
        return [('order', f'{entry.order} (nothing proved of the least)'),
                ('good', f'within {number(entry.half_width, unit)}, once its start is forgotten'),
                ('decay', decay(entry)), ('reads', reads(entry)), ('found as', entry.method),
                ('stability', _one_form(entry, units)), ('why scheduled', entry.why)]
    if isinstance(entry, FaultObserver):
        within = ', '.join(f'{name} within {number(size, units.get(name, ""))}'
                           for name, size in zip(entry.outputs, entry.half_widths))
        return [('order', f'{entry.order}, with the faults'),
                ('good', f'{within}, once its start is forgotten'), ('decay', decay(entry)),
                ('reads', f'{reads(entry)}; of sensors that may be faulty nothing'),
                ('found as', entry.method), ('stability', _one_form(entry, units))]
    return [('kind', entry.kind), ('order', order(entry)), ('noise error', noise(entry, unit)),
             ('decay', decay(entry)), ('reads', reads(entry)), ('stability', certified(entry)),
             ('grade', entry.grade), ('found as', entry.method)]


def _function(entry: NonlinearSensor, unit: str,
              units: Mapping[str, str]) -> list[tuple[str, str]]:
    """Say what there is to say of a function of the states."""
    mark = "'" if entry.sample_time is None else '+'
    proved = 'in a region: while ' + ', '.join(
        _between((name, *ends), units) for name, ends in entry.region.items()) if entry.proved \
        else 'found at points of the declared ranges, not proved between them'
    if entry.grade == 'temporary':
        proved = ('nothing is certified: it starts from the last good readings of '
                  + ', '.join(entry.channels))
    return [('order', f'{entry.order} (nothing proved of the least)' if entry.z else
             '0: other readings tell it at once'),
            *(('function' if not i else '', f'{name} = {phi}')
              for i, (name, phi) in enumerate(zip(entry.z, entry.phi))),
            *((f'{name}{mark}', to_words(parse(text))) for name, text in zip(entry.z, entry.F)),
            ('says', to_words(parse(entry.out))),
            *((('where not', c.words)) for c in entry.validity),
            ('good', grows(entry, unit)), ('decay', decay(entry)), ('reads', reads(entry)),
            ('found as', entry.method), ('stability', proved),
            *([('why a function', entry.why)] if entry.why else [])]


def _one_form(entry: ScheduledSensor | FaultObserver, units: Mapping[str, str]) -> str:
    return f'one form of the error falls at all {len(entry.N)} submodels while ' + ', '.join(
        _between((name, low, high), units)
        for name, (low, high) in zip(entry.premises, entry.ranges))


def tried(entry: ExtendedSensor, unit: str) -> str:
    """Say what simulation over the declared ranges found of a filter; '' where nobody looked."""
    t = entry.tried
    if t is None:
        return ''
    if not t.served:
        return f'in {t.runs} runs over the declared ranges nothing could be served'
    return (f'{t.runs} runs over the declared ranges, parameters off by their spreads: rms '
            f'{number(t.rmse, unit)} in {t.seconds:g} s, {t.within:.0%} of it within two '
            f'deviations; withdrawn in {t.lost:.0%} of the runs')


def grows(entry: ExtendedSensor | NonlinearSensor, unit: str) -> str:
    """Say how the deviation grows after the loss."""
    last = min(float(entry.ages[-1]), FURTHEST)
    said = ', '.join(f'{number(float(np.interp(age, entry.ages, entry.drift)), unit)} after '
                     f'{age:.3g} s' for age in (0.0, 0.1 * last, last))
    return f'{said}, at the operating point; elsewhere the machine works it out'


def long_terms(design: Design, plant: Plant | None) -> list[NonlinearTerm]:
    """Return the nonlinear terms that sentences call by number."""
    known = plant.terms if plant is not None else next(
        (v.terms for v in design.virtual_sensors if isinstance(v, VirtualSensor)), ())
    return [term for term in known if term.short != term.name]


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
