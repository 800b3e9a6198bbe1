"""From activation to the first message: nothing that failed goes out as real."""

from functools import partial
from pathlib import Path
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
import pytest
from sensor_msgs.msg import Range

from vsensor_ros.node import start
from vsensor_ros.node.accessor import put_stamp

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, machines

RANGE = 'sensor_msgs/msg/Range'


class Isolation:
    """What the start asks of the isolation topic."""

    topic = '/isolation'
    heard = known = False


@pytest.fixture
def machine(parameters):
    yield from machines(parameters)


@pytest.fixture
def waiting(monkeypatch):
    """Return a start that waits, what it asks, what it says, and its clock."""
    clock, told, says = [100.0], Isolation(), []
    monkeypatch.setattr(start.time, 'monotonic', lambda: clock[0])
    told.reading = False
    begun = start.Start(told, lambda: told.reading, says.append)
    begun.begin()
    return begun, told, says, clock


def test_it_waits_for_the_history_of_who_is_there(waiting):
    begun, told, says, clock = waiting
    clock[0] += 3600.0  # no driver, so nothing to be sent
    assert not begun.is_over() and not begun.waits
    told.reading = True
    assert not begun.is_over() and begun.waits
    clock[0] += start.DISCOVERY + 0.1
    assert not begun.is_over()
    told.known = True
    assert begun.is_over() and not begun.waits and not begun.is_over() and not says
    begun.begin()  # activated again
    assert begun.is_over()


def test_it_waits_for_who_is_found_a_little_later(waiting):
    begun, told, _, clock = waiting
    told.heard = told.known = True  # and no driver: what stands in for it needs none
    assert not begun.is_over()
    clock[0] += start.DISCOVERY - 0.1
    assert not begun.is_over()
    clock[0] += 0.2
    assert begun.is_over()


def test_it_does_not_wait_for_ever(waiting):
    begun, told, says, clock = waiting
    told.reading = True
    assert not begun.is_over()
    clock[0] += start.LONGEST - 0.1
    assert not begun.is_over() and not says
    clock[0] += 0.2
    assert begun.is_over()
    (line,) = says
    assert '/isolation: a publisher there keeps what it said' in line
    begun.begin()
    clock[0] += 0.1
    assert not begun.is_over()
    begun.end()
    assert not begun.is_over() and not begun.waits


def test_a_failed_reading_does_not_go_out_before_the_history_is_heard(machine, monkeypatch):
    monkeypatch.setattr(start, 'LONGEST', 3600.0)  # the machine may be busy
    m = machine(autostart=False)
    m.drive()
    heard = m.listen(Range, '/y2')
    told = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    m.isolate('y2 y3')  # which has no design
    assert m.change('configure') == (True, 'inactive')
    replacer = m.node.replacer
    late, replacer.reports._late = replacer.reports._late, None

    class Slow:
        """The transient-local subscription, to which nothing has come yet."""

        handle = type('Nothing', (), {'take_message': staticmethod(lambda *_: None)})
        msg_type = late.msg_type
        get_publisher_count = staticmethod(lambda: 1)
    replacer.reports._late = Slow
    assert m.change('activate') == (True, 'active')
    assert m.spin_until(lambda: replacer.snapshot().channels[1].readings > 0)
    states = [{v.key: v.value for v in s.values}['state'] for array in told
              for s in array.status if s.name == 'replacer']
    assert states[-1] == 'starting' and len(told[-1].status) == 1 and not heard
    replacer.reports._late = late
    assert m.spin_until(lambda: not replacer.start.waits)
    m.spin(0.1)
    assert not heard and replacer.snapshot().faulty == ('y2', 'y3')


def test_what_isolation_said_is_known_when_as_many_have_spoken_as_keep_it(rig, parameters):
    r = rig(parameters, active=False)
    assert r.replacer.reports.known  # nobody is there
    first, second = (r.node.create_publisher(DiagnosticArray, '/isolation', KEPT)
                     for _ in range(2))
    late = r.replacer.reports._late
    assert r.spin_until(lambda: late.get_publisher_count() == 2)
    assert not r.replacer.reports.known
    first.publish(DiagnosticArray())
    assert r.spin_until(lambda: r.replacer.reports.heard) and not r.replacer.reports.known
    second.publish(DiagnosticArray())
    assert r.spin_until(lambda: r.replacer.reports.known)


def test_what_passed_while_it_was_inactive_is_neither_jump_nor_overrun(
        rig, parameters, monkeypatch):
    rest = 0
    monkeypatch.setattr('vsensor_ros.node.replacer.time.time_ns',
                        lambda: time.clock_gettime_ns(time.CLOCK_REALTIME) + rest)
    monkeypatch.setattr('vsensor_ros.node.pace.time.perf_counter_ns',
                        lambda: time.monotonic_ns() + rest)
    r = rig(parameters, sim_time=False)
    heard = r.listen(RANGE, '/y2')
    drivers = [(r.publisher(Range, f'/y{i}_raw'), value) for i, value in ((1, 0.75), (2, 1.5))]

    def drive(until):
        """Send readings till something holds; tell whether it came to that."""
        end = time.monotonic() + 60.0
        while not until() and time.monotonic() < end:
            for publisher, value in drivers:
                message = r.reading(value)
                put_stamp(message, time.clock_gettime_ns(time.CLOCK_REALTIME) + rest)
                publisher.publish(message)
            r.spin(0.01)
        return until()

    started = partial(r.replacer.engine._bank.started, ('y2',), 'y2')
    assert drive(lambda: started() is not None and len(heard) > 5)
    r.isolate('y2')
    assert drive(lambda: r.replacer.snapshot().estimates > 5)
    r.replacer.deactivate()
    before, overruns = len(heard), r.replacer.snapshot().left_out
    stamp = r.stamps(heard)[-1]
    rest = 60 * 10**9
    r.replacer.activate()
    assert len(heard) == before
    assert drive(lambda: len(heard) > before + 10)
    health = r.replacer.snapshot()
    assert health.left_out - overruns < 1000 and not health.jumps
    assert started() > stamp + 59 * 10**9 and r.values(heard)[-1] == 1.5
    assert r.stamps(heard)[before] > stamp + 59 * 10**9
    assert r.replacer.health().achieved > 1.0  # one interval of 60 s would make it less
