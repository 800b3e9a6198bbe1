from pathlib import Path
import sys
from threading import current_thread, Event
import time

from lifecycle_msgs.srv import GetState
import pytest
from rcl_interfaces.srv import SetParameters
from rclpy import executors
from rclpy.parameter import Parameter
from sensor_msgs.msg import Range
from std_srvs.srv import Trigger

sys.path.append(str(Path(__file__).parent))
from managed_rig import machines


@pytest.fixture
def machine(parameters):
    yield from machines(parameters)


def topics(m):
    return {name for name, _ in m.node.get_publisher_names_and_types_by_node('replacer', '/')}


def set_parameter(m, name, value):
    response = m.call(SetParameters, 'set_parameters',
                      parameters=[Parameter(name, value=value).to_parameter_msg()])
    return response.results[0]


def falls_silent(m, heard):
    """Tell whether nothing more comes, once what was on its way has come."""
    for _ in range(20):
        heard.clear()
        m.spin(0.2)
        if not heard:
            return True
    return False


def test_a_manager_takes_it_through_its_states_twice(machine):
    m = machine(autostart=False)
    m.drive()
    heard = m.listen(Range, '/y1')
    assert '/y1' not in topics(m)
    # what there is not is refused, and the node goes on
    assert m.change('activate') == (False, 'unconfigured')
    assert m.change('dance') == (False, 'unconfigured')
    for _ in range(2):
        assert m.change('configure') == (True, 'inactive')
        assert '/y1' in topics(m)
        assert falls_silent(m, heard)
        assert m.change('configure') == (False, 'inactive')
        assert m.change('activate') == (True, 'active')
        assert m.spin_until(lambda: len(heard) > 5)
        assert {message.range for message in heard} == {1.5}
        assert m.change('deactivate') == (True, 'inactive')
        assert falls_silent(m, heard)
        assert m.change('activate') == (True, 'active')
        assert m.spin_until(lambda: heard)
        assert m.call(Trigger, 'reset').success
        assert m.change('deactivate') == (True, 'inactive')
        assert m.change('cleanup') == (True, 'unconfigured')
        assert '/y1' not in topics(m) and '/replacer/status' not in topics(m)
    assert m.change('shutdown') == (True, 'finalized')
    assert m.end() == 0


def test_illegal_parameters_fail_the_transition_with_the_reasons_in_the_log(machine):
    m = machine(autostart=False, rate=0.0, colour='red')
    assert m.change('configure') == (False, 'unconfigured')
    assert m.spin_until(lambda: len(m.logged('/replacer: ')) == 2)
    assert m.logged('/replacer: rate: 0 is out of range; choose from 0.001 to 1000')
    assert m.logged('/replacer: colour: there is no such parameter')
    assert '/y1' not in topics(m)
    m.node.undeclare_parameter('colour')
    assert set_parameter(m, 'rate', 100.0).successful
    assert m.change('configure') == (True, 'inactive')
    m.change('activate')
    result = set_parameter(m, 'recovery.dwell', -1.0)
    assert not result.successful and 'recovery.dwell' in result.reason
    assert set_parameter(m, 'recovery.dwell', 7.0).successful
    assert m.node.replacer.policies['y1'].dwell == 7.0


@pytest.mark.parametrize('error, told', [
    (KeyError('surprise'), "KeyError: 'surprise'"),
    (RuntimeError('no permission, at rmw.c:1'), '/replacer: topics: no permission; give the')])
@pytest.mark.parametrize('where', ['vsensor_ros.node.lifecycle.ManagedNode.create_service',
                                   'vsensor_ros.node.replacer.Estimates'])
def test_what_goes_wrong_while_opening_leaves_nothing_open(machine, monkeypatch, where, error,
                                                           told):
    def fail(*_):
        raise error
    m = machine(autostart=False)
    opened = m.node._entities()
    with monkeypatch.context() as patch:
        patch.setattr(where, fail)
        assert m.change('configure') == (False, 'unconfigured')
    assert m.spin_until(lambda: m.logged(told))
    assert m.node._entities() == opened
    assert m.change('configure') == (True, 'inactive')
    assert m.change('activate') == (True, 'active')


def test_a_callback_that_raises_ends_nothing_else(machine):
    m = machine()
    m.drive()
    heard = m.listen(Range, '/y1')

    def broken():
        raise ZeroDivisionError('broken')
    m.node.create_timer(0.001, broken)
    assert m.spin_until(lambda: m.logged('ZeroDivisionError'))
    assert m.change('activate') == (False, 'active')
    assert m.spin_until(lambda: heard)
    m.spin(0.1)
    assert len(m.logged('ZeroDivisionError')) == 1


def test_it_ends_in_order_from_every_state(machine):
    m = machine()
    assert m.spin_until(m.node.active.is_set)
    assert m.end() == 0 and m.node.ended
    # nothing keeps it alive; what other tests have killed is forgotten a little later
    assert m.spin_until(lambda: m.engineer.get_node_names() == ['engineer'])
    m = machine(autostart=False)
    assert m.end() == 0 and m.node.ended


def test_it_ends_when_the_executor_is_just_about_to_wait(machine, monkeypatch):
    m = machine(autostart=False)  # no timer wakes it
    about, gather = Event(), executors.NumberOfEntities

    def gather_slowly(*numbers):
        """Take so long between the last look whether to go on and the wait that it is told to."""
        if current_thread().name == 'executor':
            about.set()
            time.sleep(0.5)
        return gather(*numbers)
    monkeypatch.setattr(executors, 'NumberOfEntities', gather_slowly)
    m.call(GetState, 'get_state')
    assert about.wait(60.0)
    assert m.end() == 0
