"""Messages that should not be, and publishers that come and go."""

from __future__ import annotations

from collections.abc import Sequence
import copy
import random
import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import rclpy
from rclpy.context import Context
from rclpy.serialization import serialize_message
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import String

from vsensor_ros.lab.injection.case_context import CONVERGED, Skipped, SOON, Stage
from vsensor_ros.lab.injection.cases import BIAS, Case, fail_over, ONE, UNDETECTED
from vsensor_ros.lab.injection.rig import Driver, Garble
from vsensor_ros.node.accessor import get_stamp, put_stamp

BURST = 1000            # messages at once
APART = 5_000           # ns between their stamps
GARBAGE = 100_000       # messages
GARBAGE_TIME = 4.0      # s in which they are sent
TOLD = 12.0             # s in which what others do on the topics must be told


def wrong_length(stage: Stage) -> None:
    """Leave the failed sensor's element out of its array, or add some."""
    port = stage.setup.wiring.ports[stage.target]
    match = re.fullmatch(r'(?:(.+)\.)?(\w+)\[\w+\]', port.field.path)
    if match is None:
        raise Skipped(f'{port.field.path} is no element of an array')
    count = 0

    def garble(message: Any) -> Sequence[Any]:
        nonlocal count
        count += 1
        holder = message
        for step in (match[1] or '').split('.') if match[1] else ():
            holder = getattr(holder, step)
        values = list(getattr(holder, match[2]))
        setattr(holder, match[2], values[:-1] if count % 2 else [*values, 1e9, -1e9])
        return (message,)

    try:
        garble(copy.deepcopy(stage.rig.driver_of(stage.target).message))
    except (TypeError, AssertionError, AttributeError, ValueError):
        raise Skipped(f'the length of {port.field.path} is fixed') from None
    driver = stage.rig.driver_of(stage.target)

    def begin() -> None:
        for other in driver.ports:
            if re.match(re.escape(f'{match[1] + "." if match[1] else ""}{match[2]}['),
                        other.field.path):
                stage.undetected(other.name)
        driver.garble = garble
    fail_over(stage, begin)


def wrong_type(stage: Stage) -> None:
    """Let somebody publish another type on the driver's topic."""
    context = Context()
    rclpy.init(context=context, domain_id=stage.rig.node.context.get_domain_id(),
               signal_handler_options=SignalHandlerOptions.NO)
    stranger = rclpy.create_node('stranger', context=context)
    try:
        topic = stage.rig.driver_of(stage.target).topic
        publisher = stranger.create_publisher(String, topic, 10)
        stage.told('std_msgs/msg/String', within=TOLD)
        for _ in range(50):
            publisher.publish(String(data='x' * 100))
            stage.play(0.01)
        fail_over(stage, lambda: stage.fault('freeze'))
    finally:
        stranger.destroy_node()
        rclpy.shutdown(context=context)


def burst(stage: Stage) -> None:
    """Let all drivers send a thousand messages at once, while healthy and while replaced."""
    def thousand_of(driver: Driver) -> Garble:
        def garble(message: Any) -> Sequence[Any]:
            driver.garble = None
            if not driver.stamped:
                return [message] * BURST
            messages = [copy.copy(message) for _ in range(BURST)]
            for k, each in enumerate(messages):
                each.header = copy.deepcopy(message.header)
                put_stamp(each, get_stamp(message) - (BURST - 1 - k) * APART)
            return messages
        return garble

    def at_once() -> None:
        for driver in _sensors(stage):
            driver.garble = thousand_of(driver)
        stage.play(0.6)

    at_once()
    target = stage.target
    stage.fault('bias', size=BIAS * stage.rig.world.span[target])
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual')
    at_once()
    stage.heal()
    stage.believe(target)
    stage.expect_path(target, 'real', 'virtual', 'real')


def garbage(stage: Stage) -> None:
    """Send what is no message on the drivers' and the isolation's topics, 10^5 times."""
    draw = random.Random(0)
    isolator = stage.rig.isolator
    assert isolator is not None
    rubbish = [(driver.publisher, what) for driver in _sensors(stage)
               for what in _not_messages(driver, draw)]
    rubbish += [(isolator, what) for what in _not_isolation(isolator.msg_type, draw)]
    sent = 0
    while sent < GARBAGE:
        begun = stage.rig.now
        for _ in range(GARBAGE // 1000):
            publisher, what = draw.choice(rubbish)
            if publisher is not None:
                publisher.publish(what)
            sent += 1
        stage.play(max(0.0, GARBAGE_TIME / 1000 - (stage.rig.now - begun)))
    stage.play(1.0)     # what is allowed in a second may have been used up
    fail_over(stage, lambda: stage.fault('freeze'))


def disorder(stage: Stage) -> None:
    """Let readings come twice, in the wrong order, and late."""
    draw = random.Random(0)

    def shuffled() -> Any:
        waiting: list[tuple[int, Any]] = []
        count = 0

        def garble(message: Any) -> Sequence[Any]:
            nonlocal count
            count += 1
            chance = draw.random()
            if chance < 0.15:
                waiting.append((count + draw.choice([1, 1, 2, 10]), message))
            due = [m for at, m in waiting if at <= count]
            waiting[:] = [(at, m) for at, m in waiting if at > count]
            now = [] if chance < 0.15 else [message, message] if chance > 0.8 else [message]
            return [*now, *due]
        return garble

    for driver in _sensors(stage):
        driver.garble = shuffled() if driver.stamped else lambda message: (message, message)
    stage.play(0.7)
    fail_over(stage, lambda: stage.fault('spikes', size=stage.rig.world.span[stage.target],
                                         probability=0.3))


def publisher_restart(stage: Stage) -> None:
    """Let the driver die and come back, while healthy and while its sensor is replaced."""
    target, node = stage.target, stage.rig.node
    driver = stage.rig.driver_of(target)

    def restart() -> None:
        for port in driver.ports:   # what it said last is sent on with the others for a while
            stage.undetected(port.name)
        with stage.excused():
            driver.close(node)
            stage.play(0.4)
            driver.open(node)
            publisher = driver.publisher
            assert publisher is not None
            stage.until(lambda: publisher.get_subscription_count() > 0, SOON, 'a listener again')
            stage.play(0.3)
        stage.detected()

    restart()
    for port in driver.ports:
        stage.expect(port.name, 'real')
    stage.fault('bias', size=BIAS * stage.rig.world.span[target])
    stage.play(UNDETECTED)
    stage.isolate(target)
    stage.expect(target, 'virtual', CONVERGED)  # what it reads may have been away
    restart()
    stage.expect(target, 'virtual', CONVERGED)
    stage.play(0.5)
    stage.heal()
    stage.believe(target)


def isolator_restart(stage: Stage) -> None:
    """Let the isolator die while a sensor is replaced, and come back without a word."""
    def begin() -> None:
        stage.fault('freeze')
        stage.play(UNDETECTED)
        stage.isolate(stage.target)
        stage.expect(stage.target, 'virtual')
        stage.rig.close_isolator()
        stage.play(0.7)
        stage.rig.open_isolator()
    fail_over(stage, begin)


def _sensors(stage: Stage) -> list[Driver]:
    return [d for d in stage.rig.drivers if d.ports[0].name in stage.rig.world.truth]


def _not_messages(driver: Driver, draw: random.Random) -> list[bytes]:
    """Return bytes that no decoder can take for a message of the driver's type."""
    sound = serialize_message(driver.message)
    cut = [sound[:draw.randrange(len(sound) // 2)] for _ in range(100)]
    noise = [b'\xff\xff' + draw.randbytes(draw.randrange(2000)) for _ in range(100)]
    endless = [sound[:12] + b'\xff\xff\xff\xff' + sound[16:]] if driver.stamped else []
    return [*cut, *noise, *endless * 50]


def _not_isolation(kind: Any, draw: random.Random) -> list[Any]:
    """Return bytes that are no message, and messages that name no sensor."""
    bytes_ = [b'\xff\xff' + draw.randbytes(draw.randrange(2000)) for _ in range(50)]
    names = [f'no sensor {k}' for k in range(20)] + ['', 'x' * 100_000, '\u00e9' * 1000, ';--']
    if kind is not DiagnosticArray:
        return [*bytes_, *(String(data=name) for name in names if name)]
    return [*bytes_, *(DiagnosticArray(status=[DiagnosticStatus(
        name=name, level=bytes([draw.randrange(256)]))] * draw.choice([1, 50]))
        for name in names if len(name) < 10_000 or draw.random() < 0.5)]


HOSTILE = (
    Case('wrong_length', ONE, wrong_length, 2.5),
    Case('wrong_type', f'said; {ONE}', wrong_type, 9.0),
    Case('burst', ONE, burst, 4.0),
    Case('disorder', f'stamps increase; {ONE}', disorder, 3.5),
    Case('publisher_restart', 'goes on; virtual in the fault', publisher_restart, 6.0),
    Case('isolator_restart', ONE, isolator_restart, 4.0),
    Case('garbage', f'nothing of it is used; {ONE}', garbage, 12.0),
)
