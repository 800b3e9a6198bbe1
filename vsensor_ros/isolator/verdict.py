"""What the isolator says: who is faulty, how and since when, as data; each sentence once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from vsensor_ros.reason import add_sentences, Reason

HEALTHY, SUSPECTED, ISOLATED, MODEL = 'healthy', 'suspected', 'isolated', 'model'  # states
UNKNOWN, NOISE, STUCK, DROPPED, SPIKES = 'unknown', 'noise', 'stuck', 'drop-out', 'spikes'  # kinds


def _began(seconds: float) -> str:
    return f'began about {max(seconds, 0.0):.1f} s ago'


def _grown(sensor: str, kind: str, seconds: float, size: float, unit: str) -> str:
    return f'{sensor}: {kind}, {_began(seconds)}, now {size:+.3g} {unit}'.rstrip()


def _other(sensor: str, kind: str, seconds: float, **_: Any) -> str:
    return f'{sensor}: {kind}, {_began(seconds)}'


def _noisy(sensor: str, kind: str, seconds: float, size: float, **_: Any) -> str:
    return f'{sensor}: {kind}, {_began(seconds)}, {size:.2g} times as rough as when healthy'


def _ambiguous(candidates: tuple[tuple[str, ...], ...], known: tuple[str, ...]) -> str:
    sets = ' or '.join(' and '.join(names) for names in candidates)
    beside = f' beside {", ".join(known)}' if known else ''
    return f'{sets} is faulty{beside}; the residuals that alarm do not tell which'


add_sentences({
    'fault grown': _grown,
    'fault seen': _other,
    'fault noisy': _noisy,
    'fault ambiguous': _ambiguous,
    'fault of model': 'model or actuator: all residuals alarm at once, so no sensor is blamed '
                      '({names})',
    'fault spikes': '{sensor}: {count} spikes; they are left out, and it is not blamed for them',
    'fault learning': 'still learning what the healthy machine shows, {seconds:.0f} s to go',
    'fault too small': '{sensor}: a fault of {wanted:.3g} is not found, {least:.3g} is',
})


@dataclass(frozen=True)
class Fault:
    """One faulty sensor."""

    sensor: str
    kind: str  # bias, drift, noise, stuck, drop-out, or unknown
    onset: int  # ns, when it began: readings since then are not to be used
    found: int  # ns, since when it is known
    size: float | None  # now: reading less truth, its unit; of noise a factor; None: not known
    unit: str = ''

    def reason(self, time: int) -> Reason:
        """Say it, as of a time [ns]."""
        code = {'bias': 'fault grown', 'drift': 'fault grown', NOISE: 'fault noisy'}.get(
            self.kind, 'fault seen')
        if self.size is None:
            code = 'fault seen'
        kind = 'faulty' if self.kind == UNKNOWN else self.kind
        return Reason.of(code, sensor=self.sensor, kind=kind, seconds=(time - self.onset) * 1e-9,
                         size=self.size, unit=self.unit)


@dataclass(frozen=True)
class Verdict:
    """All that the isolator knows at a time."""

    time: int  # ns
    state: str = HEALTHY
    faults: tuple[Fault, ...] = ()  # isolated
    candidates: tuple[tuple[str, ...], ...] = ()  # one of these sets is faulty, too
    notes: tuple[Reason, ...] = ()  # what changes nothing

    @property
    def faulty(self) -> tuple[str, ...]:
        """Names of the sensors that are blamed."""
        return tuple(fault.sensor for fault in self.faults)

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """What to tell people."""
        told = [fault.reason(self.time) for fault in self.faults]
        if self.candidates:
            told.append(Reason.of('fault ambiguous', candidates=self.candidates,
                                  known=self.faulty))
        return (*told, *self.notes)
