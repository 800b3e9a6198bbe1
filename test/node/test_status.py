from pathlib import Path
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from sensor_msgs.msg import Range
from std_srvs.srv import SetBool

from vsensor_ros.node import status
from vsensor_ros.node.graph import Complaint

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, machines

KEYS = {'source', 'valid', 'fault_set', 'grade', 'value', 'unit', 'deviation', 'offset',
        'switches', 'last_step', 'virtual_s', 'since_s', 'forced', 'isolated_s', 'isolated_by',
        'recovering_s', 'residual', 'low', 'high', 'outside_region', 'outside_domain', 'restarts',
        'readings_hz', 'not_used', 'reason', 'reserve', 'reserve_reason', 'reserve_worth',
        'reserve_deviation', 'reserve_mean', 'reserve_rms', 'reserve_worst', 'reserve_within',
        'reserve_compared_s', 'remaining_s'}
NODE_KEYS = {'state', 'rate', 'achieved', 'step_p50', 'step_p99', 'step_max', 'jitter_p99',
             'overruns', 'ticks', 'estimates', 'starts', 'faulty', 'not_used'}


@pytest.fixture
def machine(parameters):
    yield from machines(parameters)


def by_name(array):
    """Return the statuses of a message, their values as a dict in place of the list."""
    return {s.name: (s, {v.key: v.value for v in s.values}) for s in array.status}


def facts(array, name):
    return by_name(array)[name][1]


def is_source(heard, name, source):
    return bool(heard) and name in by_name(heard[-1]) and \
        facts(heard[-1], name).get('source') == source


def test_who_joins_late_sees_it_at_once_and_then_each_change(machine):
    m = machine(recovery__dwell=0.0)
    m.drive()
    early = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: is_source(early, 'y2', 'real'))
    m.isolate('y2')
    assert m.spin_until(lambda: is_source(early, 'y2', 'virtual'))
    for _ in range(10):  # if a new one falls just then, once more
        count = len(early)
        late = m.listen(DiagnosticArray, '/replacer/status', KEPT)
        assert m.spin_until(lambda late=late: late)
        if late[0] == early[count - 1]:  # what was said before
            break
    assert late[0] == early[count - 1]

    assert [s.name for s in late[0].status] == ['y1', 'y2', 'y3', 'replacer']
    assert all(set(facts(late[0], name)) == KEYS for name in ('y1', 'y2', 'y3'))
    assert set(facts(late[0], 'replacer')) >= NODE_KEYS
    assert facts(late[0], 'replacer')['state'] == 'active'
    assert facts(late[0], 'replacer')['faulty'] == 'y2'
    y2 = facts(late[0], 'y2')
    assert y2['valid'] == 'true' and y2['fault_set'] == 'y2' and y2['grade'] == 'exact'
    assert float(y2['value']) == 3.0 and y2['switches'] == '1'  # y2 is twice y1, at rest
    assert abs(float(y2['last_step'])) < 1e-9
    assert by_name(late[0])['y2'][0].level == DiagnosticStatus.WARN
    m.isolate('')
    assert m.spin_until(lambda: is_source(late, 'y2', 'real'))
    m.isolate('y2 y3')  # which has no design
    assert m.spin_until(lambda: is_source(late, 'y3', 'none'))
    assert facts(late[-1], 'y3')['valid'] == 'false'
    assert by_name(late[-1])['y3'][0].level == DiagnosticStatus.ERROR
    # and without a change about once a second
    count, begin = len(late), late[-1].header.stamp.sec
    m.node.replacer.reports.thrown_away = 5
    assert m.spin_until(lambda: len(late) == count + 2)
    assert 1 <= late[-1].header.stamp.sec - begin <= 30
    loop = by_name(late[-1])['replacer'][0]
    assert loop.level == DiagnosticStatus.WARN and '5 messages of isolation thrown' in loop.message


def test_a_switch_is_reported_once_it_is_counted(machine, monkeypatch):
    monkeypatch.setattr(status, 'PERIOD', 3600.0)  # on change only
    m = machine(recovery__dwell=0.0)
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: is_source(heard, 'y2', 'real'))
    for names, source, count in (('y2', 'virtual', '1'), ('', 'real', '2')):
        m.spin(2 * status.SOONEST)  # so that the change is told at once, before it is counted
        m.isolate(names)
        assert m.spin_until(lambda source=source, count=count: is_source(heard, 'y2', source)
                            and facts(heard[-1], 'y2')['switches'] == count)


def test_the_diagnostics_name_the_remedy(machine):
    m = machine()
    m.drive()
    heard = m.listen(DiagnosticArray, '/diagnostics')
    assert m.spin_until(lambda: is_source(heard, 'replacer: y2', 'real'))
    m.isolate('y2')
    assert m.spin_until(lambda: is_source(heard, 'replacer: y2', 'virtual'))
    report, values = by_name(heard[-1])['replacer: y2']
    assert report.message.startswith('virtual (isolated), from y1')
    assert report.message.endswith('; repair y2') and report.hardware_id == '/y2'
    assert values['grade'] == 'exact' and values['faulty sensors'] == 'y2'
    assert by_name(heard[-1])['replacer: the loop'][0].message.startswith('active')


def test_when_it_is_not_active_the_last_word_says_so(machine):
    m = machine()
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: is_source(heard, 'y1', 'real'))
    m.change('deactivate')
    late = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: late)
    assert [s.name for s in late[0].status] == ['replacer']
    assert facts(late[0], 'replacer')['state'] == 'inactive'


def test_another_publisher_on_an_output_is_seen_in_status_and_log(machine, monkeypatch):
    monkeypatch.setattr(status, 'LOOK', 0.1)
    m = machine()
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: is_source(heard, 'y1', 'real'))
    assert by_name(heard[-1])['y1'][0].level == DiagnosticStatus.OK
    m.engineer.create_publisher(Range, '/y1', 10)
    line = '/y1: /engineer publishes there too'
    assert m.spin_until(lambda: line in by_name(heard[-1])['y1'][0].message)
    assert by_name(heard[-1])['y1'][0].level == DiagnosticStatus.WARN
    assert by_name(heard[-1])['y2'][0].level == DiagnosticStatus.OK
    assert m.spin_until(lambda: m.logged(line))
    m.spin(0.5)
    assert len(m.logged(line)) == 1


def test_what_is_wrong_at_one_look_only_is_not_said(machine, monkeypatch):
    m = machine()
    assert m.spin_until(m.node.active.is_set)
    complaint = Complaint('/y1', 'half discovered')
    seen = [{complaint}, set(), {complaint}, {complaint}, {complaint}]
    monkeypatch.setattr(status, 'complaints', lambda *_: seen.pop(0))
    monkeypatch.setattr(status, 'silent_isolation', lambda *_: ())
    for looks in (1, 2, 3):
        m.node.reporter.look_around()
        assert m.node.reporter.found == (), looks
    m.node.reporter.look_around()
    m.node.reporter.look_around()
    assert m.node.reporter.found == (complaint,)
    assert m.spin_until(lambda: m.logged('half discovered'))
    assert len(m.logged('half discovered')) == 1


def test_what_toggles_floods_neither_log_nor_status(machine, monkeypatch):
    monkeypatch.setattr(status, 'PERIOD', 3600.0)  # on change only
    m = machine(recovery__dwell=0.0)
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: is_source(heard, 'y1', 'real'))
    assert m.spin_until(lambda: m.node.replacer.engine._bank.ready(('y1',), 'y1'))
    heard.clear()
    m.log.clear()
    begin = time.monotonic()
    for i in range(40):
        assert m.call(SetBool, 'y1/force', data=i % 2 == 0).success
        assert m.spin_until(  # until it has gone out
            lambda i=i: m.node.replacer.snapshot().channels[0].switches == i + 1)
        m.spin(0.02 + 0.01 * (i % 7))  # and may be seen, in step with no period of reports

    def lines():
        return [line for line in m.logged('y1: ') if 'asked' not in line
                and 'y1: not sent on' not in line]  # which has a rate of its own
    assert m.spin_until(lines)
    lasted = time.monotonic() - begin
    assert len(heard) <= lasted / status.SOONEST + 2
    assert len(lines()) <= 2 * (lasted // status.QUIET + 1)
    assert m.spin_until(lambda: 'switched' in by_name(heard[-1])['y1'][0].message)
    assert 'lengthen sensors.y1.dwell' in by_name(heard[-1])['y1'][0].message
    # the last word is right, though it may not be said at once
    m.spin(2 * status.SOONEST)
    m.call(SetBool, 'y1/force', data=True)
    assert m.spin_until(lambda: is_source(heard, 'y1', 'virtual'))
    m.call(SetBool, 'y1/force', data=False)
    assert m.spin_until(lambda: is_source(heard, 'y1', 'real'))
