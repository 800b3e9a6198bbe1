"""The loop, on the wall clock, in a thread of its own."""

from contextlib import contextmanager
import random
from threading import Event, Thread
import time

import numpy as np
import pytest
from sensor_msgs.msg import Range

from vsensor_ros.node.accessor import get_stamp, put_stamp
from vsensor_ros.node.loop import run

RANGE = 'sensor_msgs/msg/Range'
PERIOD = 10_000_000  # ns
KEPT, TAKEN = 1000, 200  # messages of a topic between two polls, and in one: docs/topics.md


@contextmanager
def running(r):
    """Let the loop run; the rig only listens meanwhile."""
    stop, active = Event(), Event()
    active.set()
    poll, r.replacer.poll = r.replacer.poll, lambda *given: 0
    thread = Thread(target=run, args=(type('Loop', (), {
        'poll': staticmethod(poll), 'subscriptions': r.replacer.subscriptions,
        'node': r.replacer.node, 'simulated': r.replacer.simulated,
        'due': property(lambda _: r.replacer.due)})(),
        stop, active))
    thread.start()
    try:
        yield stop, active, thread
    finally:
        stop.set()
        thread.join(60.0)
        r.replacer.poll = poll
        assert not thread.is_alive()


def sensors(r):
    return [r.publisher(Range, f'/y{i}_raw') for i in (1, 2, 3)]


def now_(value):
    message = Range(range=float(value))
    put_stamp(message, time.time_ns())
    return message


def publish(driver, count, first=0):
    for i in range(first, first + count):
        driver.publish(now_(i))


def test_what_came_while_nobody_polled_goes_on_in_portions(rig, parameters):
    r = rig(parameters, sim_time=False)
    heard, driver = r.listen(RANGE, '/y1'), r.publisher(Range, '/y1_raw')
    publish(driver, KEPT + 1)
    taken = [r.replacer.poll() for _ in range(KEPT // TAKEN + 1)]
    assert taken == [TAKEN] * (KEPT // TAKEN) + [0]
    assert r.spin_until(lambda: len(heard) == KEPT)
    assert r.values(heard) == list(range(1, KEPT + 1))  # only the oldest found no room


@pytest.mark.parametrize('burst, times', [(50, 20), (TAKEN + 1, 3), (KEPT, 2)])
def test_a_burst_goes_through_completely(rig, parameters, burst, times):
    r = rig(parameters, sim_time=False)
    heard, driver = r.listen(RANGE, '/y1'), r.publisher(Range, '/y1_raw')
    with running(r):
        for k in range(times):
            with r.replacer.lock:  # the loop stands still until all are there
                publish(driver, burst, k * burst)
            assert r.spin_until(lambda due=(k + 1) * burst: len(heard) >= due), len(heard)
    assert r.values(heard) == list(range(burst * times))


def test_messages_pass_and_ticks_lie_on_the_grid(rig, parameters):
    # a busy computer makes the burst a late one: then estimates come after so long a silence
    r = rig({**parameters, 'sensors.y2.max_age': 0.5}, sim_time=False)
    heard = [r.listen(RANGE, f'/y{i}') for i in (1, 2, 3)]
    drivers = sensors(r)
    with running(r):
        for i in range(200):  # a burst
            for driver in drivers:
                driver.publish(now_(i))
        assert r.spin_until(lambda: all(len(h) == 200 for h in heard))
        assert all(r.values(h) == list(range(200)) for h in heard)
        r.replacer.force('y2')

        def served():
            drivers[0].publish(now_(0.75))
            r.spin(0.005)
            return len(heard[1]) > 230
        assert r.spin_until(served)
        virtual = heard[1][202:]
        assert set(r.values(virtual[-20:])) == {1.5}  # twice what the first said lately
        assert np.all(np.diff(r.stamps(virtual)) % PERIOD == 0)
        assert np.all(np.diff(r.stamps(heard[1][199:])) > 0)
        health, engine = r.replacer.health(), r.replacer.snapshot()
    assert engine.ticks > 20 and engine.estimates >= 30
    assert 0.0 < health.step_p50 <= health.step_p99 <= health.step_max


def test_an_estimate_waits_for_its_time_to_be_sent(rig, parameters):
    r = rig(parameters, sim_time=False)
    drivers = sensors(r)
    publisher = r.replacer.topics[1].publisher
    publish, waited = publisher.publish, []

    def note(message):
        waited.append(time.time_ns() - get_stamp(message))
        publish(message)
    publisher.publish = note
    with running(r):
        for driver in drivers:
            driver.publish(now_(0.5))
        r.replacer.force('y2')

        def served():
            drivers[0].publish(now_(0.5))
            r.spin(0.005)
            return len(waited) > 25
        assert r.spin_until(served)
    assert min(waited[5:]) > 0.249 * PERIOD  # however busy the machine is: never sooner


@pytest.mark.parametrize('which', ['stop', 'active'])
def test_it_ends(rig, parameters, which):
    r = rig({**parameters, 'rate': 0.5}, sim_time=False)
    with running(r) as (stop, active, thread):
        r.spin()
        if which == 'stop':
            stop.set()
        else:
            active.clear()
        thread.join(60.0)  # though the next tick is 2 s away, and no message comes
        assert not thread.is_alive()


def test_what_goes_wrong_with_one_stream_stops_no_other(rig, parameters, capfd):
    r = rig(parameters, sim_time=False)
    heard = r.listen(RANGE, '/y3')
    drivers = sensors(r)
    first, second, _ = r.replacer.topics

    def refuse(*given):
        raise RuntimeError('failed to publish: out of memory, at /ros/publisher.c:1')

    def stumble(*given):
        raise LookupError
    first.send, second.forward = refuse, stumble
    with running(r):
        for _ in range(5):
            for driver in drivers:
                driver.publish(now_(0.5))
        assert r.spin_until(lambda: len(heard) == 5)
        # topics are taken in any order: those of the others may still be on their way
        assert r.spin_until(
            lambda: r.counts['y1', 'not sent: failed to publish: out of memory'] == 5
            and r.counts['y2', 'a mistake of this node (LookupError)'] == 5)
    said = capfd.readouterr().err
    assert said.count('not sent: failed') == 1 and said.count('Traceback') == 1


def test_garbage_goes_nowhere(rig, parameters):
    r = rig(parameters, sim_time=False)
    heard = [r.listen(RANGE, f'/y{i}') for i in (1, 2, 3)]
    drivers = sensors(r)
    chance = random.Random(5)
    with running(r):
        for i in range(300):
            for driver in drivers:
                driver.publish(chance.randbytes(chance.randrange(40)))
            if i % 20 == 0:
                r.spin(0.002)
        for driver in drivers:
            driver.publish(now_(0.5))
        assert r.spin_until(lambda: all(len(h) == 1 for h in heard))
    assert all(r.values(h) == [0.5] for h in heard)


def test_nothing_goes_out_before_it_is_active(rig, parameters):
    r = rig(parameters, sim_time=False, active=False)
    heard = r.listen(RANGE, '/y1')
    driver = sensors(r)[0]
    driver.publish(now_(0.25))
    assert r.spin_until(lambda: r.taken['/y1_raw'] == 1)
    driver.publish(now_(0.5))
    time.sleep(0.02)
    r.replacer.activate()  # what came before is old
    driver.publish(now_(0.75))
    assert r.spin_until(lambda: len(heard) >= 1)
    assert r.values(heard)[-1] == 0.75 and 0.25 not in r.values(heard)
    r.replacer.deactivate()
    driver.publish(now_(1.0))
    assert r.spin_until(lambda: r.taken['/y1_raw'] == 4)
    assert 1.0 not in r.values(heard)
