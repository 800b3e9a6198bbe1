"""
Every sentence with which the search for virtual sensors explains itself, by its code.

The search decides by codes and facts (``Reason``) and never reads a sentence. A fact is a name of
the user, a tuple of such names, a number or a flag.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from decimal import Context, ROUND_CEILING
import math

from vsensor_ros.reason import add_sentences, Reason

Names = Sequence[str]


def say(reason: Reason) -> str:
    """Return the sentence of a reason of the designer."""
    return str(reason)


def listed(names: Names) -> str:
    """Return 'a, b and c'."""
    return names[0] if len(names) == 1 else f'{", ".join(names[:-1])} and {names[-1]}'


# --------------------------------------------- why there is no decoupled virtual sensor at all

def _reads_unknown_input(names: Names) -> str:
    return (f'it reads the unknown input{"s" * (len(names) > 1)} {listed(names)} directly, and '
            'no healthy sensor does')


def _unknown_inputs(names: Names, way: Names, healthy: Names) -> str:
    several = len(names) > 1
    acts = (f'the unknown input{"s" * several} {listed(names)} ' + (
        f'{"reach" if several else "reaches"} it through {listed(way)}' if way
        else f'act{"s" * (not several)} on it'))
    if not healthy:
        return f'{acts} and no sensor is left to tell them apart'
    if way:
        return (f'{acts}, and {listed(healthy)} cannot tell {listed(way)} from '
                f'{"them" if several else "it"}')
    return f'{acts} and cannot be told apart from it by {listed(healthy)}'


def _terms(names: Names, healthy: Names) -> str:
    acts = f'the nonlinear term{"s" * (len(names) > 1)} {listed(names)} ' + (
        'acts' if len(names) == 1 else 'act')
    return (f'{acts} on it with an argument that {listed(healthy)} cannot tell' if healthy
            else f'{acts} on it and no sensor is left')


def _mode_stays(size: float, discrete: bool, states: Names, healthy: Names, terms: bool) -> str:
    kind = 'modulus' if discrete else 'real part'
    counted = '; nonlinear terms count with their slope at the operating point' if terms else ''
    who = f'{listed(healthy)} cannot see' if healthy else 'no sensor is left for'
    return (f'{who} the mode of {kind} {size:.3g} in {listed(states)}, which does not '
            f'surely die out by itself: an initial error would stay{counted}')


def _already_without(fault_set: Names, reason: str) -> str:
    have = 'have' if len(fault_set) > 1 else 'has'
    return (f'already when {" and ".join(fault_set) or "no sensor"} alone {have} failed: '
            f'{reason}')


# ------------------------------------------------------------ why one was sought and not found

def _none_stable(order: int, terms: Names, signs: bool) -> str:
    why = (f'is stable together with {", ".join(terms)}' if terms else
           'passes the check of its equations: the plant is ill-conditioned')
    if signs:
        why += ' (a sign that drives its own argument away from zero leaves two branches apart)'
    return (f'the linear equations allow a virtual sensor of order up to {order}, but none '
            f'was found that {why}')


def _none_in_canonical_form(order: int, form: str, terms: Names) -> str:
    return (f'a virtual sensor of order up to {order} exists, but none in {form} '
            'canonical form was found'
            + (f' that is stable together with {", ".join(terms)}' if terms else ''))


# ----------------------------------------------------------------------- what is in doubt

def _ambiguous_ranks(what: str, zero: float, nonzero: float, limit: float, settled: bool) -> str:
    return (f'{what}: relative singular values of {zero:.1e} were taken for zero and of '
            f'{nonzero:.1e} not, the limit is {limit:g}'
            + ('; exact arithmetic on the decimals as given decided' if settled else ''))


def _slower_than_wanted(wanted: float, found: float) -> str:
    return (f'a decay rate of {wanted:g} 1/s was wanted: {found:.3g} 1/s '
            'is the fastest that was found at this order')


# ------------------------------------------ what unknown inputs do that are not decoupled

def _shown(gain: float, unit: str) -> str:
    return f'{gain:.3g}' + (f' {unit}' if unit else '')


def _decoupled(free: Names, kept: Sequence[tuple[str, float, float, float]], unit: str) -> str:
    # kept: (name, largest gain, at the frequency [rad/s], gain when constant)
    parts = [f'{name} (at most {_shown(gain, unit)} per unit, at {at:.3g} rad/s; '
             f'{_shown(constant, unit)} when constant)' for name, gain, at, constant in kept]
    return (f'decoupled from {", ".join(free)}, ' if free else '') + (
        f'not decoupled from {", ".join(parts)}')


def _rows_decoupled(rows: Sequence[int]) -> str:
    # numbered from 1
    return (f'row{"s" * (len(rows) > 1)} {", ".join(map(str, rows))} decoupled from all; '
            'the others')


def _alternative(order: int, gain: float, names: Names, unit: str, terms: bool) -> str:
    above = float(Context(prec=2, rounding=ROUND_CEILING).create_decimal(gain))
    return (f'not decoupled, but bounded: order {order} or less with '
            f'at most {above:.2g}' + (f' {unit}' if unit else '') + ' per unit of '
            f'{" and ".join(names)}{" together" * (len(names) > 1)}'
            + ' near the operating point' * terms + ' (bounded=True, or --bounded)')


# ------------------------------------------------ whose fault it is, and what nobody can tell

def _disturbs(sensor: str, other: str, names: Names, terms: bool) -> str:
    checks = f'everything that checks {sensor}' + (f' without {other}' if other else '')
    if terms:
        return f'{checks} depends on {listed(names)}, of which nobody tells the argument'
    return f'{checks} is disturbed by {listed(names)}'


def _not_seen(sensor: str, other: str, names: Names, terms: bool) -> str:
    return f'{sensor}: no fault of it is seen: {_disturbs(sensor, other, names, terms)}'


def _alike(sensor: str, other: str, names: Names, terms: bool) -> str:
    return (f'{sensor} and {other} cannot be told apart: '
            f'{_disturbs(sensor, other, names, terms)}')


def _taken_for(sensor: str, other: str, names: Names, terms: bool) -> str:
    return (f'a fault of {sensor} may be taken for one of {other}: '
            f'{_disturbs(sensor, other, names, terms)}')


def _bias_taken_for(sensor: str, others: Names) -> str:
    return (f'{sensor}: jumps, freezes and noise are told from faults of {listed(others)}; a '
            'constant bias is not')


def _not_built(sensor: str, others: Names, strength: str) -> str:
    what = 'a constant bias' if strength == 'weak' else 'a fault'
    task = f'told from faults of {listed(others)}' if others else 'seen'
    return f'{what} of {sensor} could be {task}, but no filter for it passed its checks'

SENTENCES: dict[str, Callable[..., str]] = {
    'reads unknown input': _reads_unknown_input,
    'unknown inputs': _unknown_inputs,
    'terms': _terms,
    'mode stays': _mode_stays,
    'already without': _already_without,
    'none stable': _none_stable,
    'none in canonical form': _none_in_canonical_form,
    'none by singular values': lambda: (
        'no design of the method of singular values gives it and is stable'),

    # of one order: why there is none, or why that is open
    'found': lambda method: f'found: {method}',
    'found of no use': lambda method, error, size: (
        f'found: {method}, but of no use: its noise error is {error:.2g} where what is wanted is '
        f'of size {size:.2g}'),
    'no digits': lambda: (
        'exact arithmetic says that any spectrum can be had, but no design was found whose '
        'equations hold in double precision: its gains would be of no use'),
    'too few states': lambda least: (
        f'what it must know besides the readings takes at least {least} states'),
    'no combination of readings': lambda: 'no combination of the healthy readings equals it',
    'no polynomial': lambda: (
        'no characteristic polynomial of this degree satisfies the equations'),
    'polynomial too large': lambda: 'too large a polynomial to search for a stable one',
    'impossible above': lambda order: f'order {order} is impossible',
    'none found': lambda: 'none was found',
    'none passes': lambda: 'none found that passes all checks',

    # of a family of polynomials: why it has no stable member, or why that is open
    'one polynomial': lambda root: f'the only polynomial has the root {root:.4g}',
    'one free coefficient': lambda: (
        'one coefficient is free, and between all values at which a root '
        'crosses the limit of stability an unstable one is left'),
    'shared roots': lambda root: f'all polynomials share the roots {root:.4g}',
    'not positive': lambda: (
        'no choice of the free coefficients keeps the polynomial positive where '
        'that of a stable one is'),
    'any spectrum': lambda: 'any spectrum can be had, but no design passed all checks',
    'not found among': lambda free: (
        f'no stable one was found among those with {free} free coefficients'),

    'ambiguous ranks': _ambiguous_ranks,
    'exact: there is none': lambda: (
        'exact arithmetic on the decimals as given decided that there is none: in '
        'double precision one seems to exist'),
    'exact: one exists': lambda: (
        'exact arithmetic on the decimals as given says that a decoupled one exists: '
        'in double precision it cannot be told from none'),
    'slower than wanted': _slower_than_wanted,
    'unsure at rest': lambda terms: f'at rest unsure of {", ".join(terms)}',

    'decoupled': _decoupled,
    'rows decoupled': _rows_decoupled,
    'disturbed rung': lambda method, gain: f'{method}, unknown inputs times {gain:.3g}',
    'alternative': _alternative,

    'filter, none': lambda reason: f'other virtual sensors there are none: {reason}',
    'filter, for a time': lambda order, by: (
        f'the other one, of order {order}, serves for a time only; {by} hands it out'),
    'filter, proved in part': lambda order, where, by: (
        f'of the other one, of order {order}, nothing is proved '
        f'{where or "beyond a region about the operating point: give states a range"}; '
        f'{by} hands it out'),
    'filter, unproved': lambda order, reason, by: (
        f'of the other one, of order {order}, nothing is proved'
        f'{f" ({reason})" if reason else ""}; {by} hands it out'),
    'proved, quiet': lambda ratio: (
        f'none was sought: gains that follow the readings could be no more than {ratio:.3g} times '
        'quieter at the operating point, and of a Kalman filter on the equations nothing would '
        'be proved'),
    'proved, no noisier': lambda ours, theirs: (
        'gains that follow the readings are proved over the declared ranges, too, but not clearly '
        f'quieter: in simulation they are off by {theirs:.3g} (rms), this one by {ours:.3g}'),
    'proved, decoupled': lambda: (
        'gains that follow the readings are proved over the declared ranges, too, but unknown '
        'inputs reach those otherwise'),
    'proved, not simulated': lambda order: (
        'gains that follow the readings are proved over the declared ranges, too, of order '
        f'{order}; nobody knows which is quieter: simulation did not stay in the ranges'),
    'scheduled, quieter': lambda order, ours, theirs: (
        f'constant gains of order {order} are proved, too, but noisier: in simulation they are '
        f'off by {theirs:.3g} (rms), this one by {ours:.3g}; --no-scheduled hands them out'),
    'scheduled, not filtered': lambda: (
        'a Kalman filter on the equations would go beyond the ranges, but nothing would be proved '
        'of it: --no-scheduled hands it out'),
    'scheduled, not for it': lambda: (
        'gains that follow the readings are not for it: they ask for equations in continuous time '
        'with few products, noise, and ranges of what is in these'),

    'not seen': _not_seen,
    'bias not seen': lambda sensor: (
        f'{sensor}: jumps, freezes and noise are seen; a constant bias is not'),
    'one residual': lambda sensor, other: (
        f'{sensor} and {other} cannot be told apart: one residual checks both'),
    'alike': _alike,
    'taken for': _taken_for,
    'bias taken for': _bias_taken_for,
    'not built': _not_built,

    'functions not asked': lambda why: (
        f'nonlinear functions of the states were not sought: {why}'),
    'linear, for a time': lambda order: (
        f'the linear one, of order {order}, serves for a time only'),
    'linear, unproved': lambda order, ours, theirs: (
        f'of the linear one, of order {order}, nothing is proved all over the declared ranges'
        + ('' if math.isnan(theirs) else '; at the operating point its standard deviation is '
           f'{theirs:.3g}, that of this one {ours:.3g}')),
    'function, noisier': lambda phi, ours, theirs: (
        'nothing is proved of it all over the declared ranges; a function of the states would '
        f'be, {", ".join(phi)}, but is {ours / theirs:.3g} times as noisy: at the operating point '
        f'its standard deviation is {ours:.3g}, that of this one {theirs:.3g}; --method functions '
        'hands it out'),
    'no function': lambda why: why,
    'function not tracked': lambda: 'a nonlinear function of the states would serve for a time, '
    'but nothing tells where it starts',
    'not scheduled': lambda why: f'gains that follow the readings do no better: {why}',
    'scheduled not sought': lambda missing: (
        f'gains that follow the readings were not sought: {missing}'),
    'states without ranges': lambda channel: (
        f'what {channel} depends on has no range: declare where the states and inputs live'),
    'as wide as the range': lambda half_width, range: (
        f'they would be within {half_width:.3g}, and the channel lies in a range of {range:.3g}'),
    'size, only its onset': lambda: (
        'a constant fault of it fades from all that the sensors say: only its onset shows'),
    'size, not seen': lambda names: 'nothing that the sensors say feels a fault of it' + (
        f', {listed(names)} set aside' if names else ''),
    'size, a command': lambda: 'no sensor says what a command does',
    'size, not designed': lambda: 'its loss alone was not asked for',
    'size, not exact': lambda grade: f'the virtual sensor of it is {grade}',
    'sliding, sampled': lambda: 'a sliding mode is of continuous time',
    'sliding, reads it': lambda channel: (
        f'every residual feels {channel} directly: no motion can be held at zero'),
    'sliding, nothing checks': lambda names: (
        'nothing is checked' + (f' that {listed(names)} does not disturb' if len(names) == 1 else
                                f' that {listed(names)} do not disturb' if names else '')),
    'sliding, not in the derivative': lambda channel: (
        f'the fault of {channel} is not in the derivative of any residual'),
    'sliding, zero stays': lambda rate: (
        f'held at zero, the residuals hide a motion that does not die out (zero at {rate:.3g} '
        '1/s)'),
    'size, too slow': lambda: 'no gain follows a step as fast',
    'size, no filter': lambda: 'no filter passed its checks',

    'premise not read': lambda names: (
        f'no healthy sensor reads {listed(names)}, of which the submodels depend'),
    'not of the states': lambda channel: (
        f'the healthy sensors cannot tell {channel} with any functional of all submodels'),
    'unknown inputs without bounds': lambda names: (
        f'{listed(names)} cannot be kept out, and no range says how large it may be'
        if len(names) == 1 else
        f'{listed(names)} cannot be kept out, and no range says how large they may be'),
    'not seen in the range': lambda at, rate, point: (
        f'at {at} the healthy sensors do not see a mode that dies out no faster than '
        f'{rate:.3g} 1/s; a range without that point may do'),
    'no form over the range': lambda at, rate, point: (
        f'no Lyapunov form was found in which an error dies out at {rate:.3g} 1/s over the whole '
        f'range; what the healthy sensors see least of is at {at}'),
}

add_sentences(SENTENCES)
