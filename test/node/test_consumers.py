"""
What others make of the isolation topic: diagnostic_aggregator, and ros2_medkit's bridge.

Neither is installed here. The rules are theirs, as read in their sources: ros/diagnostics
(aggregator, generic_analyzer, status_item) and selfpatch/ros2_medkit (diagnostic_bridge_node,
fault_reporter), branches for Jazzy.
"""

from pathlib import Path
import re

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rclpy.serialization import deserialize_message
import yaml

from vsensor_ros.isolator.shape import BIAS
from vsensor_ros.isolator.verdict import Fault, ISOLATED, MODEL, SUSPECTED, Verdict
from vsensor_ros.node.diagnostics import encode
from vsensor_ros.node.isolator import PERIOD
from vsensor_ros.node.status import PERIOD as PERIOD_OF_REPLACER
from vsensor_ros.node.verdicts import statuses

DOCS = Path(__file__).parents[2] / 'docs'
SENSORS = ('y1', 'y2', 'y3')
NOW = 5 * 10**9
TIMEOUT = 5.0  # s after which an aggregator calls a status stale, by default, by arrival
REPORTS, WINDOW = 3, 10.0  # WARN that the bridge needs within so many s; ERROR passes at once
FAULT = Fault('y2', BIAS, NOW - 10**9, NOW, 0.5, 'rad/s')
VERDICTS = {'healthy': Verdict(NOW), 'isolated': Verdict(NOW, ISOLATED, (FAULT,)),
            'suspected': Verdict(NOW, SUSPECTED, (), (('y1',), ('y3',))),
            'model': Verdict(NOW, MODEL)}


def published(verdict, node='isolator'):
    """Return the message that goes out."""
    return deserialize_message(encode(statuses(verdict, SENSORS, node, 'advise'), NOW),
                               DiagnosticArray)


def matches(analyzer, name):
    """Tell whether a GenericAnalyzer takes a status."""
    return any((name in analyzer.get('expected', []), name in analyzer.get('name', []),
                any(name.startswith(s) for s in analyzer.get('startswith', [])),
                any(s in name for s in analyzer.get('contains', []))))


def fault_code(name):
    """Return what the bridge calls the fault of a status."""
    return re.sub('[^A-Z0-9]+', '_', name.upper()).strip('_')


@pytest.mark.parametrize('verdict', VERDICTS.values(), ids=VERDICTS.keys())
@pytest.mark.parametrize('node', ['isolator', 'robot/left_arm/isolator'])
def test_each_status_is_one_item_of_its_own(verdict, node):
    message = published(verdict, node)
    stamp = message.header.stamp
    assert stamp.sec + stamp.nanosec > 0  # else the aggregator complains
    names = [status.name for status in message.status]
    assert len(set(names)) == len(names) == len(SENSORS) + 1 and all(names)
    # the aggregator puts spaces for slashes, the bridge underscores for all but letters
    assert len({name.replace('/', ' ') for name in names}) == len(names)
    codes = [fault_code(name) for name in names]
    assert len(set(codes)) == len(codes) and all(0 < len(code) <= 64 for code in codes)
    for status in message.status:
        assert status.level in (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
        assert status.message and all(value.key for value in status.values)
        assert '/' not in status.hardware_id  # a bridge may take such a one for a node


@pytest.mark.parametrize('state, faults', [
    ('healthy', {}), ('isolated', {'ISOLATOR_ISOLATOR_Y2': 'ERROR'}),
    ('suspected', {'ISOLATOR_ISOLATOR_Y1': 'WARN', 'ISOLATOR_ISOLATOR_Y3': 'WARN',
                   'ISOLATOR_ISOLATOR': 'WARN'}),
    ('model', {'ISOLATOR_ISOLATOR': 'WARN'})])
def test_the_bridge_makes_faults_of_who_is_faulty_and_of_candidates(state, faults):
    severity = {DiagnosticStatus.WARN: 'WARN', DiagnosticStatus.ERROR: 'ERROR'}
    assert {fault_code(s.name): severity[s.level] for s in published(VERDICTS[state]).status
            if s.level != DiagnosticStatus.OK} == faults


def test_what_does_not_change_is_said_before_it_is_stale_and_often_enough_for_a_warning():
    for period in (PERIOD, PERIOD_OF_REPLACER):
        assert 2 * period < TIMEOUT  # one may be lost
        assert REPORTS * period < WINDOW


def test_the_analyzers_of_the_documentation_take_all_that_is_said():
    text = (DOCS / 'isolator.md').read_text()
    example = next(block for block in re.findall('```yaml\n(.*?)```', text, re.S)
                   if 'GenericAnalyzer' in block)
    analyzers = yaml.safe_load(example)['analyzers']['ros__parameters']
    group = next(a for a in analyzers.values() if isinstance(a, dict))
    names = [status.name for status in published(VERDICTS['healthy']).status]
    assert group['type'] == 'diagnostic_aggregator/GenericAnalyzer' and group['path']
    assert all(matches(group, name) for name in names)
    assert set(group['expected']) <= set(names)  # else it is missing, which is an error
    assert not matches(group, 'replacer: the loop')
    assert group['timeout'] == TIMEOUT and group['num_items'] == len(names)
