"""A picture of one failover."""

from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray

from vsensor_ros.simulate.judge import Heard, replaced, Verdict
from vsensor_ros.simulate.scenario import Scenario

matplotlib.use('Agg')
from matplotlib import pyplot as plt

SHADES = {'freeze': '#fde0c5', 'drop_out': '#f6c1bb'}
WORDS = {'freeze': 'frozen', 'drop_out': 'silent', 'not_a_number': 'NaN'}
TRUTH, RAW, NEW, HOLD = '#9a9a9a', '#c0392b', '#1f5fbf', '#e08a1e'


def draw(scenario: Scenario, heard: Heard, deviation: NDArray[np.float64], verdict: Verdict,
         path: Path) -> None:
    """
    Write a PNG: above what was said and what was true, below the errors against the bar.

    `deviation`, rows of time and standard deviation, is what the replacer said of its error.
    """
    name, unit = scenario.failed_sensor, scenario.unit
    raw = scenario.channels[name]
    new = replaced(scenario, heard)
    truth = np.interp(heard.time[new], scenario.truth.time, scenario.truth.value)
    start = scenario.failed_at - 0.5 * (scenario.end - scenario.failed_at)
    view = (max(scenario.start, start), scenario.end)
    true_time, true_value = scenario.truth.time, scenario.truth.value
    shown, after = true_time >= view[0], true_time >= scenario.failed_at

    figure, (above, below) = plt.subplots(
        2, 1, figsize=(11, 7.5), sharex=True, height_ratios=(3, 2), layout='constrained')
    ends = [*(t for t, _ in scenario.marks[1:]), scenario.end]
    for axes in (above, below):
        for (begin, kind), end in zip(scenario.marks, ends):
            axes.axvspan(begin, end, color=SHADES.get(kind, '#eeeeee'), lw=0)
        axes.axvline(scenario.isolated_at, color='black', lw=1, ls=':')
        axes.grid(alpha=0.25)
        axes.spines[['top', 'right']].set_visible(False)

    above.plot(true_time[shown], true_value[shown], color=TRUTH, lw=6, label='truth',
               solid_capstyle='round')
    above.plot(true_time[after], np.full(after.sum(), scenario.trusted), color=HOLD, lw=1.5,
               ls='--', label='last value held')
    seen = raw.time >= view[0]
    above.plot(raw.time[seen], np.where(raw.sent, raw.value, np.nan)[seen], color=RAW, lw=2,
               label=f'{name} as its sensor says it')
    above.plot(heard.time[new], heard.value[new], color=NEW, lw=2, label=f'{name} replaced')
    above.margins(y=0.15)
    for (begin, kind), end in zip(scenario.marks, ends):
        above.text((begin + end) / 2, 0.98, f'sensor {WORDS.get(kind, kind)}', ha='center',
                   va='top', color=RAW, fontsize=11, transform=above.get_xaxis_transform())
    above.text(scenario.isolated_at, 0.02,
               ' nobody isolates it' if scenario.alone else ' isolated here',
               transform=above.get_xaxis_transform())
    above.set_ylabel(f'{name} [{unit}]')
    above.set_xlim(*view)
    above.legend(loc='lower left', bbox_to_anchor=(-0.01, 1.0), ncols=4, frameon=False)

    held = _running_rms(scenario.trusted - true_value[after])
    below.semilogy(true_time[after], held, color=HOLD, lw=1.5, ls='--')
    below.semilogy(heard.time[new], _running_rms(heard.value[new] - truth), color=NEW, lw=2)
    if len(deviation):
        below.plot(*deviation.T, color=NEW, lw=1, ls='--')
        below.text(*deviation[-1], 'standard deviation given with it ', color=NEW, ha='right',
                   va='top' if deviation[-1, 1] < scenario.bar else 'bottom')
    below.axhline(scenario.bar, color='black', lw=1)
    below.text(view[0], scenario.bar, f' RMSE allowed: {scenario.bar:.2g} {unit}', va='bottom')
    below.set_ylabel(f'error, running RMS [{unit}]')
    below.set_xlabel('time [s]')
    below.set_ylim(scenario.bar * 1e-3, 3 * max(held.max(), scenario.bar))

    if verdict.rmse is None:
        outcome = 'nothing was replaced'
    else:
        outcome = (f'RMSE {verdict.rmse:.2g} {unit}, not {verdict.rmse_hold:.2g} {unit} as with '
                   f'the last value held; first replacement {verdict.latency_ms:.1f} ms after '
                   f'{"the fault" if scenario.alone else "isolation"}')
    figure.suptitle(f'{scenario.title}\n{"" if verdict.passed else "FAILED: "}{outcome}',
                    x=0.01, ha='left', fontsize=12)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _running_rms(error: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the RMS over the 50th part of the run around each instant, shape as `error`."""
    window = np.ones(max(1, len(error) // 50))
    share = np.convolve(np.ones(len(error)), window, 'same')
    return np.sqrt(np.convolve(error ** 2, window, 'same') / share)
