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
        for k in range(k + 1, k + periods + 1):
            r.step(*((f'/{name}_raw', r.reading(value)) for name, value in (
                ('y1', said[k, 0] if angle is None else angle), ('y2', said[k, 1]))))
    go_on(LOST)
    r.spin_until(lambda: len(heard) >= LOST)
    horizon = r.told()['y1'].remaining_s
    assert 0.5 < horizon < 2.0
    r.isolate('y1')
    states = []
    while r.told()['y1'].source != 'none' and k < 600:
        go_on(10, 99.0)  # it goes on sending what is wrong
        states.append(r.told()['y1'])
    served = [s for s in states if s.source == 'virtual']
    assert abs(0.1 * len(served) - horizon) < 0.3
    left = np.diff([s.remaining_s for s in served])
    assert ((left > -0.2) & (left < 0.0)).all()
    messages = [decode(Range, raw) for raw in heard[LOST:]]
    at = [round((get_stamp(m) - begin) / 1e7) for m in messages]
    errors = np.array([m.range for m in messages]) - x[at, 0]
    assert len(errors) >= 10 * len(served) - 10
    assert (np.abs(errors[20:]) <= 2 * LIMIT).all()  # the offset of the switch has died out
    assert np.abs(np.diff(errors)).max() < 4 * 0.0005
    assert states[-1].source == 'none' and 'served its time' in states[-1].reason
    sent = len(heard)
    go_on(20, 99.0)
    assert len(heard) == sent
    r.isolate()
    go_on(5)
    assert r.spin_until(lambda: len(heard) >= sent + 4) and r.told()['y1'].source == 'real'
