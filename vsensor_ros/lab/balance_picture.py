"""A picture of the runs of a cart-pole: film strips, and what the controller was told."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import SubFigure
from matplotlib.patches import Circle, FancyBboxPatch
import numpy as np

from vsensor_ros.lab.balance_frames import render
from vsensor_ros.lab.balance_run import Watched
from vsensor_ros.plant import Plant
from vsensor_ros.simulate.balance import Balance

matplotlib.use('Agg')
from matplotlib import pyplot as plt

TRUTH, RAW, NEW, FALL = '#9a9a9a', '#c0392b', '#1f5fbf', '#e08a1e'
FAULT = '#fde0c5'
POLE = 0.6                          # m
CLOSE, WIDE = 1.35, 3.0             # m that a frame shows: with the cart in its middle; the rail
HEIGHT = 0.95                       # m, of both
PIXELS = 260                        # of that height
BEFORE, AFTER = 1.0, 4.0            # s around the fault, where it is shown in detail


def draw_balance(story: Balance, plant: Plant, pairs: Sequence[tuple[Watched, Watched, str]],
                 path: Path) -> None:
    """Write a PNG of a sensor that fails: when nobody replaces it, and when it is (words: how)."""
    figure = plt.figure(figsize=(13, 6.3 * len(pairs) + 0.5), layout='constrained')
    figure.get_layout_engine().set(rect=(0.0, 0.0, 1.0, 1.0 - 0.5 / figure.get_figheight()))
    figure.suptitle(f'{story.title}: a sensor freezes at {story.failed_at:g} s (red), is isolated '
                    f'{1e3 * (story.isolated_at - story.failed_at):.0f} ms later', x=0.01, y=0.995,
                    ha='left', fontsize=14, weight='bold')
    parts = figure.subfigures(len(pairs), 1, squeeze=False, hspace=0.03)[:, 0]
    for part, (alone, replaced, how) in zip(parts, pairs):
        _draw_pair(part, story, plant, alone, replaced, how)
    figure.savefig(path, dpi=100)
    plt.close(figure)


def fate(story: Balance, plant: Plant, run: Watched) -> str:
    """Say what became of it."""
    if run.fell_at is None:
        return f'it stands the {story.end - story.failed_at:g} s to the end'
    place = run.truth[story.step(run.fell_at), plant.sensors.index(story.travels)]
    what = 'hits the end of its rail' if abs(place) > story.fallen.get(story.travels, np.inf) \
        else 'falls'
    return f'it {what} {run.fell_at - story.failed_at:.1f} s later'


def _draw_pair(part: SubFigure, story: Balance, plant: Plant, alone: Watched, replaced: Watched,
               how: str) -> None:
    failed = alone.failed_sensor
    upper, middle, lower = part.subfigures(3, 1, height_ratios=(1.0, 1.0, 1.7), hspace=0.0)
    _strip(upper, story, plant, alone,
           f'{failed} frozen, and nobody replaces it: {fate(story, plant, alone)}')
    _strip(middle, story, plant, replaced,
           f'{failed} frozen, and {how}: {fate(story, plant, replaced)}')
    near, error = lower.subplots(1, 2, width_ratios=(1.0, 1.35))
    unit = plant.units.get(failed, '')
    column = plant.sensors.index(failed)

    end = max(story.failed_at + AFTER, (alone.fell_at or 0.0) + 0.5)
    for run, color, label in ((alone, FALL, 'truth, when nobody replaces it'),
                              (replaced, TRUTH, 'truth, when it is replaced')):
        near.plot(run.time, run.truth[:, column], color=color, lw=6 if run is replaced else 2,
                  label=label, solid_capstyle='round')
    late = replaced.time >= story.failed_at
    near.plot(replaced.time[late], replaced.said[late, column], color=RAW, lw=2,
              label=f'{failed} as its sensor says it')
    new = replaced.time >= story.isolated_at - 0.5 * story.period
    near.plot(replaced.time[new], replaced.told[new], color=NEW, lw=1.6,
              label=f'{failed} replaced')
    near.set_xlim(story.failed_at - BEFORE, end)
    seen = replaced.truth[:, column]
    room = 0.6 * np.ptp(seen)
    near.set_ylim(min(seen.min(), 0.0) - room, seen.max() + room)
    near.set_ylabel(f'{failed} [{unit}]')
    near.legend(loc='upper left', ncols=2, frameon=False, fontsize=8.5)

    wrong = replaced.told - seen
    band = 2.0 * replaced.deviation
    error.fill_between(replaced.time[new], -band[new], band[new], color=NEW, alpha=0.15, lw=0,
                       label='two standard deviations given with it')
    error.plot(replaced.time[new], wrong[new], color=NEW, lw=0.8,
               label='error of the replacement')
    size = 1.6 * max(np.nanmax(np.abs(wrong[new]), initial=0.0),
                     np.nanmax(band[new][np.isfinite(band[new])], initial=0.0)) or 1.0
    error.set_ylim(-size, size)
    error.set_xlim(story.failed_at - BEFORE, story.end)
    error.set_ylabel(f'error [{unit}]')
    error.legend(loc='upper left', ncols=2, frameon=False, fontsize=8.5)
    for axes in (near, error):
        axes.axvspan(story.failed_at, story.end, color=FAULT, alpha=0.5, lw=0, zorder=-3)
        axes.axvline(story.isolated_at, color='black', lw=1, ls=':')
        axes.text(story.isolated_at, 0.02, ' isolated', fontsize=8.5,
                  transform=axes.get_xaxis_transform())
        axes.set_xlabel('time [s]')
        axes.grid(alpha=0.25)
        axes.spines[['top', 'right']].set_visible(False)


def _strip(part: SubFigure, story: Balance, plant: Plant, run: Watched, title: str) -> None:
    """Draw a film strip: frames at times that tell the story."""
    wide = run.failed_sensor == story.travels
    travels, leans = plant.sensors.index(story.travels), plant.sensors.index(story.leans)
    rows = _moments(story, run, 4 if wide else 8, travels if wide else None)
    poses = run.truth[np.ix_(rows, [travels, leans])]
    span = WIDE if wide else CLOSE
    centres = np.zeros(len(rows)) if wide else poses[:, 0]
    shape = (PIXELS, round(PIXELS * span / HEIGHT))
    frames = render(story.model, poses.tolist(), centres.tolist(), span, shape)
    part.suptitle(title, x=0.01, ha='left', fontsize=12,
                  color=FALL if run.fell_at is not None else NEW)
    axes = part.subplots(1, len(rows), squeeze=False)[0]
    for i, (place, row) in enumerate(zip(axes, rows)):
        if frames is not None:
            place.imshow(frames[i], aspect='equal')
        else:
            draw_pose(place, poses[i, 0], poses[i, 1], centres[i], span)
        place.set(xticks=[], yticks=[])
        faulty = run.time[row] >= story.failed_at
        place.spines[:].set(color=RAW if faulty else TRUTH, lw=1.5)
        place.set_xlabel(f'{run.time[row]:.1f} s', fontsize=9, color=RAW if faulty else 'black')


def _moments(story: Balance, run: Watched, count: int, column: int | None) -> list[int]:
    """
    Return the rows of a strip: one before the fault, the last at the fall or at the end.

    column: of what is to be seen where it is farthest off, if anything.
    """
    first = story.step(story.failed_at)
    if run.fell_at is None:
        last, share = len(run.time) - 1, np.linspace(0.0, 1.0, count - 1) ** 1.6
    else:
        last = min(len(run.time) - 1, story.step(run.fell_at + 0.35))
        share = np.linspace(0.0, 1.0, count - 1)
    rows = first + np.round(share * (last - first)).astype(int)
    if run.fell_at is None and column is not None:
        quarter = story.step(story.to_and_fro / 4.0)
        for i, row in enumerate(rows[1:], 1):
            begin = max(0, row - quarter)
            near = np.abs(run.truth[begin:row + quarter, column])
            rows[i] = begin + int(np.argmax(near))
    return [max(0, first - story.step(0.5)), *(int(row) for row in rows)]


def draw_pose(axes: Axes, position: float, angle: float, centre: float, span: float) -> None:
    """Draw a cart and its pole by hand, where nothing renders them."""
    axes.set_xlim(centre - span / 2, centre + span / 2)
    axes.set_ylim(-0.26, HEIGHT - 0.26)
    axes.set_aspect('equal')
    axes.set_facecolor('#f2f5f9')
    axes.axhline(0.0, color='#8c949e', lw=3, zorder=1)
    for end in (-1.4, 1.4):
        axes.plot([end, end], [-0.26, 0.03], color='#8c949e', lw=4, zorder=1)
    axes.add_patch(FancyBboxPatch((position - 0.13, -0.055), 0.26, 0.11, facecolor='#293852',
                                  boxstyle='round,pad=0,rounding_size=0.02', lw=0, zorder=2))
    tip = position + POLE * np.sin(angle), POLE * np.cos(angle)
    axes.plot([position, tip[0]], [0.0, tip[1]], color='#e8871a', lw=4, zorder=3,
              solid_capstyle='round')
    axes.add_patch(Circle((position, 0.0), 0.03, color='#8c949e', zorder=4))
    axes.add_patch(Circle(tip, 0.035, color='#e8871a', zorder=4))
