"""A picture of the poles of a closed loop, with those at the corners of its uncertainty."""

from __future__ import annotations

import numpy as np

from vsensor_ros.control import Case, ClosedLoop
from vsensor_ros.report.picture import as_svg, drawing, ESTIMATE

CORNER, LIMIT = '#d0662f', '#b02a2a'
DEAD = 1e-6  # a pole of z so small has no place among rates
WIDE = 8.0  # times the rate of what is slowest: what is faster is not drawn
CROWD = 4000  # poles at corners that are drawn


def poles_picture(loop: ClosedLoop, case: Case, salt: str) -> str:
    """Return an SVG element: nominal poles, those at the corners, and the limit of stability."""
    h = loop.sample_time
    with drawing(salt) as matplotlib:
        figure = matplotlib.figure.Figure(figsize=(5.2, 3.4), layout='constrained')
        axis = figure.add_subplot()
        cloud = _rates(np.concatenate([np.zeros(0, complex), *case.corner_poles]), h)
        cloud = cloud[::len(cloud) // CROWD + 1]
        nominal = _rates(case.poles, h)
        slow = _slow(loop, case)
        cloud, nominal = cloud[cloud.real >= -slow], nominal[nominal.real >= -slow]
        if len(cloud):
            axis.plot(cloud.real, cloud.imag, '.', color=CORNER, ms=3, label='at the corners')
        axis.plot(nominal.real, nominal.imag, 'x', color=ESTIMATE, ms=7, mew=1.6, label='nominal')
        axis.axvline(0.0, color=LIMIT, lw=1, ls='--', label='limit of stability')
        axis.set_xlabel('real part [1/s]: to the right of the dashed line it grows')
        axis.set_ylabel('imaginary part [rad/s]')
        axis.legend(frameon=False, fontsize=8)
        return as_svg(figure)


def poles_caption(loop: ClosedLoop, case: Case) -> str:
    """Say what is drawn, and how many are not."""
    h = loop.sample_time
    drawn = int(np.sum(_rates(case.poles, h).real >= -_slow(loop, case)))
    text = 'Poles of the closed loop' if h is None else \
        'Poles z of the closed loop from sample to sample, drawn as log(z)/h'
    left = len(case.poles) - drawn
    return f'{text}; {left} that die out faster lie to the left.' if left else f'{text}.'


def _slow(loop: ClosedLoop, case: Case) -> float:
    """Return the rate [1/s] up to which poles are drawn, so that those that matter are seen."""
    moving = np.abs(_rates(case.poles, loop.sample_time).real)
    moving = moving[moving > 1e-6 * moving.max(initial=0.0)]
    worst = 0.0 if case.worst is None or not np.isfinite(case.worst.growth) else case.worst.growth
    return WIDE * max(moving.min(initial=np.inf), abs(worst))


def _rates(poles: np.ndarray, h: float | None) -> np.ndarray:
    values = np.asarray(poles, dtype=complex)
    return values if h is None else np.log(values[np.abs(values) > DEAD]) / h
