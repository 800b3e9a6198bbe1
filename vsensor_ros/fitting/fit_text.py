"""What a fit found, as text for the terminal and for the head of the plant file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vsensor_ros.fitting.fit import Fit
from vsensor_ros.fitting.friction import Tried


def fit_text(result: Fit, of: str) -> list[str]:
    """Return the lines on a fit; of: what it was fitted to."""
    model, certain = result.model, result.known
    lines = [f'fitted to {of}: {result.count} windows of {result.horizon:.4g} s',
             '',
             f'{"parameter":<14} {"value":>11} {"spread":>10} {"std error":>10}  range']
    for free, value, spread, error in zip(model.given.free, result.values, result.spreads,
                                          certain.errors):
        lines.append(f'{free.name:<14} {value:>11.5g} {_size(spread):>10} {_size(error):>10}  '
                     f'{free.low:g} to {free.high:g} {free.unit}'.rstrip())
    for i, offsets in enumerate(result.offsets):
        if offsets:
            lines.append(f'offsets of recording {i + 1}: ' + ', '.join(
                f'{name} {value:.3g}' for name, value in offsets.items()))
    held = result.held_out
    middle, last = (int(np.searchsorted(held.ages, share * held.ages[-1] - 1e-12))
                    for share in (0.5, 1.0))
    lines += ['', f'rms error of what was left out ({result.folds} parts, each predicted by what '
              'was fitted to the others)',
              f'{"sensor":<14} {"next":>9} {f"{held.ages[middle]:.3g} s":>9} '
              f'{f"{held.ages[last]:.3g} s":>9} {"held":>9} {"ARX":>9}  noise']
    for i, name in enumerate(model.sensors):
        at = [np.sqrt(np.nanmean(who[age, i]**2)) for who, age in (
            (held.plant, middle), (held.plant, last), (held.held, last), (held.arx, last))] \
            if np.isfinite(held.plant[:, i]).any() else [np.nan] * 4
        lines.append(f'{name:<14} {result.next_error[i]:>9.3g} '
                     + ' '.join(f'{value:>9.3g}' for value in at)
                     + f'  {result.noise.sensors[i]:.3g} '
                     f'{model.given.plant.units[name]}'.rstrip())
    return [*lines, '', *result.said] if result.said else lines


def tried_text(structures: Sequence[Tried], best: Tried) -> list[str]:
    """Return the table of structures."""
    sensors = structures[0].free.plant.sensors
    lines = [f'{"friction":<12} {"parameters":>10}  held-out error [rms: '
             + ', '.join(sensors) + ']']
    for one in structures:
        errors = ' '.join(f'{value:>10.3g}' for value in one.held_out.rms(one.held_out.plant))
        lines.append(f'{one.name:<12} {len(one.free.free):>10}  {errors}'
                     + ('  <- taken' if one is best else ''))
    return lines


def _size(value: float) -> str:
    return f'{value:.2g}' if np.isfinite(value) else 'unseen'
