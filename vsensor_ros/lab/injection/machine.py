"""The machine beside the replacer, played in real time, and everything that comes back."""

from __future__ import annotations

from collections.abc import Sequence
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import numpy as np
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rosgraph_msgs.msg import Clock

from vsensor_ros.lab.domain import by_hand
from vsensor_ros.lab.injection.truth import Truth
from vsensor_ros.lab.injection.verdict import Evidence, Out, Said, Stated, StatusHeard
from vsensor_ros.lab.played_driver import drivers_of, names_in, PlayedDriver
from vsensor_ros.lab.wiring import Port, Wiring
from vsensor_ros.node.accessor import get_stamp, has_stamp, put_stamp
from vsensor_ros.node.private_rclpy import take_all
from vsensor_ros.simulate.fault import Recorded

POLL = 0.001            # s between two looks at the topics
CLOCK_STEP = 0.005      # s between two messages on /clock
REPEAT = 0.5            # s between two messages of the isolator
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATUS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LISTEN = QoSProfile(depth=2000, reliability=ReliabilityPolicy.BEST_EFFORT)


class Exhausted(RuntimeError):
    """The truth that was computed is over."""


class Machine:
    """
    The machine, its isolator and the listener; all in one thread, in `play`.

    `channels` is what every channel says: faults are put there. `shift` [ns] is added to the
    stamps and to /clock; with `simulated`, time passes there only while `paused` is not set.
    """

    def __init__(self, node: Node, wiring: Wiring, truth: Truth, replacer: str,
                 simulated: bool = False, isolated: bool = True) -> None:
        """Prepare. replacer: its full name. isolated: somebody says which sensor failed."""
        self.node, self.wiring, self.truth = node, wiring, truth
        self.channels: dict[str, Recorded] = dict(truth.said)
        self.heard = Evidence(time.monotonic())
        self.faulty: frozenset[str] = frozenset()   # what isolation says
        self.shift, self._shift_before, self.paused = 0, 0, False
        self.late = 0.0     # s, the worst since it was last set to 0
        self.now = 0.0      # s, the truth's time
        self._played: dict[str, int] = dict.fromkeys(truth.said, 0)     # rows, by channel
        self._wall = time.monotonic()
        self.origin = time.time_ns()    # ns, the stamp of time 0
        self._repeated = self._clocked = 0.0
        self.drivers = drivers_of(node, (wiring.ports[name] for name in truth.said))
        self.isolator: Publisher | None = None
        if isolated:
            self.open_isolator()
        self.clock = node.create_publisher(Clock, '/clock', 10) if simulated else None
        self.outputs: dict[str, tuple[Subscription, list[Port]]] = {}
        for name in truth.value:
            port = wiring.ports[name]
            if port.output not in self.outputs:
                self.outputs[port.output] = (node.create_subscription(
                    port.kind, port.output, by_hand, LISTEN), [])
            self.outputs[port.output][1].append(port)
        self._status = node.create_subscription(
            DiagnosticArray, f'{replacer}/status', by_hand, STATUS)
        self._estimates = node.create_subscription(
            DiagnosticArray, f'{replacer}/estimates', by_hand, LISTEN)
        self._verdicts = node.create_subscription(
            DiagnosticArray, f'{replacer}/isolation', by_hand, STATUS)
        self._diagnostics = node.create_subscription(DiagnosticArray, '/diagnostics', by_hand, 10)
        self.latest: dict[str, dict[str, str]] = {}     # by channel: what ~/status said last
        self.verdict = Said(0.0, '', {})    # what the replacer's own isolator said last
        self.said: dict[str, str] = {}                  # by name: what /diagnostics said last
        self.statuses = 0   # messages on ~/status
        self.report()       # a replacer that starts waits for what isolation said before

    # ---------------------------------------------------------------------------- the machine

    def driver_of(self, sensor: str) -> PlayedDriver:
        """Return who publishes a sensor."""
        return next(d for d in self.drivers if any(p.name == sensor for p in d.ports))

    def frames(self) -> dict[str, tuple[str, tuple[str, ...]]]:
        """Return frame_id and names of each output topic, as its driver gives them."""
        return {ports[0].output: (d.frame, d.names) for _, ports in self.outputs.values()
                for d in [self.driver_of(ports[0].name)]}

    def play(self, seconds: float) -> None:
        """Let time pass; raise Exhausted."""
        end = time.monotonic() + seconds
        while True:
            self._step()
            self.listen()
            if (left := end - time.monotonic()) <= 0.0:
                return
            time.sleep(min(POLL, left))

    def _step(self) -> None:
        wall = time.monotonic()
        passed, self._wall = wall - self._wall, wall
        if not self.paused:
            self.now += passed
        if self.now > self.truth.end:
            raise Exhausted('the machine has run for longer than its truth was computed')
        if self.clock and wall - self._clocked >= CLOCK_STEP:
            self._clocked = wall
            message = Clock()
            message.clock.sec, message.clock.nanosec = divmod(self.stamp(self.now), 10**9)
            self.clock.publish(message)
        for driver in self.drivers:
            self._advance(driver)
        if wall - self._repeated >= REPEAT and self.faulty:
            self.report()

    def _advance(self, driver: PlayedDriver) -> None:
        """Send every reading that is due; the sensors of one topic share their rows."""
        first = driver.ports[0].name
        times = self.channels[first].time
        row = self._played[first]
        while row < len(times) and times[row] <= self.now:
            self.late = max(self.late, self.now - times[row])
            sent = [self.channels[p.name].sent[row] for p in driver.ports]
            if any(sent):
                driver.send([float(self.channels[p.name].value[row]) if s else np.nan
                             for p, s in zip(driver.ports, sent)], self.stamp(times[row]))
            row += 1
        self._played[first] = row

    def stamp(self, at: float) -> int:
        """Return the stamp [ns] of a time of the truth's."""
        return self.origin + self.shift + round(at * 1e9)

    def jump(self, seconds: float) -> None:
        """Set the clock of stamps and of /clock ahead, or back."""
        self._shift_before, self.shift = self.shift, self.shift + round(seconds * 1e9)

    # --------------------------------------------------------------------------- the isolator

    def open_isolator(self) -> None:
        """Begin to isolate; what it said last is kept for who comes later."""
        self.isolator = self.node.create_publisher(
            self.wiring.isolation_kind, self.wiring.isolation, KEPT)

    def close_isolator(self) -> None:
        """Die."""
        if self.isolator is not None:
            self.node.destroy_publisher(self.isolator)
            self.isolator = None

    def isolate(self, names: Sequence[str]) -> None:
        """Say that these sensors are faulty and all others healthy, now and while any is."""
        self.faulty = frozenset(names)
        self.report()

    def report(self) -> None:
        """Say again which sensors are faulty."""
        self._repeated = time.monotonic()
        if self.isolator is None:
            return
        if isinstance(message := self.isolator.msg_type(), DiagnosticArray):
            put_stamp(message, self.stamp(self.now))
            message.status = [DiagnosticStatus(
                name=name, message='said by fault_injection', level=DiagnosticStatus.ERROR
                if name in self.faulty else DiagnosticStatus.OK) for name in self.truth.value]
        else:
            message.data = ' '.join(sorted(self.faulty))
        self.isolator.publish(message)

    # --------------------------------------------------------------------------- the listener

    def listen(self) -> None:
        """Take everything that has come."""
        for topic, (subscription, ports) in self.outputs.items():
            for raw, _ in take_all(subscription, raw=True):
                self._note(topic, ports, raw)
        for message, _ in take_all(self._estimates):
            self._note_estimates(message)
        for message, _ in take_all(self._status):
            facts = {s.name: {v.key: v.value for v in s.values} for s in message.status}
            self.statuses += 1
            if any(name in facts for name in self.truth.value):     # else it is being shut down
                self.latest = facts
                self.heard.told.append(StatusHeard(time.monotonic(), facts))
                self.heard.spoken.update(self.wiring.ports[name].output for name in facts if (
                    facts[name].get('source') == 'virtual'))
        for message, _ in take_all(self._verdicts):
            self.verdict = _said(message)
            self.heard.said.append(self.verdict)
        for message, _ in take_all(self._diagnostics):
            self.said.update({s.name: s.message for s in message.status})

    def _note_estimates(self, message: DiagnosticArray) -> None:
        arrival = time.monotonic()
        for status in message.status:
            for value in status.values:
                if value.key == 'deviation':
                    self.heard.stated.setdefault(status.name, []).append(
                        Stated(arrival, get_stamp(message), float(value.value)))

    def _note(self, topic: str, ports: Sequence[Port], raw: bytes) -> None:
        arrival = said = time.monotonic()
        try:
            message = deserialize_message(raw, ports[0].kind)
        except Exception:   # the middleware's own kinds
            self.heard.unreadable += 1
            return
        stamp, at, frame = None, self.now, ''
        if has_stamp(ports[0].kind):
            stamp, frame = get_stamp(message), message.header.frame_id
            at = min(((stamp - self.origin - shift) * 1e-9 for shift in (
                self.shift, self._shift_before)), key=lambda time: abs(time - self.now))
            said -= max(0.0, self.now - at)
        self.heard.outs.append(Out(topic, arrival, said, stamp, at, {
            p.name: value if isinstance(value := p.field.get(message), float) else str(value)
            for p in ports}, frame, names_in(message)))


def _said(message: DiagnosticArray) -> Said:
    """Return what an isolator says: one status a sensor, and one without for itself."""
    facts = {s.hardware_id: {v.key: v.value for v in s.values} for s in message.status}
    return Said(time.monotonic(), facts.get('', {}).get('state', ''), {
        s.hardware_id: facts[s.hardware_id].get('kind', '') for s in message.status
        if s.hardware_id and s.level == DiagnosticStatus.ERROR},
        float(facts.get('', {}).get('learning_s', 'inf')))
