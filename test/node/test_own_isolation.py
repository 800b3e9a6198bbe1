"""Nobody says which sensor failed: the node's own isolator finds it."""

import json
from pathlib import Path
import sys

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Range
from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from vsensor_ros import design, Plant
from vsensor_ros.engine.isolation import from_statuses
from vsensor_ros.engine.isolation_names import Names
from vsensor_ros.node.lifecycle import ISOLATOR

sys.path.append(str(Path(__file__).parent))
from managed_rig import KEPT, machines, told

SENSORS = ('y1', 'y2', 'y3')
BEST = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
AT_REST = {'y1': 1.5, 'y2': 3.0, 'y3': 4.5}


@pytest.fixture(scope='module')
def isolating(tmp_path_factory):
    """Return the file of a design that tells of each of three sensors of x' = -x + u1."""
    plant = Plant.from_matrices([[-1.0]], [[1.0]], [[1.0], [2.0], [3.0]], states=['x'],
                                inputs=['u1'], sensors=list(SENSORS), noise=[0.01] * 3)
    path = tmp_path_factory.mktemp('design') / 'three.json'
    design(plant, isolate=True).save(path)
    return path


@pytest.fixture
def machine(parameters):
    yield from machines(parameters)


def drive(m):
    """Let the drivers publish what a dict says, which may change; return it."""
    values = dict(AT_REST)
    drivers = {name: m.engineer.create_publisher(Range, f'/{name}_raw', 10) for name in SENSORS}
    command = m.engineer.create_publisher(Float64, '/u1', 10)

    def send():
        now = m.engineer.get_clock().now().to_msg()
        for name, driver in drivers.items():
            message = Range(range=values[name])
            message.header.stamp = now
            driver.publish(message)
        command.publish(Float64(data=1.5))
    m.engineer.create_timer(0.02, send)
    return values


def start(machine, path, mode, **more):
    """Start a node; return it, what its drivers say, and what it says."""
    m = machine(design_file=str(path), isolator__mode=mode, **more)
    values = drive(m)
    heard = {topic: m.listen(DiagnosticArray, f'/replacer/{topic}', KEPT)
             for topic in ('isolation', 'status')}
    heard['y2'] = m.listen(Range, '/y2')
    assert m.spin_until(lambda: is_level(heard, DiagnosticStatus.OK) and heard['y2'])
    # a start is no fault: the observers have forgotten theirs
    residual = 'the residuals run'
    assert m.spin_until(lambda: m.node.replacer.engine._own._isolator.watch.running().all()), \
        residual
    return m, values, heard


def is_level(heard, level):
    return told(heard['isolation'], 'replacer: isolator: y2')[0] == level


def status(heard, key):
    return told(heard['status'], 'y2')[2].get(key)


def test_who_fails_is_found_and_replaced_until_it_is_cleared(machine, isolating, tmp_path):
    record = tmp_path / 'record.json'
    m, values, heard = start(machine, isolating, 'act', isolator__record=str(record))
    values['y2'] = 4.0
    assert m.spin_until(lambda: is_level(heard, DiagnosticStatus.ERROR))
    level, message, facts = told(heard['isolation'], 'replacer: isolator: y2')
    assert message.startswith('y2: ') and 'began about' in message
    assert facts['kind'] in ('bias', 'drift', 'unknown')
    assert m.spin_until(lambda: status(heard, 'source') == 'virtual')
    assert status(heard, 'isolated_by') == 'isolator'
    assert m.spin_until(lambda: heard['y2'][-1].range == pytest.approx(3.0, abs=0.05))
    # others say so, too, and take it back: each speaks for itself
    m.isolate('y2')
    assert m.spin_until(lambda: status(heard, 'isolated_by') == 'isolation isolator')
    m.isolate('')
    assert m.spin_until(lambda: status(heard, 'isolated_by') == 'isolator')
    assert status(heard, 'source') == 'virtual'
    # a replacer on that topic understands it
    said = from_statuses(((s.name, s.level, s.hardware_id) for s in heard['isolation'][-1].status),
                         Names.of(SENSORS), shared=False)
    assert {sensor: faulty for (sensor, _), faulty in said.faulty.items()} == {
        'y1': False, 'y2': True, 'y3': False}
    assert not said.problems and not said.strangers
    values['y2'] = 3.0
    count = len(heard['status'])
    assert m.spin_until(lambda: abs(float(status(heard, 'residual'))) < 0.1
                        and len(heard['status']) > count + 1)  # what was wrong has been judged
    assert m.call(Trigger, 'y2/clear').success
    assert m.spin_until(lambda: status(heard, 'source') == 'real')
    assert m.end() == 0
    assert json.loads(record.read_text())['sensors'] == list(SENSORS)


def shows_sizes(m, values, topic):
    """Assert that a bias of y2 comes to be known among the estimates."""
    heard = m.listen(DiagnosticArray, topic, BEST)

    def size(name):
        return next((float(v.value) for message in reversed(heard) for s in message.status
                     if s.name == f'fault.{name}' for v in s.values if v.key == 'value'), None)
    assert m.spin_until(lambda: size('y2') == pytest.approx(0.0, abs=0.05))
    values['y2'] = 4.0
    assert m.spin_until(lambda: size('y2') == pytest.approx(1.0, abs=0.05))
    statuses = {s.name: s for message in heard for s in message.status}
    assert {name for name in statuses if name.startswith('fault.')} == {
        'fault.y1', 'fault.y2', 'fault.y3', 'fault.u1'}
    assert statuses['fault.y2'].message == 'virtual sensor'
    assert [v.key for v in statuses['fault.u1'].values] == ['value', 'deviation']


def test_how_large_a_fault_is_stands_among_the_estimates(machine, isolating):
    m, values, _ = start(machine, isolating, 'advise', isolator__record='none')
    shows_sizes(m, values, '/replacer/estimates')


def test_a_node_that_only_isolates_tells_how_large_a_fault_is(machine, isolating):
    m = machine(role=ISOLATOR, design_file=str(isolating), isolator__record='none')
    values = drive(m)
    shows_sizes(m, values, '/isolator/estimates')


def test_advice_changes_nothing_of_what_goes_out(machine, isolating):
    m, values, heard = start(machine, isolating, 'advise', isolator__record='none')
    values['y2'] = 4.0
    assert m.spin_until(lambda: is_level(heard, DiagnosticStatus.ERROR))
    count = len(heard['y2'])
    assert m.spin_until(lambda: len(heard['y2']) > count + 5)
    assert heard['y2'][-1].range == 4.0 and status(heard, 'source') == 'real'
    assert status(heard, 'isolated_by') == ''


def test_a_record_that_cannot_be_used_is_left_as_it_is(machine, isolating, tmp_path, capfd):
    record = tmp_path / 'record.json'
    record.write_text('{"format": 3}')
    m, *_ = start(machine, isolating, 'advise', isolator__record=str(record))
    m.end()
    assert record.read_text() == '{"format": 3}'
    assert f'{record}: format' in capfd.readouterr().err


def test_a_design_without_residuals_cannot_act(machine, parameters, capfd):
    m = machine(isolator__mode='act', autostart=False)
    assert m.change('configure') == (False, 'unconfigured')
    assert m.spin_until(lambda: 'design with designer --isolate' in capfd.readouterr().err)


def test_a_node_that_only_isolates_tells_a_replacer(machine, isolating, tmp_path):
    """It speaks in nobody's place, and a replacer that isolates nobody itself heeds it."""
    record = tmp_path / 'record.json'
    alone = machine(role=ISOLATOR, design_file=str(isolating), isolator__mode='off',
                    isolator__record=str(record))
    m = machine(design_file=str(isolating), isolator__mode='off',
                isolation__topic='/isolator/isolation',
                isolation__type='diagnostic_msgs/msg/DiagnosticArray')
    values = drive(m)
    heard = {'isolation': m.listen(DiagnosticArray, '/isolator/isolation', KEPT),
             'status': m.listen(DiagnosticArray, '/replacer/status', KEPT),
             'y2': m.listen(Range, '/y2')}
    assert m.spin_until(lambda: heard['y2'] and status(heard, 'source') == 'real')
    assert m.spin_until(
        lambda: alone.node.replacer.engine._own._isolator.watch.running().all())
    assert m.engineer.count_publishers('/y2') == 1
    values['y2'] = 4.0
    assert m.spin_until(lambda: status(heard, 'source') == 'virtual')
    assert status(heard, 'isolated_by') == 'isolation'
    level, message, _ = told(heard['isolation'], 'isolator: isolator: y2')
    assert level == DiagnosticStatus.ERROR and message.startswith('y2: ')
    values['y2'] = 3.0
    assert m.spin_until(lambda: heard['y2'][-1].range == pytest.approx(3.0, abs=0.05))
    assert alone.call(Trigger, 'y2/clear').success
    assert m.spin_until(lambda: told(
        heard['isolation'], 'isolator: isolator: y2')[0] == DiagnosticStatus.OK)
    assert alone.end() == 0 and json.loads(record.read_text())['sensors'] == list(SENSORS)


def test_a_node_that_only_isolates_may_listen_where_the_sensors_go_out(machine, isolating):
    m = machine(role=ISOLATOR, design_file=str(isolating), isolator__record='none',
                **{f'sensors__{name}__input': f'/{name}' for name in SENSORS})
    drivers = [m.engineer.create_publisher(Range, f'/{name}', 10) for name in SENSORS]
    heard = m.listen(DiagnosticArray, '/isolator/isolation', KEPT)
    # what does not change is said again: else an aggregator would call it stale
    assert m.spin_until(lambda: len(heard) > 2)
    assert all(m.engineer.count_publishers(driver.topic_name) == 1 for driver in drivers)


def test_a_node_that_only_isolates_needs_residuals(machine, capfd):
    m = machine(role=ISOLATOR, autostart=False)
    assert m.change('configure') == (False, 'unconfigured')
    assert m.spin_until(lambda: 'design with designer --isolate' in capfd.readouterr().err)
