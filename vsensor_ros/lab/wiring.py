"""Which channel travels on which topic: the replacer's parameter file, seen from the machine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
import math
from typing import Any

from rclpy.exceptions import NameValidationException
from rclpy.expand_topic_name import expand_topic_name

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.parameter_file import Parameters
from vsensor_ros.node.accessor import Accessor, compile_accessor
from vsensor_ros.node.field_path import message_type


@dataclass(frozen=True)
class Port:
    """One channel: where the machine publishes it, where the others hear it."""

    name: str
    source: str     # the driver's or the commander's topic
    output: str     # the topic that the replacer serves; for commands the same as `source`
    kind: Any       # the message class
    field: Accessor


@dataclass(frozen=True)
class Wiring:
    """All topics of a replacer."""

    ports: dict[str, Port]
    isolation: str
    isolation_kind: Any


def wiring_of(parameters: Parameters) -> Wiring:
    """Find the topics in a replacer's parameters; raise BadInput."""
    where, given = str(parameters.path), parameters.given
    resolve = partial(topic_of, parameters)
    try:
        ports = {}
        names = (key.rpartition('.')[0] for key in given
                 if key.startswith(('sensors.', 'commands.')))
        for place in dict.fromkeys(names):
            group, _, name = place.partition('.')
            kind = message_type(given[f'{place}.type'], where, f'{place}.type')
            topic = source = resolve(given[f'{place}.topic'], f'{place}.topic')
            if group == 'sensors':
                source = resolve(given.get(f'{place}.input') or f'{topic}_raw',
                                 f'{place}.input')
            ports[name] = Port(name, source, topic, kind, compile_accessor(
                kind, given[f'{place}.field'], where, f'{place}.field'))
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInput(where, '', f'lacks {error}'[:100], 'give replacer: ros__parameters: with '
                       'topic, type and field of each sensor and command') from None
    return Wiring(ports, resolve(parameters.general('isolation.topic'), 'isolation.topic'),
                  message_type(parameters.general('isolation.type'), where, 'isolation.type'))


def topic_of(parameters: Parameters, topic: str, key: str) -> str:
    """Return the full name of a topic that stands below a key; raise BadInput."""
    namespace, _, node = parameters.node.rpartition('/')
    try:
        return str(expand_topic_name(topic, node, namespace or '/'))
    except (ValueError, NameValidationException):
        raise BadInput(parameters.path, key, f'{topic!r:.80} is not a topic name',
                       'write it like /tank/level2') from None


def blank(ports: list[Port]) -> Any:
    """Return a message of the ports' type with a place, NaN at first, for each of its fields."""
    message = ports[0].kind()
    for port in ports:
        port.field.put(message, math.nan)
    return message
