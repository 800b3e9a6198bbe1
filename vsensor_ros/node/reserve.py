"""What is told of a sensor that no virtual sensor could speak for if it failed now."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from enum import Enum
import math

from rclpy.node import Node

from vsensor_ros.engine import ChannelState
from vsensor_ros.node.graph import meant, published_like
from vsensor_ros.node.parameters import Settings
from vsensor_ros.reason import Reason


@dataclass(frozen=True)
class Origin:
    """Where a sensor or a command is heard."""

    topic: str
    type: str
    key: str  # what the parameters that say so begin with
    publishers: tuple[str, ...] | None = None  # nodes that publish there; None: not known yet
    like: tuple[str, ...] = ()  # topics that are published and may have been meant


class Chance(Enum):
    """Whether what keeps a reserve from serving passes."""

    SERVES = 'nothing does'
    PASSES = 'passes by itself'
    MEND = 'may be mended'
    NEVER = 'is known from the design'


# codes of reasons; of those that stand in neither, something may be mended
_PASSES = {'converging', 'converging, not proved', 'about to start', 'ready again',
           'ready just now'}
_NEVER = {'not designed', 'no design', 'refused', 'several rows', 'start unknown'}

# what mends an estimate that is not good enough; {} is the parameter that limits it
_GIVE = 'if it will do all the same, give {}'
_RAISED = {
    'too uncertain': 'raise {}, if that will do',
    'beyond the tolerance': _GIVE,
    'beyond a tenth of the range': _GIVE,
    'no limit': 'give a tolerance or ranges in the plant file, or {}',
    'worse than designed': f'mend the model and its noise in the plant file; {_GIVE}'}
_NEVER_HEARD = {'no reading yet', 'no command yet'}


def chance(reserve: Reason | None) -> Chance:
    """Judge why a reserve could not serve: by the best of those there are."""
    if reserve is None:
        return Chance.SERVES
    codes = {reason.code for reason in _leaves(reserve)}
    if codes & _PASSES:
        return Chance.PASSES
    return Chance.NEVER if codes <= _NEVER else Chance.MEND


def _leaves(reason: Reason) -> Iterator[Reason]:
    """Yield the reasons that a reason is made of, none of which is made of others."""
    parts = [fact for _, fact in reason.facts if isinstance(fact, Reason)]
    if not parts:
        yield reason
    for part in parts:
        yield from _leaves(part)


def without_reserve(name: str, reserve: Reason, origins: Mapping[str, Origin]) -> list[str]:
    """Say why nobody could speak for a sensor if it failed, and what to do about it."""
    if (hope := chance(reserve)) is Chance.NEVER:
        return [f'cannot be replaced ({reserve})']
    return [f'could not be replaced now ({reserve})',
            *(mends(name, reserve, origins) if hope is Chance.MEND else ())]


def mends(name: str, reason: Reason, origins: Mapping[str, Origin]) -> list[str]:
    """Say what to do about what keeps a virtual sensor of a sensor from serving."""
    parts = []
    for leaf in _leaves(reason):
        if leaf.code in _RAISED:
            parts.append(_RAISED[leaf.code].format(f'sensors.{name}.max_deviation'))
        elif (origin := origins.get(dict(leaf.facts).get('name', ''))) is not None:
            parts.append(_mend(origin, leaf.code in _NEVER_HEARD))
    return list(dict.fromkeys(parts))


def worth(channel: ChannelState) -> str:
    """Say what a reserve is good for, or would be now, or that it could not serve."""
    name, unit = channel.name, channel.unit
    if channel.reserve is not None:
        return f'{name} {without_reserve(name, channel.reserve, {})[0]}'
    text = f'{name} is replaced' if channel.serves else f'{name} could be replaced now'
    if math.isfinite(channel.reserve_deviation):
        text += f', to {channel.reserve_deviation:.2g} {unit}'.rstrip()
    if math.isfinite(channel.remaining_s):
        text += f', for {channel.remaining_s:.2g} s'
    return text if channel.rehearsed is not None else f'{text} (not compared with it yet)'


def _mend(origin: Origin, never_heard: bool) -> str:
    """Say what to do about a sensor or a command that is not heard, now or at all."""
    who, there = ', '.join(origin.publishers or ()), f'on {origin.topic}'
    key = f'{origin.key}.{"input" if origin.key.startswith("sensors") else "topic"}'
    if not never_heard:
        return f'check {who}, which publishes {there}' if who else f'check who publishes {there}'
    if who:
        return f'{who} publishes {there}: check what, and {origin.key}.field'
    nobody = f'nobody publishes {there}: ' if origin.publishers is not None else ''
    return f'{nobody}start who does, or correct {key}{meant(origin.like)}'


def look_for(node: Node, origin: Origin, there: tuple[str, ...]) -> Origin:
    """Return an origin with the nodes that publish there, or what may have been meant instead."""
    return replace(origin, publishers=there, like=() if there else published_like(
        node, origin.topic, origin.type))


def origins_of(settings: Settings) -> dict[str, Origin]:
    """Return where each sensor and each command is heard."""
    return {**{s.name: Origin(s.input, s.type, f'sensors.{s.name}') for s in settings.sensors},
            **{c.name: Origin(c.topic, c.type, f'commands.{c.name}') for c in settings.commands}}
