"""
The replacer node: forwards the healthy, speaks for the failed.

One loop in the main thread takes messages (500 times a second), steps the bank at its rate and
publishes. An executor in a background thread serves parameters, the time source and the look at
the graph, nothing that touches the loop's data.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
import sys
from threading import Event, Thread
import time

from diagnostic_msgs.msg import DiagnosticArray
import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from std_msgs.msg import String

from vsensor_ros.bad_input import BadInput
from vsensor_ros.bank import Bank, Source, Switch
from vsensor_ros.node import isolation
from vsensor_ros.node.accessor import get_stamp, has_stamp
from vsensor_ros.node.diagnostics import Channel, report
from vsensor_ros.node.graph import complaints, End
from vsensor_ros.node.parameters import check_addressed, check_files, DIAGNOSTICS, read, Refused
from vsensor_ros.node.topics import (
    Arrived,
    CLOCKS_APART,
    decode,
    drain,
    LISTEN,
    LISTEN_RELIABLY,
    open_streams,
    Polled,
    Stream,
    subscribe,
)
from vsensor_ros.virtual_sensor import VirtualSensor

POLL = 0.002  # s between two looks at the subscriptions
CATCH_UP = 10  # ticks made good one by one when the loop or the clock is late; else the newest
SLACK = 0.25  # of a period that a tick waits for readings: a held one is a small step behind
LOOK = 2.0  # s between two looks at the graph
REPORT = 1.0  # s between two messages on /diagnostics when nothing changes
QUIET = 5.0  # s between two log lines on the same subject
SLOW = 3  # intervals longer than max_age in a row that make a slow sensor of a silent one
UNREADABLE = 'bytes that are not a message of the type'
GOES_OUT = {'stop': 'nothing goes out', 'hold': 'the last value goes out',
            'nan': 'NaN goes out', 'pass': 'the failed reading goes out'}


class Replacer:
    """The wiring of one node: topics to bank and switch, and back."""

    def __init__(self, node: Node) -> None:
        """Check the node's parameters and open all topics; raise Refused."""
        self.node = node
        self.settings = settings = read(node)
        try:
            self.bank = Bank(settings.design, settings.rate, settings.max_age)
        except ValueError as error:
            name, _, problem = str(error).partition(': ')
            problem, _, mend = problem.partition('; ')
            raise Refused([BadInput(node.get_fully_qualified_name(), name, problem, mend)]) \
                from None
        self.switch = Switch.of(settings.design)
        self.now = 0  # ns, node clock
        self.simulated = False  # that clock follows /clock
        self.ticked = 0  # ns, last time the bank was brought to
        self.overruns = 0  # ticks left out
        self.silence = max(round(settings.max_age * 1e9), 3 * self.bank.period)
        self.held: dict[str, float] = {}  # by sensor: the last value worth holding
        self.why: dict[str, str] = {}  # by failed sensor: why it has no estimate
        self.counts: Counter[tuple[str, str]] = Counter()  # by channel and reason: not used
        self.intervals: dict[str, tuple[int, int]] = {}  # by sensor: stamp, long ones in a row
        self.spoken: dict[object, float] = {}  # by subject: when it was last logged
        self.slow: set[str] = set()  # sensors that were said to be
        self.shown: dict[str, str] = {}  # by sensor: the source last logged and reported
        self.reported = 0.0

        self.isolation_kind = DiagnosticArray if settings.isolation_type == DIAGNOSTICS else String
        try:
            self._open(Polled())
        except RuntimeError as error:  # RCLError
            problem = str(error).partition(', at ')[0]
            raise Refused([BadInput(node.get_fully_qualified_name(), 'topics', problem,
                                    'give the topics other names')]) from None
        self.ends = self._ends()
        node.create_timer(LOOK, self._look_around, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.seen: set[str] = set()  # what was said of the graph; the executor's own
        self.suspected: set[str] = set()  # and what was seen at the last look
        self._log_topics()

    def _open(self, group: Polled) -> None:
        node, settings = self.node, self.settings
        self.streams = open_streams(
            node, group, settings.sensors, self.silence,
            lambda text: self._say(text, 'error', text))
        self.commands = [(c, subscribe(node, group, c.kind, c.topic, LISTEN), has_stamp(c.kind))
                         for c in settings.commands]
        self.isolation = subscribe(
            node, group, self.isolation_kind, settings.isolation_topic, LISTEN_RELIABLY)
        self.diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10)

    # ---------------------------------------------------------------------------- the loop

    def run(self, stop: Event) -> None:
        """Serve until told to stop."""
        executor = SingleThreadedExecutor(context=self.node.context)
        executor.add_node(self.node)
        thread = Thread(target=executor.spin, name='executor')
        thread.start()
        try:
            due = time.monotonic()
            with ExitStack() as stack:
                for subscription in self._subscriptions():
                    stack.enter_context(subscription.handle)  # once, instead of at each take
                while not stop.is_set():
                    self.poll()
                    due = max(due + POLL, time.monotonic() - 0.1)
                    time.sleep(max(0.0, due - time.monotonic()))
        finally:
            executor.shutdown()
            thread.join()

    def poll(self) -> None:
        """Take everything that has arrived, then tick if it is time."""
        self._read_clock()
        self._take_isolation()
        faulty = self.switch.faulty
        for stream in self.streams:
            for raw, received in drain(stream.subscription):
                self._take_readings(stream, stream.read(raw, received), faulty)
        self._take_commands()
        ticked = self._tick()
        if time.monotonic() >= self.reported + REPORT or (ticked and self._changed()):
            self._report()

    def _read_clock(self) -> None:
        clock = self.node.get_clock()
        now, self.simulated = clock.now().nanoseconds, clock.ros_time_is_active
        if now < self.now - (0 if self.simulated else CLOCKS_APART):
            self._say('clock', 'warning', f'the clock went back by {(self.now - now) * 1e-9:.1f} '
                      's; all virtual sensors start anew')
            self.bank.advance(now)  # which resets it
            self.ticked = now
            for stream in self.streams:
                stream.forget()
            self.intervals.clear()
            self.now = now
        else:
            self.now = max(self.now, now)  # a clock being trimmed stands still for us

    # ------------------------------------------------------------------------ what comes in

    def _take_isolation(self) -> None:
        faulty = self.switch.faulty
        for raw, _ in drain(self.isolation):
            message = decode(self.isolation_kind, raw)
            if message is None:
                said = isolation.Isolation(faulty, (UNREADABLE,))
            elif isinstance(message, DiagnosticArray):
                said = isolation.from_statuses(
                    ((s.name, s.level) for s in message.status), self.bank.sensors, faulty,
                    self.isolation.topic_name == self.diagnostics.topic_name)
            else:
                said = isolation.from_text(message.data, self.bank.sensors, faulty)
            faulty = said.faulty
            if said.problems:
                self._say('isolation', 'error',
                          f'{self.settings.isolation_topic}: {"; ".join(said.problems)}')
        if faulty == self.switch.faulty:
            return
        self.switch = self.switch.isolate(faulty, self.now)
        names = ', '.join(s for s in self.bank.sensors if s in faulty)
        self._say('faulty', 'info', f'faulty sensors: {names or "none"}')
        for stream in self.streams:
            self._replace(stream, self._state_time())  # now, if that tick has not gone out

    def _take_readings(self, stream: Stream, arrived: Arrived | None,
                       faulty: frozenset[str]) -> None:
        if arrived is None:
            stream.lacks(UNREADABLE, self.now)
            self._count(stream.sensors[0].name, UNREADABLE)
            return
        problem = stream.accept(arrived, self.now, faulty)
        if problem is not None:
            self._count(stream.sensors[0].name, problem)
        for name, value in arrived.readings.items():
            if isinstance(value, str):
                if not arrived.foreign:
                    self._count(name, value)
            elif name in faulty:
                continue  # nothing that an isolated sensor says is worth reading
            elif self._feed(name, arrived.stamp, arrived.received, value):
                self.held[name] = value

    def _take_commands(self) -> None:
        for command, subscription, stamped in self.commands:
            for raw, received in drain(subscription):
                message = decode(command.kind, raw)
                value = UNREADABLE if message is None else command.accessor.get(message)
                if isinstance(value, str):
                    self._count(command.name, value)
                else:
                    self._feed(command.name, get_stamp(message) if stamped else None, received,
                               value)

    def _feed(self, name: str, stamp: int | None, received: int, value: float) -> bool:
        """Give a value to the bank at its stamp, else at its time of receipt."""
        if not stamp:
            stamp = self.now if self.simulated else received
            if not stamp:
                return False  # simulated time has not begun
        reason = self.bank.take(name, stamp, value, self.now)
        if reason is not None:
            self._count(name, reason)
        elif name in self.bank.sensors:
            self._time(name, stamp)
        return reason is None

    def _time(self, name: str, stamp: int) -> None:
        """Say once when a sensor is slower than the silence that makes it invalid."""
        last, row = self.intervals.get(name, (stamp, 0))
        row = row + 1 if stamp - last > self.silence else 0
        self.intervals[name] = stamp, row
        if row == SLOW and name not in self.slow:
            self.slow.add(name)
            self.node.get_logger().warning(
                f'{name}: its readings are {(stamp - last) * 1e-9:.3g} s apart, so between them '
                f'it counts as silent after {self.silence * 1e-9:.3g} s; raise max_age')

    # ----------------------------------------------------------------------- what goes out

    def _state_time(self) -> int:
        return self.ticked if self.bank.time is None else self.bank.time

    def _tick(self) -> bool:
        """Bring the bank to the present, one period after the other, and speak for the failed."""
        if self.now == 0:
            return False  # simulated time has not begun
        period = self.bank.period
        base = self._state_time()
        missed = (self.now - base) // period
        if missed < 1 or (missed == 1 and self.now < base + period + round(SLACK * period)
                          and not self.bank.confirmed(base + period, self.switch.faulty)):
            return False
        if missed > CATCH_UP:
            if base:
                self.overruns += missed - 1
            base = self.now - self.now % period - period if self.bank.time is None \
                else base + (missed - 1) * period
            missed = 1
        for i in range(1, missed + 1):
            self.ticked = base + i * period
            self.bank.advance(self.ticked)
            for stream in self.streams if self.switch.faulty else ():
                self._replace(stream, self._state_time())
        return True

    def _replace(self, stream: Stream, at: int) -> None:
        """Send what stands in for the failed channels of a stream at the time of the state."""
        values: dict[str, float] = {}
        passing, stopped = set(), {}
        action = self.settings.without_estimate
        stream.problem = None
        for name in (s.name for s in stream.sensors if s.name in self.switch.faulty):
            decision = self.switch.decisions[name]
            estimate = None
            if decision.source is Source.VIRTUAL:
                estimate = self.bank.estimate(decision.fault_set, name)
            if estimate is not None:
                values[name] = self.held[name] = estimate
                self.why.pop(name, None)
                continue
            act = action if action != 'hold' or name in self.held else 'stop'
            reason = decision.reason or self.bank.why_not(decision.fault_set, name)
            self.why[name] = f'{reason}; {GOES_OUT[act]}'
            if act == 'nan':
                values[name] = float('nan')
            elif act == 'hold':
                values[name] = self.held[name]
            elif act == 'pass':
                passing.add(name)
            else:
                stopped[name] = f'{reason}; {GOES_OUT["nan"]}'  # if others are in the message
        stream.passing = frozenset(passing)
        others = (s.name for s in stream.sensors if s.name not in {*values, *stopped})
        if not (values or stopped) or at == 0 or \
                not (values or any(stream.fresh(name, self.now) for name in others)):
            return  # those that all pass go out as they come in; those that all stop, never
        self.why.update(stopped)
        values.update(dict.fromkeys(stopped, float('nan')))
        stream.compose(at, values, self.now)
        if stream.problem is not None:
            for name in values:
                self.why[name] = f'{stream.problem}; {GOES_OUT["stop"]}'

    # ------------------------------------------------------------------- what is said of it

    def _count(self, name: str, reason: str) -> None:
        self.counts[name, reason] += 1
        self._say((name, reason), 'warning', f'{name}: {reason} '
                  f'({self.counts[name, reason]} so far)')

    def _say(self, subject: object, level: str, text: str) -> None:
        """Log one line on a subject, then no other on it for a while."""
        at = time.monotonic()
        if at >= self.spoken.get(subject, 0.0):
            if len(self.spoken) > 10_000:  # subjects come from outside
                self.spoken.clear()
            self.spoken[subject] = at + QUIET
            log = self.node.get_logger()
            if level == 'error':  # rclpy allows one severity a line of code
                log.error(text)
            elif level == 'warning':
                log.warning(text)
            else:
                log.info(text)

    def _source(self, stream: Stream, name: str) -> str:
        if name in self.switch.faulty:
            return 'none' if name in self.why else 'virtual'
        if stream.why_silent(name, self.now) is not None:
            return 'silent'
        return 'real' if stream.problem is None else 'none'

    def _changed(self) -> bool:
        return any(self.shown.get(sensor.name) != self._source(stream, sensor.name)
                   for stream in self.streams for sensor in stream.sensors)

    def _report(self) -> None:
        self.reported = time.monotonic()
        channels = [self._channel(stream, sensor.name, sensor.output)
                    for stream in self.streams for sensor in stream.sensors]
        for channel in channels:
            before = self.shown.get(channel.name)
            if before != channel.source:
                self.shown[channel.name] = channel.source
                level = 'error' if channel.source == 'none' else 'info'
                if before is not None:
                    self._say((channel.name, channel.source), level,
                              f'{channel.name}: {channel.message}')
        self.diagnostics.publish(report(self.node.get_name(), channels, self.now))

    def _channel(self, stream: Stream, name: str, topic: str) -> Channel:
        source = self._source(stream, name)
        fault_set = ', '.join(s for s in self.bank.sensors if s in self.switch.faulty)
        decision = self.switch.decisions[name]
        facts: dict[str, object] = {'switches': self.switch.switches[name]}
        since = self.switch.since[name]
        if since is not None:
            facts['since [s]'] = f'{(self.now - since) * 1e-9:.1f}'
        facts.update({reason: count for (channel, reason), count in sorted(self.counts.items())
                      if channel == name})
        facts['faulty sensors'] = fault_set or 'none'
        facts.update({f'clock went {way}': count for way, count in self.bank.jumps.items()})
        if self.overruns:
            facts['ticks left out'] = self.overruns
        entry = self.settings.design.entries.get((decision.fault_set, name))
        if isinstance(entry, VirtualSensor):
            key = entry.fault_set, name
            facts.update({'order': entry.order, 'method': entry.method,
                          'restarts': self.bank.restarts[key]})
            started = self.bank.started(*key)
            if started is not None:
                facts['running since [s]'] = f'{(self.now - started) * 1e-9:.1f}'
            if outside := self.bank.outside_domain[key]:
                facts['steps outside a domain'] = outside
        if source == 'real':
            message = 'real'
        elif source == 'silent':
            message = f'{stream.why_silent(name, self.now)}; check the driver of {name}'
        elif source == 'virtual' and isinstance(entry, VirtualSensor):
            message = (f'virtual, from {", ".join((*entry.reads, *entry.inputs)) or "nothing"}; '
                       f'repair {name}')
        elif name not in self.switch.faulty:
            message = f'healthy, but nothing goes out with it ({stream.problem}); repair ' \
                f'{", ".join(s.name for s in stream.sensors if s.name in self.switch.faulty)}'
        else:
            exact = tuple(s for s in self.bank.sensors if s in self.switch.faulty)
            remedy = f'repair {name}'
            if (exact, name) not in self.settings.design.entries:
                remedy += f', or make a design for {{{fault_set}}}'
            message = f'no valid source ({self.why.get(name, "")}); {remedy}'
        return Channel(name, topic, source, message, facts)

    # ------------------------------------------------------------------------- the graph

    def _subscriptions(self) -> Iterable[Subscription]:
        yield self.isolation
        yield from (stream.subscription for stream in self.streams)
        yield from (subscription for _, subscription, _ in self.commands)

    def _ends(self) -> tuple[End, ...]:
        s = self.settings
        ends = [End(s.isolation_topic, s.isolation_type, False)]
        for stream in self.streams:
            sensor = stream.sensors[0]
            ends.append(End(sensor.input, sensor.type, False))
            ends.append(End(sensor.output, sensor.type, True))
        return (*ends, *(End(c.topic, c.type, False) for c in s.commands))

    def _look_around(self) -> None:
        lines = set(complaints(self.node, self.ends))
        for line in sorted(lines & self.suspected - self.seen):  # half discovered looks wrong
            self.node.get_logger().error(line)
            self.seen.add(line)
        self.suspected = lines

    def _log_topics(self) -> None:
        log = self.node.get_logger()
        for s in self.settings.sensors:
            log.info(f'{s.name}: {s.input} -> {s.output} ({s.type}, {s.accessor.path})')
        for c in self.settings.commands:
            log.info(f'{c.name}: {c.topic} ({c.type}, {c.accessor.path})')
        log.info(f'isolation: {self.settings.isolation_topic} ({self.settings.isolation_type})')
        log.info(f'{len(self.settings.design.virtual_sensors)} virtual sensors of '
                 f'{self.settings.design.plant_name} at {self.settings.rate:g} Hz; without an '
                 f'estimate: {self.settings.without_estimate}')


def make_node(context: Context | None = None, overrides: Sequence[Parameter] = ()) -> Node:
    """Create the node with the parameters it was given, not yet checked."""
    return Node('replacer', context=context, parameter_overrides=list(overrides),
                automatically_declare_parameters_from_overrides=True)


def start(arguments: Sequence[str], stop: Event) -> int:
    """
    Run the replacer until told to stop.

    Signals are the caller's: rclpy would shut the context down under a loop that is publishing.
    Returns the exit status: 0, or 2 when it was given something it cannot start with; then there
    is one line on stderr for each problem.
    """
    try:
        addressed = check_files(arguments)
        try:
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
            node = make_node()
        except (RuntimeError, ValueError) as error:  # what rcl raises, and rclpy for []
            raise Refused([BadInput('replacer', 'arguments', str(error),
                                    'correct the arguments after --ros-args')]) from None
        check_addressed(node, addressed)
        replacer = Replacer(node)
        replacer.run(stop)
    except Refused as refused:
        print(refused, file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()
    return 0
