"""What users of other failover code complain of, shown at the topic: see docs/complaints.md."""

from dataclasses import replace
import math
import time

import numpy as np
from sensor_msgs.msg import Range

from vsensor_ros.node.accessor import put_stamp
from vsensor_ros.node.cdr import decode
from vsensor_ros.node.known import GENERAL

RANGE = 'sensor_msgs/msg/Range'
SECOND = 10**9


def test_a_candidate_that_was_never_compared_is_not_taken_for_perfect(rig, parameters):
    r = rig(parameters)
    heard = r.listen(RANGE, '/y2')
    y1, y2, _ = r.healthy()
    r.step(y2, periods=2)
    r.isolate('y2')
    r.step(y2, periods=5)
    told = r.told()
    assert told['y2'].source == 'none' and 'no reading of y1 yet' in told['y2'].reason
    assert told['y3'].source == 'silent'  # of which nothing bad was ever heard, nor anything
    r.step(y1, y2, periods=5)
    told = r.told()['y2']
    assert told.source == 'virtual' and r.values(heard)[-1] == 1.0
    assert told.deviation == math.inf  # no residual says nothing: not 0, nor the best
    assert decode(Range, heard[-1]).variance == 0.0  # by which the type says that it is not known
    count = len(heard)
    limits = dict.fromkeys(('y1', 'y2', 'y3'), 1e9)
    r.replacer.apply(replace(r.replacer.settings.live, max_deviation=limits))
    r.step(y1, y2, periods=5)
    assert r.told()['y2'].source == 'none' and len(heard) == count


def test_quantised_and_constant_readings_are_no_fault(rig, parameters):
    r = rig({**parameters, 'silent_sensor': 'replace', 'max_age': 0.1})
    heard = [r.listen(RANGE, f'/y{i}') for i in (1, 2, 3)]
    for i in range(60):
        r.step(*r.healthy(y1=0.5, y2=round(0.01 * i), y3=0.0))
    assert r.spin_until(lambda: all(len(h) == 60 for h in heard))
    for i, h in enumerate(heard, 1):
        assert [bytes(raw) for raw in h] == r.sent[f'/y{i}_raw']
    assert all((c.source, c.switches) == ('real', 0) for c in r.told().values())
    r.step(*r.healthy()[:2], periods=12)  # what does count is that nothing arrives
    told = r.told()
    assert told['y3'].source == 'none' and told['y1'].source == told['y2'].source == 'real'


def test_bad_stamps_are_counted_by_reason_and_fail_nobody(rig, parameters):
    r = rig({**parameters, 'silent_sensor': 'replace'})
    heard, estimates = r.listen(RANGE, '/y1'), r.listen(RANGE, '/y2')
    r.step(*r.healthy(), periods=5)
    for stamp in (r.now, r.now, r.now - SECOND, r.now - 2 * SECOND, r.now + 3600 * SECOND):
        r.send(stamp, topic='/y1_raw')
    for _ in range(60):  # longer than max_age without a new stamp
        r.step(*r.healthy()[1:])
        r.send(r.now - 3 * SECOND, topic='/y1_raw')
    told = r.told()
    assert told['y1'].counts == {
        'duplicate stamp': 2, 'stamp runs backwards': 62, 'stamp ahead of the clock': 1}
    assert not told['y2'].counts and not told['y3'].counts
    assert told['y1'].source == 'real' and told['y1'].switches == 0
    assert r.spin_until(lambda: len(heard) == 5 + 5 + 60)  # all went on as it came
    # not evaluated is not failed; but nothing is estimated from what cannot be placed in time
    count = len(estimates)
    r.isolate('y2')
    r.step(*r.healthy()[1:], periods=2)
    assert 'y1 speaks, but its stamps are' in r.told()['y2'].reason and len(estimates) == count


def test_a_wall_clock_set_back_while_a_sensor_is_replaced(rig, parameters, monkeypatch):
    away = 0
    monkeypatch.setattr('vsensor_ros.node.replacer.time.time_ns',
                        lambda: time.clock_gettime_ns(time.CLOCK_REALTIME) + away)
    r = rig({**parameters, 'recovery.dwell': 3600.0}, sim_time=False)
    heard = r.listen(RANGE, '/y2')
    y1, y2 = (r.publisher(Range, f'/y{i}_raw') for i in (1, 2))

    def drive(until):
        """Send readings stamped by the same clock, till something holds; tell whether it did."""
        end = time.monotonic() + 60.0
        while not until():
            if time.monotonic() > end:
                return False
            faulty = r.replacer.snapshot().faulty
            for publisher, value in ((y1, 0.75), (y2, 9.0 if faulty else 1.5)):
                message = r.reading(value)
                put_stamp(message, time.clock_gettime_ns(time.CLOCK_REALTIME) + away)
                publisher.publish(message)
            r.spin(0.01)
        return True

    assert drive(lambda: len(heard) > 10)
    r.isolate('y2')
    count = len(heard)
    assert drive(lambda: len(heard) > count + 10)
    count = len(heard)
    away = -300_000_000  # trimmed: it waits for its own time, and nothing steps back
    assert drive(lambda: len(heard) > count + 10)
    assert np.all(np.diff(r.stamps(heard)) > 0)
    r.isolate()
    assert drive(lambda: r.told()['y2'].recovering_s > 0.3)
    before, recovering = r.stamps(heard)[-1], r.told()['y2'].recovering_s
    away = -3600 * SECOND  # set: all starts anew on the time that is
    assert drive(lambda: 'backwards' in r.replacer.snapshot().jumps)
    # neither an hour more nor begun anew
    assert recovering <= r.told()['y2'].recovering_s < recovering + 60.0
    assert drive(lambda: r.stamps(heard)[-1] < before - 3500 * SECOND)
    count = len(heard)
    assert drive(lambda: len(heard) > count + 10)
    assert np.all(np.diff(r.stamps(heard)[count:]) > 0)
    assert r.told()['y2'].source == 'virtual' and 9.0 not in r.values(heard)
    assert r.replacer.snapshot().jumps == {'stood still': 1, 'backwards': 1}


def test_zero_disables_only_what_says_so_and_what_is_not_known_is_nan(rig, parameters):
    for name, known in GENERAL.items():
        if known.type is float:
            assert (known.low == 0.0) == ('0 disables' in known.description), name
            assert known.low >= 0.0, name  # no negative number means anything
    told = rig(parameters).told()['y1']
    assert told.switches == 0
    for value in (told.value, told.last_step, told.since_s, told.recovering_s, told.isolated_s,
                  told.residual):
        assert math.isnan(value)
