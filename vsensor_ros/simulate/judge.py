"""The verdict on a run: what came out of the replaced topic against the truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vsensor_ros.simulate.scenario import Scenario

LONGEST_GAP = 0.1   # of the time from isolation to the end, without a replacement

@dataclass(frozen=True, eq=False)
class Heard:
    """
    The messages on the output topic, in order of arrival, each array of shape (M,).

    `time` is the stamp in seconds of the run's time, `arrival` the wall clock's seconds since the
    isolation message was sent.
    """

    time: NDArray[np.float64]
    value: NDArray[np.float64]
    arrival: NDArray[np.float64]


@dataclass(frozen=True)
class Verdict:
    """RMSEs in the sensor's unit; None where nothing was replaced."""

    latency_ms: float | None
    rmse: float | None
    rmse_hold: float | None
    passed: bool


def replaced(scenario: Scenario, heard: Heard) -> NDArray[np.bool_]:
    """
    Tell which messages are replacements: not what the failed sensor said at that stamp.

    What comes when the run is over, and the healthy sensors are silent too, does not count.
    """
    said = scenario.channels[scenario.failed_sensor]
    at = np.clip(np.searchsorted(said.time, heard.time - 1e-7), 0, len(said.time) - 1)
    forwarded = (np.abs(said.time[at] - heard.time) < 1e-7) & said.sent[at] & np.isclose(
        said.value[at], heard.value, rtol=1e-6, atol=0.0, equal_nan=True)   # float32 on the wire
    return (heard.arrival > 0.0) & (heard.time <= scenario.end) & ~forwarded


def judge(scenario: Scenario, heard: Heard) -> Verdict:
    """
    Compare every replacement with the truth at its stamp (interpolated).

    Hold-last-value is the last reading before the fault, judged at the same stamps. A replacement
    of NaN makes the RMSE NaN, which does not pass; nor does one that falls silent on the way.
    """
    new = replaced(scenario, heard)
    if not new.any():
        return Verdict(None, None, None, False)
    truth = np.interp(heard.time[new], scenario.truth.time, scenario.truth.value)
    rmse = float(np.sqrt(np.mean((heard.value[new] - truth) ** 2)))
    hold = float(np.sqrt(np.mean((scenario.trusted - truth) ** 2)))
    gaps = np.diff([scenario.isolated_at, *heard.time[new], scenario.end])
    steady = gaps.max() <= LONGEST_GAP * (scenario.end - scenario.isolated_at)
    return Verdict(1e3 * float(heard.arrival[new][0]), rmse, hold,
                   bool(steady and rmse <= scenario.bar))
