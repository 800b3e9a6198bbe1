"""An encoder beside a tacho, on topics: lost 3 s after the start, it is replaced for a time."""

import numpy as np
from sensor_msgs.msg import Range

from vsensor_ros.node.accessor import get_stamp
from vsensor_ros.node.cdr import decode
from vsensor_ros.observers import Design

LOST, LIMIT = 300, 0.0009  # readings; rad


def test_it_is_served_as_surely_as_stated_counts_down_and_ends(rig, bench, tmp_path):
    path = tmp_path / 'joint.json'
    entry = bench.encoder(rate=100.0, names=('y1', 'y2'))
    Design('joint', '0' * 64, ('x1',), (), ('y1', 'y2'), {}, None,
           {(('y1',), 'y1'): entry}).save(path)
    given = {'design_file': str(path), 'rate': 100.0, 'time_constant': 0.05,
             'recovery.dwell': 0.0, 'sensors.y1.max_deviation': LIMIT, 'sensors.y1.guard': 0.2}
    for name in ('y1', 'y2'):
        given.update({f'sensors.{name}.topic': f'/{name}', f'sensors.{name}.field': 'range',
                      f'sensors.{name}.type': 'sensor_msgs/msg/Range'})
    r = rig(given)
    x, said = bench.joint(6.0, 3, 100.0)
    heard, begin, k = r.listen('sensor_msgs/msg/Range', '/y1'), r.now, 0

    def go_on(periods, angle=None):
        nonlocal k
        for _ in range(periods):
            k += 1
            r.step(*((f'/{name}_raw', r.reading(value)) for name, value in (
                ('y1', said[k, 0] if angle is None else angle), ('y2', said[k, 1]))))
    go_on(LOST)
    r.spin_until(lambda: len(heard) >= LOST)
    horizon = r.told()['y1'].remaining_s
    assert 0.5 < horizon < 2.0
    r.isolate('y1')
    served = []  # (since when, how long yet)
    while 'served its time' not in r.told()['y1'].reason:
        go_on(10, 99.0)  # it goes on sending what is wrong
        y1 = r.told()['y1']
        if y1.source == 'virtual':
            served.append((0.01 * (k - LOST), y1.remaining_s))
        assert k < 600
    for since, left in served:
        assert abs(since + left - horizon) < 0.2
    assert abs(served[-1][0] - horizon) < 0.3
    messages = [decode(Range, raw) for raw in heard[LOST:]]
    at = [round((get_stamp(m) - begin) / 1e7) for m in messages]
    errors = np.array([m.range for m in messages]) - x[at, 0]
    assert len(errors) >= 100 * served[-1][0]
    assert (np.abs(errors[20:]) <= 2 * LIMIT).all()  # the offset of the switch has died out
    assert np.abs(np.diff(errors)).max() < 4 * 0.0005
    assert r.told()['y1'].source == 'none'
    sent = len(heard)
    go_on(20, 99.0)
    assert len(heard) == sent
    r.isolate()
    go_on(5)
    assert r.spin_until(lambda: len(heard) >= sent + 4) and r.told()['y1'].source == 'real'
