"""What a case acts on: faults, isolation, time, and what is expected to be seen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
import math
import signal
import time
from typing import Any, TypeVar

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from std_srvs.srv import Trigger

from vsensor_ros.lab.injection.machine import Exhausted, Machine
from vsensor_ros.lab.injection.under_test import UnderTest
from vsensor_ros.lab.injection.verdict import (
    Evidence,
    judge,
    path_of,
    StatusHeard,
    switches_of,
)
from vsensor_ros.lab.process import PATIENCE, Process
from vsensor_ros.simulate.fault import FAULTS

REACTION = 0.15     # s from an isolation message on, in which the failed sensor may still be heard
STATUS_PERIOD = 1.0 # s between two messages on ~/status when nothing changes
SOON = 3.0          # s that anything may take that should happen at once; this computer is busy
CONVERGED = 60.0    # s in which a virtual sensor must have begun to serve
STARTED = 30.0      # s in which a process must have been discovered
LATE = 0.05         # s that the machine may be played late, else it was another machine
WAITED = 0.1        # of its time that the replacer may wait for a processor, for the same reason
UNTIMED = 0.06      # s by which the time of a message without a stamp may be wrong
STEP_PART = 0.02    # of the range that a switch may step by when the sensor was healthy


T = TypeVar('T')


class Skipped(Exception):
    """A case that cannot be tried here; str() is why."""


class GaveUp(Exception):
    """A case that cannot go on; what was wrong is noted."""


@dataclass
class CaseContext:
    """One replacer with the machine, in one case after the other."""

    tested: UnderTest
    machine: Machine
    services: Node              # of the same context, with an executor of its own
    process: Process | None     # None: it already ran, and is not ours
    start: Callable[..., Process]   # another one
    fresh: bool = False         # its virtual sensors are known to be converged

    apart = 0.5     # s between two faults of which the second is one more

    def __post_init__(self) -> None:
        self._executor = SingleThreadedExecutor(context=self.services.context)
        self._executor.add_node(self.services)
        self._since: dict[str, float] = {}  # by sensor: when its fault began that nobody knows of
        self._switches: dict[str, int] = {}
        self._counted = False
        self.wrong: list[str] = []
        self.seen: list[str] = []
        self.busy = ''  # why a case that failed proves nothing

    @property
    def target(self) -> str:
        """Return the sensor that fails."""
        return self.tested.target

    def span(self, name: str) -> float:
        """Return the range of a sensor's true values."""
        return self.machine.truth.span[name]

    def begin(self) -> None:
        """Begin a case: what was heard before is forgotten."""
        now = time.monotonic()
        self.machine.heard = Evidence(now, spoken=self.machine.heard.spoken)
        if self.machine.latest:
            self.machine.heard.told.append(StatusHeard(now, self.machine.latest))
        self.machine.late = 0.0
        self._waited = self.process.waited() if self.process else 0.0
        self.wrong, self.seen, self._since, self._counted = [], [], {}, False
        self._switches = {name: self.switches(name) for name in self.machine.truth.value}

    def finish(self) -> list[str]:
        """End a case: judge all that was heard; return what was wrong."""
        if not self._counted:   # so that the next case begins with the right counts
            with suppress(Exhausted):
                self.play(STATUS_PERIOD + 0.1)
        heard = self.machine.heard
        heard.ended, heard.late = time.monotonic(), min(self.machine.late, LATE)
        self.busy = self._why_busy(heard.ended - heard.begun)
        for name in list(self._since):
            self._known(name, heard.ended)
        if self.process is not None and not self.process.alive:
            self.wrong.append(f'the replacer has died: {self.process.last_words()}')
        return self.wrong + self.aside(lambda: judge(
            heard, self.machine.truth, self.machine.frames(), UNTIMED,
            self.tested.without_estimate in ('hold', 'pass')))

    def aside(self, compute: Callable[[], T]) -> T:
        """Return what takes a while to compute; the machine runs on, and what it says is new."""
        heard = self.machine.heard
        self.machine.heard = Evidence(time.monotonic(), spoken=set(heard.spoken))
        with ThreadPoolExecutor(1) as pool:
            future = pool.submit(compute)
            with suppress(Exhausted):
                while not future.done():
                    self.play(0.005)
            return future.result()

    def _why_busy(self, lasted: float) -> str:
        """Return what shows that this computer was too busy to judge a case, '' if nothing."""
        if self.machine.late > LATE:
            return f'a reading was played {self.machine.late:.2f} s late'
        waited = self.process.waited() - self._waited if self.process else 0.0
        if waited > WAITED * lasted:
            return f'the replacer waited {waited:.1f} of {lasted:.0f} s for a processor'
        return ''

    def unready(self) -> float:
        """Return how long [s] it takes at least until a case can be played."""
        return 0.0

    # ----------------------------------------------------------------------- the machine

    def play(self, seconds: float) -> None:
        """Let time pass."""
        self.machine.play(seconds)

    def end(self, process: Process, number: int = signal.SIGTERM) -> str:
        """Let time pass until a process has ended; return what was wrong with how it did."""
        process.popen.send_signal(number)
        end = time.monotonic() + PATIENCE
        while process.alive and time.monotonic() < end:
            self.play(0.02)
        return process.trouble(number)

    def fault(self, kind: str, name: str = '', /, **size: float) -> None:
        """Let a sensor, by default the target, fail from now on."""
        name = name or self.target
        self.undetected(name)
        if kind != 'drop_out':  # what is estimated from wrong readings is wrong, too
            for other in self.machine.faulty - {name}:
                self._since.setdefault(other, time.monotonic())
        machine = self.machine
        machine.channels[name] = FAULTS[kind](machine.truth.said[name], machine.now, **size)

    def undetected(self, name: str) -> None:
        """Note that from now on what is heard of a sensor may be wrong, if it is not isolated."""
        if name not in self.machine.faulty:
            self._since.setdefault(name, time.monotonic())

    def heal(self) -> None:
        """Let all sensors measure again."""
        self.machine.channels = dict(self.machine.truth.said)
        for driver in self.machine.drivers:
            driver.garble = None
            if driver.publisher is None:
                driver.open(self.machine.node)
        self.detected()

    def detected(self) -> None:
        """Note that what is heard of all sensors is right again, or they are isolated."""
        for name in list(self._since):
            self._known(name, time.monotonic() + REACTION)

    def _known(self, name: str, until: float) -> None:
        self.machine.heard.blind.setdefault(name, []).append((self._since.pop(name), until))

    # ---------------------------------------------------------------------- the isolator

    def isolate(self, *names: str) -> None:
        """Say which sensors are faulty; those named no more are healthy."""
        if self._since.keys() <= set(names):
            self.detected()
        self.machine.isolate(names)

    def believe(self, *names: str, others: tuple[str, ...] = ()) -> None:
        """Say that sensors are healthy again, and wait until they are believed."""
        self.isolate(*others)
        dwell = max(self.tested.beliefs[name].dwell for name in names)
        latched = [n for n in names if self.tested.beliefs[n].recovery == 'latched']
        for name in names:
            if self.tested.beliefs[name].recovery == 'hold':
                self.play(dwell + 0.1)
                self.call(f'{name}/clear')
        if latched:
            self.play(dwell + 0.1)
            self.call('reset')
            self.fresh = False
        for name in names:
            self.expect(name, 'real', dwell + SOON)

    def call(self, service: str) -> bool:
        """Call a Trigger service of the replacer while the machine runs; tell whether it did."""
        client = self.services.create_client(Trigger, f'{self.tested.parameters.node}/{service}')
        future: Any = None
        end = time.monotonic() + SOON
        try:
            while time.monotonic() < end and not (future and future.done()):
                if future is None and client.service_is_ready():
                    future = client.call_async(Trigger.Request())
                self._executor.spin_once(timeout_sec=0.0)
                self.play(0.02)
            return bool(future and future.done() and future.result().success)
        finally:
            self.services.destroy_client(client)

    # -------------------------------------------------------------------- what is expected

    def source(self, name: str) -> str:
        """Return who serves a channel, as ~/status said last; '' before it said anything."""
        return self.machine.latest.get(name, {}).get('source', '')

    def switches(self, name: str) -> int:
        """Return how often a channel has switched, as ~/status said last."""
        return switches_of(self.machine.latest, name)

    def switched(self, name: str) -> int:
        """Return how often a channel has switched in this case, as ~/status said last."""
        return self.switches(name) - self._switches.get(name, 0)

    def until(self, condition: Callable[[], bool], within: float, what: str) -> bool:
        """Play until something is so; note if it is not in time."""
        end = time.monotonic() + within
        while not condition():
            if time.monotonic() > end:
                self.wrong.append(f'{what} not within {within:g} s')
                return False
            if self.process is not None and not self.process.alive:
                raise GaveUp
            try:
                self.play(0.02)
            except Exhausted:
                self.wrong.append(f'{what} not yet')
                raise
        return True

    def expect(self, name: str, source: str, within: float = SOON) -> bool:
        """Play until a channel has a source; note if it has not in time."""
        sources = ('real', 'silent') if source == 'real' else (source,)
        return self.until(lambda: self.source(name) in sources, within,
                          f'{name} {source}, but {self.source(name) or "no status"}:')

    def told(self, *words: str, within: float) -> None:
        """Play until /diagnostics says one of these words somewhere."""
        self.until(lambda: any(word in message for message in self.machine.said.values()
                               for word in words), within,
                   f'{" or ".join(repr(w) for w in words)} on /diagnostics')

    def expect_path(self, name: str, *sources: str, switches: int | None = None) -> None:
        """
        Note if a channel did not have exactly these sources one after the other.

        switches: that must have been counted; by default from each source to the next.
        """
        expected = len(sources) - 1 if switches is None else switches

        self.play(0.15)     # the last status
        end = time.monotonic() + STATUS_PERIOD + 0.3    # it may be counted a message later
        while self.switched(name) != expected and time.monotonic() < end:
            self.play(0.02)
        self._counted = True
        path = path_of(self.machine.heard.told, name)
        if path != list(sources) or self.switched(name) != expected:
            self.wrong.append(
                f'{name} went {" > ".join(path) or "nowhere"} in {self.switched(name)} switches, '
                f'not {" > ".join(sources)} in {expected}')
        self.seen.append(' > '.join(path))

    def forget_path(self) -> None:
        """Judge paths from here on: what was told before was not the replacer's alone."""
        self.machine.heard.told[:] = [StatusHeard(time.monotonic(), self.machine.latest)]
        self._switches = {name: self.switches(name) for name in self.machine.truth.value}

    def expect_no_step(self, name: str) -> None:
        """Note if the last switch of a healthy channel stepped by more than noise."""
        text = self.machine.latest.get(name, {}).get('last_step', 'nan')
        truth = self.machine.truth
        step, limit = float(text), STEP_PART * truth.span[name] + 6.0 * truth.noise[name]
        outs = [o for o in self.machine.heard.outs
                if isinstance(v := o.values.get(name), float) and math.isfinite(v)]
        jumps = [abs((b.values[name] - truth.at(name, b.time))
                     - (a.values[name] - truth.at(name, a.time)))
                 for a, b in zip(outs, outs[1:]) if a.stamp is not None]
        largest = max([abs(step), *jumps])
        self.seen.append(f'step {largest:.2g}')
        if not largest <= limit:
            self.wrong.append(f'{name} steps by {largest:.3g}, {limit:.2g} allowed')

    @contextmanager
    def excused(self, stamps: bool = False) -> Iterator[None]:
        """Let nothing go out meanwhile, or with `stamps` let them not increase."""
        begun = time.monotonic()
        yield
        spans = self.machine.heard.loose if stamps else self.machine.heard.quiet
        spans.append((begun, time.monotonic() + REACTION))
