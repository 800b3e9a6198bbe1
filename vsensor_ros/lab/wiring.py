"""Which channel travels on which topic: the replacer's parameter file, seen from the machine."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import re
from typing import Any

import numpy as np
import yaml

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.accessor import Accessor, compile_accessor, message_type


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


def read_wiring(path: Path) -> Wiring:
    """Read the topics of a replacer's parameter file; raise BadInput."""
    where = str(path)
    try:
        given = dict(_leaves(_parameters(yaml.safe_load(path.read_text(encoding='utf-8')))))
        ports = {}
        names = (key.rpartition('.')[0] for key in given
                 if key.startswith(('sensors.', 'commands.')))
        for place in dict.fromkeys(names):
            group, _, name = place.partition('.')
            kind = message_type(given[f'{place}.type'], where, f'{place}.type')
            topic = source = given[f'{place}.topic']
            if group == 'sensors':
                source = given.get(f'{place}.input') or f'{topic}_raw'
            ports[name] = Port(name, source, topic, kind, compile_accessor(
                kind, given[f'{place}.field'], where, f'{place}.field'))
        kind = message_type(given.get('isolation.type', 'diagnostic_msgs/msg/DiagnosticArray'),
                            where, 'isolation.type')
        return Wiring(ports, given.get('isolation.topic', '/isolation'), kind)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise BadInput(where, '', f'cannot be read: {error}'[:200],
                       "give the replacer's parameter file") from None
    except (KeyError, TypeError, AttributeError) as error:
        raise BadInput(where, '', f'lacks {error}'[:100], 'give replacer: ros__parameters: with '
                       'topic, type and field of each sensor and command') from None


def _parameters(root: dict[str, Any]) -> dict[str, Any]:
    """Return what stands below ros__parameters of the replacer, or of all nodes (``/**``)."""
    for key, below in root.items():
        if key.rpartition('/')[2] in ('replacer', '**') and 'ros__parameters' in below:
            found: dict[str, Any] = below['ros__parameters']
            return found
    for below in root.values():  # a namespace
        if isinstance(below, dict) and 'ros__parameters' not in below:
            return _parameters(below)
    raise KeyError('replacer: ros__parameters')


def _leaves(tree: dict[str, Any], place: str = '') -> Iterator[tuple[str, Any]]:
    """Yield dotted names and values; ROS takes both ``a: {b: 1}`` and ``a.b: 1``."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from _leaves(value, f'{place}{key}.')
        else:
            yield f'{place}{key}', value


def blank(ports: list[Port]) -> Any:
    """Return a message of the ports' type with a place, NaN at first, for each of its fields."""
    message = ports[0].kind()
    for port in ports:
        holder = message
        *path, last = port.field.path.split('.')
        for step in path:
            holder = getattr(holder, step)
        if match := re.fullmatch(r'(\w+)\[(\w+)\]', last):
            array, element = match.groups()
            length = int(element) + 1 if element.isdigit() else 0
            if not element.isdigit():
                names = next(n for n in ('name', 'joint_names') if hasattr(holder, n))
                if element not in getattr(holder, names):
                    getattr(holder, names).append(element)
                length = len(getattr(holder, names))
            values = list(getattr(holder, array))
            setattr(holder, array, values + [np.nan] * (length - len(values)))
    for port in ports:
        port.field.put(message, np.nan)
    return message
