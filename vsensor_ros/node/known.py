"""The parameters there are: their types, defaults, ranges and meanings, and a value checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor

from vsensor_ros.bad_input import BadInput, shown
from vsensor_ros.bank import GUARD, LONGEST_GUARD
from vsensor_ros.isolator.settings import MODES, RECOVERIES
from vsensor_ros.observers import Design

WITHOUT_ESTIMATE = ('stop', 'hold', 'nan', 'pass')
RECOVERY = ('automatic', 'hold', 'latched')
SILENT = ('wait', 'replace')
AT_END = ('hold', 'invalid')
AUTO, NONE = 'auto', 'none'
REFUSE, USE = DISOWNED = ('refuse', 'use')
DIAGNOSTICS = 'diagnostic_msgs/msg/DiagnosticArray'
TEXT = 'std_msgs/msg/String'
UNITS: Mapping[str, int] = {'s': 10**9, 'ms': 10**6, 'us': 10**3, 'ns': 1}  # of a stamp, in ns
LONGEST_TEXT = 4096  # characters of a value


class Refused(ValueError):
    """Parameters that the replacer cannot start with: one line each problem."""

    def __init__(self, problems: Sequence[BadInput]) -> None:
        super().__init__('\n'.join(str(problem) for problem in problems))
        self.problems = tuple(problems)


@dataclass(frozen=True)
class Known:
    """One parameter there is. A value of '' stands for `general`, where there is one."""

    type: type
    default: Any  # None: must be given
    description: str
    unit: str = ''
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()
    live: bool = False  # may change while the node runs
    general: str = ''  # the parameter for all of its kind that this one overrides
    or_none: bool = False  # 0 stands for none, though it is below `low`
    words: tuple[str, ...] = ()  # that may stand in place of a number

    def check(self, value: Any, where: object, name: str) -> Any:
        """Return the value in its type; raise BadInput when it cannot be used."""
        if value == '' and (self.general or self.words) or value in self.words:
            return value
        if self.words and isinstance(value, str):
            value = _number(value)
        if self.type is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)  # `rate: 100` is as good as 100.0
        give = f'give the {self.description}' + (
            f", or '' for that of all {name.partition('.')[0]}" if self.general else '')
        if self.type is list:
            return _texts(value, where, name, give)
        if value is None:
            raise BadInput(where, name, 'is missing', give)
        if not isinstance(value, self.type) or (self.type is int and isinstance(value, bool)):
            raise BadInput(where, name, f'{value!r:.80} is not {_TYPES[self.type]}', give)
        if isinstance(value, (float, int)) and not self.low <= value <= self.high and not (
                self.or_none and value == 0):
            raise BadInput(where, name, f'{_plain(value)} is out of range',
                           f'choose from {self.limits()}')
        if self.choices and value not in self.choices:
            raise BadInput(where, name, f'{shown(value, 80)} is not a choice',
                           f'choose from {", ".join(self.choices)}')
        if value == '' != self.default:
            raise BadInput(where, name, 'is empty', give)
        if isinstance(value, str) and len(value) > LONGEST_TEXT:
            raise BadInput(where, name, f'has {len(value)} characters',
                           f'at most {LONGEST_TEXT} are read')
        return value

    def limits(self) -> str:
        """Return in words what a number may be."""
        words = f'{_plain(self.low)} to {_plain(self.high)}'
        return f'{words}; 0 for none' if self.or_none else words

    def descriptor(self) -> ParameterDescriptor:
        """Describe the parameter to the tools of ROS."""
        unit = f' [{self.unit}]' if self.unit else ''
        rules = [f'one of {", ".join(self.choices)}'] if self.choices else []
        rules += [f"'' for {self.general}"] if self.general else []
        rules += [f'or one of {", ".join(self.words)}'] if self.words else []
        descriptor = ParameterDescriptor(
            description=f'{self.description}{unit}', read_only=not self.live,
            additional_constraints='; '.join(rules),
            dynamic_typing=bool(self.general or self.words) and self.type is not str)
        if self.type is float:
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=self.low, to_value=self.high)]
        if self.type is int:
            descriptor.integer_range = [
                IntegerRange(from_value=0 if self.or_none else int(self.low),
                             to_value=int(self.high))]
        return descriptor


def _texts(value: Any, where: object, name: str, give: str) -> list[str]:
    """Return a list of texts; an empty one arrives as None from a file."""
    texts = [] if value is None else value
    if not isinstance(texts, (list, tuple)) or not all(isinstance(text, str) for text in texts):
        raise BadInput(where, name, f'{value!r:.80} is not a list of texts', give)
    return list(texts) or ['']  # an empty list has no type in ROS


def _plain(value: float) -> str:
    return str(value) if isinstance(value, int) else f'{value:g}'


def _number(text: str) -> float | str:
    """Return the number that a text is, or the text."""
    try:
        return float(text)
    except ValueError:
        return text


_TYPES = {str: 'a text', float: 'a number', int: 'a whole number', bool: 'true or false'}

GENERAL: Mapping[str, Known] = {
    'design_file': Known(str, None, 'design file, written by the designer'),
    'rate': Known(float, 100.0, 'rate of the virtual sensors', 'Hz', 0.001, 1000.0),
    'autostart': Known(bool, True, 'configure and activate without a lifecycle manager'),
    'max_age': Known(float, 0.5, 'age from which a reading is silence, and a command that came '
                     'periodically has ended; at least three periods count', 's', 0.001, 86400.0),
    'max_jump': Known(float, 1.0, 'jump of the clock ahead from which the virtual sensors start '
                      'anew; at least ten periods count', 's', 0.001, 86400.0),
    'isolation.topic': Known(str, 'isolation', 'topic that says which sensors are faulty'),
    'isolation.type': Known(str, DIAGNOSTICS, 'message type of the isolation topic',
                            choices=(DIAGNOSTICS, TEXT)),
    'isolation.names': Known(
        list, [''], 'names by which isolation speaks of a sensor, beside its own: NAME=SENSOR'),
    'isolator.mode': Known(
        str, 'advise', "what becomes of the node's own isolator, for which a design needs "
        '--isolate: off, advise (it says who failed), act (who failed is replaced)',
        choices=MODES),
    'isolator.false_alarms_per_day': Known(
        float, 1.0, 'false alarms of the isolator that are put up with', '1/day', 1e-6, 1e4),
    'isolator.model_error': Known(
        float, 0.1, 'share of motion beyond what was learnt by which the isolator is more '
        'careful; 0 disables that', '', 0.0, 1.0),
    'isolator.recovery': Known(
        str, 'hold', 'when the isolator believes a sensor again: hold (when cleared by '
        'service), return (when it has come back for the dwell)', choices=RECOVERIES),
    'isolator.dwell': Known(
        float, 10.0, 'time for which a sensor must have come back; 0 disables it', 's', 0.0,
        86400.0),
    'isolator.record': Known(
        str, AUTO, 'file with what the isolator has learnt; auto: one of this node and design '
        'in the folder of ROS; none: it is not kept'),
    'without_estimate': Known(
        str, 'stop', 'what goes out for a failed sensor that no virtual sensor replaces: '
        'stop (nothing), hold (the last value), nan, pass (the failed reading)',
        choices=WITHOUT_ESTIMATE, live=True),
    'time_constant': Known(
        float, 0.5, 'time constant with which the offset at a switch decays; 0 disables it, so '
        'that the output steps', 's', 0.0, 3600.0, live=True),
    'recovery.policy': Known(
        str, 'automatic', 'when a sensor reported healthy is believed again: automatic (after '
        'the dwell), hold (when cleared by service), latched (after a reset)',
        choices=RECOVERY, live=True),
    'recovery.dwell': Known(
        float, 2.0, 'time without interruption that a sensor must be reported healthy before it '
        'is believed, and the least time in virtual; 0 disables it', 's', 0.0, 86400.0, live=True),
    'silent_sensor': Known(
        str, 'wait', 'what becomes of a sensor that is silent for its max_age: wait (nothing '
        'goes out), replace (it counts as faulty)', choices=SILENT, live=True),
    'max_deviation': Known(
        float, AUTO, 'standard deviation beyond which an estimate is not valid; auto: the limits '
        'that follow from the design; 0 disables all of them', 'of the channel', 0.0, 1e12,
        words=(AUTO,), live=True),
}

# for each of them: what one sensor may have of its own
OVERRIDES: Mapping[str, str] = {
    'recovery': 'recovery.policy',
    'dwell': 'recovery.dwell',
    'silent': 'silent_sensor',
    'max_deviation': 'max_deviation',
    'max_age': 'max_age',
}


def named(design: Design) -> dict[str, Known]:
    """Return the parameters that each sensor and each command of a design has."""
    known: dict[str, Known] = {}
    for prefix, name in (*(('sensors', s) for s in design.sensors),
                         *(('commands', u) for u in design.inputs)):
        use = 'goes out' if prefix == 'sensors' else 'is commanded'
        known[f'{prefix}.{name}.topic'] = Known(str, None, f'topic on which {name} {use}')
        known[f'{prefix}.{name}.type'] = Known(str, None, f'message type of {name}')
        known[f'{prefix}.{name}.field'] = Known(str, None, f'field of the message that is {name}')
        known[f'{prefix}.{name}.publisher'] = Known(
            str, '', f'node whose messages alone count for {name}; default: any')
        known[f'{prefix}.{name}.disowned'] = Known(
            str, REFUSE, f'what becomes of {name} when its message marks it as not there: refuse '
            '(it is no reading), use (its driver does not mean the mark)', choices=DISOWNED)
        known[f'{prefix}.{name}.stamp'] = Known(
            str, '', f'fields with the time of the message, beside its header; the first is the '
            f'time of {name} when there is no header')
        known[f'{prefix}.{name}.stamp_unit'] = Known(
            str, '', 'unit of those fields that are numbers: s, ms, us or ns')
        if prefix == 'commands':
            known[f'commands.{name}.max_age'] = _override(name, 'max_age')
            known[f'commands.{name}.at_end'] = Known(
                float, '', f'value that counts when {name} has not come for its max_age: a '
                'number, hold (the last one), or invalid (none, so that no estimate that needs it '
                'is valid); default: invalid if it came periodically, else hold',
                'of the command', -1e12, 1e12, words=AT_END)
            continue
        known[f'sensors.{name}.input'] = Known(
            str, '', f'topic on which the driver of {name} publishes; default: the topic + _raw')
        known[f'sensors.{name}.guard'] = Known(
            float, GUARD, f'time before the loss of {name} in which it may have been faulty '
            'already: its last good readings are from before that', 's', 0.0, LONGEST_GUARD)
        known[f'sensors.{name}.smallest_fault'] = Known(
            float, 0.0, f'fault of {name} that the isolator has to find; it says when it cannot; '
            '0 for none', 'of the channel', 0.0, 1e12)
        for key, general in OVERRIDES.items():
            known[f'sensors.{name}.{key}'] = _override(name, general)
    return known


def _override(name: str, general: str) -> Known:
    """Return what one sensor or command has of its own in place of a general parameter."""
    entry = GENERAL[general]
    return Known(entry.type, '', f'{general} of {name} alone', entry.unit, entry.low, entry.high,
                 entry.choices, entry.live, general, words=entry.words)
