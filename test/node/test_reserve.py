"""What will not work on the day of a fault is told before."""

from pathlib import Path
import sys

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from sensor_msgs.msg import Range
from std_msgs.msg import Float64, String

from vsensor_ros.bank import Rehearsal
from vsensor_ros.engine import ChannelState
from vsensor_ros.node import status
from vsensor_ros.node.reserve import Chance, chance, Origin, without_reserve, worth
from vsensor_ros.reason import Reason

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, logged, machines, told

OK, WARN = DiagnosticStatus.OK, DiagnosticStatus.WARN
CONVERGING, REFUSED = Reason.of('converging', seconds=2.3), Reason.of('refused', text='no way')
NO_COMMAND, NO_DESIGN = Reason.of('no command yet', name='u'), Reason.of('no design', failed=())


def either(exact, other):
    return Reason.of('next best', exact=exact, fault_set=('y1', 'y2'), next=other)


@pytest.mark.parametrize('reserve, expected', [
    (None, Chance.SERVES), (CONVERGING, Chance.PASSES), (REFUSED, Chance.NEVER),
    (NO_COMMAND, Chance.MEND), (Reason('of some kind'), Chance.MEND),
    (either(NO_DESIGN, CONVERGING), Chance.PASSES), (either(NO_DESIGN, REFUSED), Chance.NEVER),
    (either(CONVERGING, NO_COMMAND), Chance.PASSES),
    (either(REFUSED, NO_COMMAND), Chance.MEND)])
def test_whether_it_passes(reserve, expected):
    assert chance(reserve) is expected


@pytest.mark.parametrize('publishers, mend', [
    ((), 'nobody publishes on /u: start who does, or correct commands.u.topic'),
    (None, 'start who does, or correct commands.u.topic'),
    (('/nav',), '/nav publishes on /u: check what, and commands.u.field')])
def test_the_mend_names_the_topic_and_who_is_there(publishers, mend):
    origins = {'u': Origin('/u', 'std_msgs/msg/Float64', 'commands.u', publishers)}
    assert without_reserve('y1', NO_COMMAND, origins) == [
        'could not be replaced now (no command of u yet)', mend]
    assert without_reserve('y1', either(NO_COMMAND, NO_COMMAND), origins)[1:] == [mend]
    assert without_reserve('y1', either(CONVERGING, NO_COMMAND), origins)[1:] == []


@pytest.mark.parametrize('publishers, mend', [
    ((), 'check who publishes on /y3_raw'),
    (('/driver',), 'check /driver, which publishes on /y3_raw')])
def test_of_what_was_heard_before_the_parameters_are_right(publishers, mend):
    origins = {'y3': Origin('/y3_raw', 'sensor_msgs/msg/Range', 'sensors.y3', publishers)}
    silent = Reason.of('input silent', name='y3', seconds=2.0)
    assert without_reserve('y1', silent, origins) == [
        'could not be replaced now (y3 silent for 2.0 s)', mend]


@pytest.mark.parametrize('more, words', [
    ({}, 'y2 could be replaced now, to 0.021 rad/s'),
    ({'remaining_s': 12.3}, 'y2 could be replaced now, to 0.021 rad/s, for 12 s'),
    ({'rehearsed': None}, 'y2 could be replaced now, to 0.021 rad/s (not compared with it yet)'),
    ({'serves': object(), 'remaining_s': 12.3}, 'y2 is replaced, to 0.021 rad/s, for 12 s'),
    ({'reserve': CONVERGING}, 'y2 could not be replaced now (converging, 2.3 s more)'),
    ({'reserve': REFUSED}, 'y2 cannot be replaced (no way)')])
def test_what_a_reserve_is_worth_in_words(more, words):
    nan = float('nan')
    rehearsed = Rehearsal(0.0, 0.02, 0.05, 0.019, 0.95, 60.0)
    given = {'reserve': None, 'reserve_deviation': 0.0213, 'rehearsed': rehearsed, **more}
    assert worth(ChannelState(
        'y2', '/y2', 'rad/s', 'real', None, (), '', 1.5, 0.0, None, 0.0, 0, nan, nan, 0.0, False,
        nan, nan, nan, **{'serves': None, **given}, outside_region=False, outside_domain=0,
        restarts=0, counts={}, readings=100)) == words


@pytest.fixture
def machine(parameters, monkeypatch):
    monkeypatch.setattr(status, 'LOOK', 0.1)
    monkeypatch.setattr(status, 'GRACE', 0.5)
    yield from machines(parameters)


@pytest.fixture(name='logged')
def logged_(capfd):
    return logged(capfd)


def drive(m):
    """Publish what the sensors say at 50 Hz, without a command."""
    publishers = [(m.engineer.create_publisher(Range, f'/y{i}_raw', 10), Range(range=value))
                  for i, value in ((1, 1.5), (2, 3.0), (3, 0.0))]

    def send():
        for publisher, message in publishers:
            message.header.stamp = m.engineer.get_clock().now().to_msg()
            publisher.publish(message)
    m.engineer.create_timer(0.02, send)


def test_what_was_meant_is_named(machine):
    """Topics of the right type that somebody publishes on, and that are called much the same."""
    m = machine(isolation__topic='/isolaton')
    drive(m)
    for kind, topic in ((Float64, '/U1'), (Float64, '/robot/u1'), (Range, '/u_1'),
                        (String, '/isolation'), (DiagnosticArray, '/isolation2')):
        m.engineer.create_publisher(kind, topic, 10)
    m.engineer.create_subscription(Float64, '/u11', print, 10)
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(lambda: told(heard, 'replacer')[1].endswith(
        'or correct isolation.topic (to /isolation?)'))
    assert m.spin_until(lambda: told(heard, 'y1')[1].endswith(
        'or correct commands.u1.topic (to /U1 or /robot/u1?)'))


def test_nobody_isolates(machine, logged):
    m = machine()
    drive(m)
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    line = '/isolation: nobody publishes here, so no fault will be heard of; start what finds ' \
        'the faults, or correct isolation.topic'
    assert m.spin_until(lambda: line in told(heard, 'replacer')[1])
    assert told(heard, 'replacer')[0] == WARN and m.spin_until(lambda: logged(line))
    m.isolate('')
    # a busy machine may leave out ticks, which is said, too
    assert m.spin_until(lambda: line not in told(heard, 'replacer')[1])


def test_a_command_that_a_reserve_needs_was_never_heard(machine, logged):
    m = machine()
    m.isolate('')
    drive(m)
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    said = m.listen(DiagnosticArray, '/diagnostics')
    line = 'real; could not be replaced now (no command of u1 yet; that for y1, y2: no command ' \
        'of u1 yet); nobody publishes on /u1: start who does, or correct commands.u1.topic'
    assert m.spin_until(lambda: told(heard, 'y1')[:2] == (WARN, line))
    assert m.spin_until(lambda: told(said, 'replacer: y1')[:2] == (WARN, line))
    assert m.spin_until(lambda: logged('y1: could not be replaced now'))
    y1, y2, y3 = (told(heard, name)[2] for name in ('y1', 'y2', 'y3'))
    assert (y1['reserve'], y2['reserve'], y3['reserve']) == ('not ready', 'ready', 'not ready')
    assert y1['reserve_reason'].startswith('no command of u1 yet') and y2['reserve_reason'] == ''
    # what is known from the design is said, but no warning
    assert y3['reserve_reason'] == 'y3 does not depend on anything else'
    assert told(heard, 'y3')[:2] == (OK, 'real')
    assert told(said, 'replacer: y3')[2]['reserve'] == 'y3 does not depend on anything else'
    assert logged('y3: cannot be replaced (') == 1
    assert told(heard, 'y2')[:2] == (OK, 'real')

    m.isolate('y1')  # and so it is
    assert m.spin_until(lambda: told(heard, 'y1')[2].get('source') == 'none')
    m.isolate('')
    command = m.engineer.create_publisher(Float64, '/u1', 10)  # says nothing
    assert m.spin_until(lambda: '/engineer publishes on /u1: check' in told(heard, 'y1')[1])
    m.engineer.create_timer(0.02, lambda: command.publish(Float64(data=1.5)))
    assert m.spin_until(lambda: told(heard, 'y1')[:2] == (OK, 'real'))
    assert told(heard, 'y1')[2]['reserve'] == 'ready'
    m.isolate('y1')
    assert m.spin_until(lambda: told(heard, 'y1')[2].get('source') == 'virtual')


@pytest.mark.parametrize('topic', ['/isolation', '/diagnostics'])
def test_isolation_that_names_nobody_is_told_and_mended_by_names(machine, topic, logged):
    array = {'isolation__type': 'diagnostic_msgs/msg/DiagnosticArray', 'isolation__topic': topic}
    fault = DiagnosticArray(status=[DiagnosticStatus(
        name='isolator: y2', level=DiagnosticStatus.ERROR)])
    m = machine(**array)
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    isolator = m.engineer.create_publisher(DiagnosticArray, topic, 10)
    m.engineer.create_timer(0.1, lambda: isolator.publish(fault))
    line = f"{topic}: 'isolator: y2' is not a sensor; did you mean y2? If so, add " \
        "'isolator: y2=y2' to isolation.names; if not, 'isolator: y2='"
    assert m.spin_until(lambda: line in told(heard, 'replacer')[1])
    assert told(heard, 'replacer')[0] == WARN and m.spin_until(lambda: logged(line))
    assert m.spin_until(lambda: told(heard, 'y2')[2].get('source') == 'real')
    m.close()

    m = machine(**array, isolation__names=['isolator: *=*'])
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    isolator = m.engineer.create_publisher(DiagnosticArray, topic, 10)
    m.engineer.create_timer(0.1, lambda: isolator.publish(fault))
    assert m.spin_until(lambda: told(heard, 'y2')[2].get('source') == 'virtual')
    assert 'is not a sensor' not in told(heard, 'replacer')[1]


def test_its_own_diagnostics_are_no_isolation(machine):
    m = machine(isolation__topic='/diagnostics', isolation__names=['*: y2=y2'],
                isolation__type='diagnostic_msgs/msg/DiagnosticArray')
    m.drive()
    heard = m.listen(DiagnosticArray, '/replacer/status', KEPT)
    assert m.spin_until(m.node.active.is_set)
    reports = m.node.replacer.reports
    assert m.spin_until(lambda: any(b': y2\0' in raw for _, raw in list(reports._heard)))
    count = len(heard)
    assert m.spin_until(lambda: len(heard) > count + 1)
    assert told(heard, 'replacer')[2]['spoken_of'] == '' and not reports.strangers()
    isolator = m.engineer.create_publisher(DiagnosticArray, '/diagnostics', 10)
    m.engineer.create_timer(0.1, lambda: isolator.publish(DiagnosticArray(status=[
        DiagnosticStatus(name='isolator: y2', level=DiagnosticStatus.ERROR)])))
    assert m.spin_until(lambda: told(heard, 'y2')[2].get('source') == 'virtual')
