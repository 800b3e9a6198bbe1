"""Messages that should not be, and publishers that come and go."""

from __future__ import annotations

from collections.abc import Sequence
import copy
import random
import re
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.serialization import serialize_message
from std_msgs.msg import String

from vsensor_ros.lab.domain import open_nodes
from vsensor_ros.lab.injection.case import BIAS, Case, fail_over, ONE, UNDETECTED
from vsensor_ros.lab.injection.case_context import CaseContext, CONVERGED, Skipped, SOON
from vsensor_ros.lab.played_driver import Garble, PlayedDriver
from vsensor_ros.node.accessor import get_stamp, put_stamp

BURST = 1000            # messages at once
APART = 5_000           # ns between their stamps
GARBAGE = 100_000       # messages
GARBAGE_TIME = 4.0      # s in which they are sent
TOLD = 12.0             # s in which what others do on the topics must be told


def lengths(context: CaseContext, emptied: bool = False) -> tuple[Garble, list[str]]:
    """
    Return what makes the target's array too short or too long in turn, and whom that may hurt.

    emptied: it is left without any element.
    """
    port = context.tested.wiring.ports[context.target]
    match = re.fullmatch(r'(?:(.+)\.)?(\w+)\[[^\[\]]+\]', port.field.path)
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
        setattr(holder, match[2], [] if emptied else
                values[:-1] if count % 2 else [*values, 1e9, -1e9])
        return (message,)

    try:
        garble(copy.deepcopy(context.machine.driver_of(context.target).message))
    except (TypeError, AssertionError, AttributeError, ValueError):
        raise Skipped(f'the length of {port.field.path} is fixed') from None
    array = f'{match[1] + "." if match[1] else ""}{match[2]}['
    return garble, [other.name for other in context.machine.driver_of(context.target).ports
                    if other.field.path.startswith(array)]


def wrong_length(context: CaseContext) -> None:
    """Leave the failed sensor's element out of its array, or add some."""
    garble, names = lengths(context)

    def begin() -> None:
        for name in names:
            context.undetected(name)
        context.machine.driver_of(context.target).garble = garble
    fail_over(context, begin)


def wrong_type(context: CaseContext) -> None:
    """Let somebody publish another type on the driver's topic."""
    domain = context.machine.node.context.get_domain_id()
    with open_nodes('stranger', domain=domain) as (stranger,):
        topic = context.machine.driver_of(context.target).topic
        publisher = stranger.create_publisher(String, topic, 10)
        context.told('std_msgs/msg/String', within=TOLD)
        for _ in range(50):
            publisher.publish(String(data='x' * 100))
            context.play(0.01)
        fail_over(context, lambda: context.fault('freeze'))


def burst(context: CaseContext) -> None:
    """Let all drivers send a thousand messages at once, while healthy and while replaced."""
    def at_once() -> None:
        for driver in _sensors(context):
            driver.garble = _thousand_of(driver)
        context.play(0.6)

    at_once()
    target = context.target
    context.fault('bias', size=BIAS * context.span(target))
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual')
    at_once()
    context.heal()
    context.believe(target)
    context.expect_path(target, 'real', 'virtual', 'real')


def _thousand_of(driver: PlayedDriver) -> Garble:
    """Return what turns the next message of a driver into a thousand, as bytes."""
    def garble(message: Any) -> Sequence[bytes]:
        driver.garble = None
        if not driver.stamped:
            return [serialize_message(message)] * BURST
        # copies of it would take 0.1 s, in which the machine stands still and is played late
        messages, last = [], get_stamp(message)
        for k in reversed(range(BURST)):
            put_stamp(message, last - k * APART)
            messages.append(serialize_message(message))
        return messages
    return garble


def garbage(context: CaseContext) -> None:
    """Send what is no message on the drivers' and the isolation's topics, 10^5 times."""
    draw = random.Random(0)
    rubbish = [(driver.publisher, what) for driver in _sensors(context)
               for what in _not_messages(driver, draw)]
    if isolator := context.machine.isolator:
        rubbish += [(isolator, what) for what in _not_isolation(isolator.msg_type, draw)]
    sent = 0
    while sent < GARBAGE:
        begun = context.machine.now
        for _ in range(GARBAGE // 1000):
            publisher, what = draw.choice(rubbish)
            if publisher is not None:
                publisher.publish(what)
            sent += 1
        context.play(max(0.0, GARBAGE_TIME / 1000 - (context.machine.now - begun)))
    context.play(1.0)     # what is allowed in a second may have been used up
    fail_over(context, lambda: context.fault('freeze'))


def disorder(context: CaseContext) -> None:
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

    for driver in _sensors(context):
        driver.garble = shuffled() if driver.stamped else lambda message: (message, message)
    # of the others nothing but what comes goes out, as it comes
    context.machine.heard.spoken &= {context.tested.wiring.ports[context.target].output}
    with context.excused(stamps=True):  # a relay, while all is healthy
        context.play(0.7)
    fail_over(context, lambda: context.fault('bias', size=BIAS * context.span(context.target)),
              in_order=False)


def publisher_restart(context: CaseContext) -> None:
    """Let the driver die and come back, while healthy and while its sensor is replaced."""
    target, node = context.target, context.machine.node
    driver = context.machine.driver_of(target)

    def restart() -> None:
        for port in driver.ports:   # what it said last is sent on with the others for a while
            context.undetected(port.name)
        with context.excused():
            driver.close(node)
            context.play(0.4)
            driver.open(node)
            context.until(lambda: driver.heard, SOON, 'a listener again')
            context.play(0.3)
        context.detected()

    restart()
    for port in driver.ports:
        context.expect(port.name, 'real')
    context.fault('bias', size=BIAS * context.span(target))
    context.play(UNDETECTED)
    context.isolate(target)
    context.expect(target, 'virtual', CONVERGED)  # what it reads may have been away
    restart()
    context.expect(target, 'virtual', CONVERGED)
    context.play(0.5)
    context.heal()
    context.believe(target)


def isolator_restart(context: CaseContext) -> None:
    """Let the isolator die while a sensor is replaced, and come back without a word."""
    def begin() -> None:
        context.fault('freeze')
        context.play(UNDETECTED)
        context.isolate(context.target)
        context.expect(context.target, 'virtual')
        context.machine.close_isolator()
        context.play(0.7)
        context.machine.open_isolator()
    fail_over(context, begin)


def _sensors(context: CaseContext) -> list[PlayedDriver]:
    return [d for d in context.machine.drivers if d.ports[0].name in context.machine.truth.value]


def _not_messages(driver: PlayedDriver, draw: random.Random) -> list[bytes]:
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


MESSAGE_CASES = (
    Case('wrong_length', ONE, wrong_length, 2.5),
    Case('wrong_type', f'said; {ONE}', wrong_type, 9.0),
    Case('burst', ONE, burst, 4.0),
    Case('disorder', f'stamps of estimates increase; {ONE}', disorder, 3.5),
    Case('publisher_restart', 'goes on; virtual in the fault', publisher_restart, 6.0),
    Case('isolator_restart', ONE, isolator_restart, 4.0),
    Case('garbage', f'nothing of it is used; {ONE}', garbage, 12.0),
)
