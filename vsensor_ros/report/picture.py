"""Pictures of runs for the report, as SVG."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
import io
import re
from typing import Any
import warnings

import numpy as np

from vsensor_ros.observers import VirtualSensor
from vsensor_ros.report.report_simulation import SimulatedRun, STEP_AT, WAVE_AT

TRUTH, ESTIMATE, PROVED = '#a8a8a8', '#1f5fbf', '#2a7f3a'


def need_matplotlib() -> Any:
    """Return matplotlib; raise ModuleNotFoundError."""
    import matplotlib
    import matplotlib.figure
    return matplotlib


def picture(entry: VirtualSensor, unit: str, start: SimulatedRun | None,
            pushed: SimulatedRun | None, salt: str) -> str:
    """
    Return an SVG element: above truth and estimate, below the error, one column for each run.

    Of a plant that runs away only the error is drawn: the truth would hide all else. ``salt``
    keeps the names inside it apart from those of other pictures on one page.
    """
    runs = [run for run in (start, pushed) if run is not None]
    with drawing(salt) as matplotlib:
        figure = matplotlib.figure.Figure(figsize=(4.6 * len(runs), 3.9), layout='constrained')
        grid = figure.add_gridspec(2, len(runs), height_ratios=(3, 2))
        shown = f' [{unit}]' if unit else ''
        for column, run in enumerate(runs):
            above, below = None, figure.add_subplot(grid[0 if run.runs_away else 1:, column])
            if not run.runs_away:
                above = figure.add_subplot(grid[0, column], sharex=below)
                above.tick_params(labelbottom=False)
                _draw_values(above, run, run is pushed)
                if column == 0:
                    above.set_ylabel(f'{entry.channel}{shown}')
            top = above or below
            top.set_title(_title(run, run is start), fontsize=10, loc='left')
            if run is start:
                _draw_forgetting(below, entry, run)
            else:
                _draw_error(below, run)
                _mark_inputs([axis for axis in (above, below) if axis is not None], run)
            below.set_ylabel(f'{"|error|" if run is start else "error"}{shown}')
            below.set_xlabel('time [s]')
        return as_svg(figure)


@contextmanager
def drawing(salt: str) -> Iterator[Any]:
    """Give matplotlib in the report's style: texts stay texts, and a $ in a unit stays a $."""
    matplotlib = need_matplotlib()
    with matplotlib.rc_context({
            'svg.fonttype': 'none', 'svg.hashsalt': salt, 'text.parse_math': False,
            'text.usetex': False, 'font.size': 9, 'axes.spines.top': False,
            'axes.spines.right': False, 'axes.grid': True, 'grid.alpha': 0.25}):
        yield matplotlib


def as_svg(figure: Any) -> str:
    """Return a figure as an SVG element for a page."""
    text = io.StringIO()
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # a unit in letters that the font has not
        figure.savefig(text, format='svg', metadata={'Date': None, 'Creator': None})
    svg = text.getvalue()
    svg = re.sub(r'<metadata>.*?</metadata>', '', svg[svg.index('<svg'):], flags=re.DOTALL)
    return re.sub(r'<g id="[^"]*"', '<g', svg)


def _title(run: SimulatedRun, wrong_start: bool) -> str:
    what = 'from a wrong start' if wrong_start else 'under unknown inputs'
    return what + (', plant held' if run.held else ': the error' if run.runs_away else '')


def _draw_values(axis: Any, run: SimulatedRun, pushed: bool) -> None:
    axis.plot(run.time, run.truth, color=TRUTH, lw=5, label='truth', solid_capstyle='round')
    axis.plot(run.time, run.estimate, color=ESTIMATE, lw=1.5, label='virtual sensor')
    if pushed:
        axis.plot(run.time, run.still, color='black', lw=0.8, ls='--', label='truth without them')
    _framed(axis, run)
    axis.legend(frameon=False, fontsize=8)


def _mark_inputs(axes: list[Any], run: SimulatedRun) -> None:
    for part, word in ((STEP_AT, ' step'), (WAVE_AT, ' wave')):
        for axis in axes:
            axis.axvline(run.time[-1] * part, color='black', lw=0.8, ls=':')
        axes[0].text(run.time[-1] * part, 0.98, word, va='top', fontsize=8,
                     transform=axes[0].get_xaxis_transform())


def _framed(axis: Any, run: SimulatedRun) -> None:
    """Leave room around the curves, and do not magnify rounding errors."""
    both = np.concatenate([run.truth, run.still, run.estimate[np.isfinite(run.estimate)]])
    middle, half = 0.5 * (both.max() + both.min()), 0.5 * np.ptp(both)
    half = max(1.15 * half, 1e-6 * np.abs(both).max(), 1e-9)
    axis.set_ylim(middle - half, middle + half)


def _draw_forgetting(axis: Any, entry: VirtualSensor, run: SimulatedRun) -> None:
    """Draw the error of a run that starts wrong, and the rate that is proved."""
    size = np.abs(run.error)
    if not np.nanmax(size) > 0:
        axis.plot(run.time, size, color=ESTIMATE, lw=1.5)
        return
    least = 1e-6 * np.nanmax(size)
    axis.semilogy(run.time, np.maximum(size, least), color=ESTIMATE, lw=1.5)
    axis.set_ylim(least, 3.0 * np.nanmax(size))
    c = entry.certificate
    if c is not None and c.status != 'none' and 0 < c.rate < np.inf:
        axis.semilogy(run.time, np.maximum(np.nanmax(size) * np.exp(-c.rate * run.time), least),
                      color=PROVED, lw=1, ls='--',
                      label='rate proved' if c.status == 'global' else 'rate in its region')
        axis.legend(frameon=False, fontsize=8)
    axis.yaxis.set_major_formatter(lambda value, _: f'{value:g}')  # 10^n would need a mathtext
    axis.yaxis.set_minor_formatter(lambda value, _: '')


def _draw_error(axis: Any, run: SimulatedRun) -> None:
    """Draw an error on the scale of the truth: what cannot be seen there does not matter."""
    axis.plot(run.time, run.error, color=ESTIMATE, lw=1.5)
    scale = 0.0 if run.runs_away else 0.05 * float(np.ptp(run.truth))
    reach = max(scale, 1.1 * np.nanmax(np.abs(run.error)), 1e-12)
    axis.set_ylim(-reach, reach)
