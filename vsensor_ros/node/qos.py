"""The quality of service of each topic, as `qos_overrides.*` may change it when it is opened."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from rclpy.qos import (
    DurabilityPolicy,
    LivelinessPolicy,
    QoSPolicyKind,
    QoSProfile,
    ReliabilityPolicy,
)
from rclpy.qos_overriding_options import QoSOverridingOptions

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.known import Known

DIAGNOSTICS_TOPIC = '/diagnostics'
STATUS = '~/status'
ESTIMATES = '~/estimates'
ISOLATION = '~/isolation'
QOS = 'qos_overrides'  # what their names begin with
DEEPEST = 1000  # messages kept for a topic: more is memory that nobody bounds
SHORTEST, LONGEST = 10**6, 86400 * 10**9  # ns; the middleware has a timer of each of these times
ENDLESS = 2**62  # ns; what the graph says of a time that is none is beyond

_POLICIES = {
    'history': Known(str, 'keep_last', 'which messages are kept', choices=('keep_last',)),
    'depth': Known(int, 0, 'number of messages kept', low=1, high=DEEPEST),
    'reliability': Known(str, '', 'reliability', choices=('reliable', 'best_effort')),
    'durability': Known(str, '', 'durability', choices=('volatile', 'transient_local')),
    'deadline': Known(int, 0, 'longest time between two messages that is promised, or wanted',
                      'ns', SHORTEST, LONGEST, or_none=True),
    'liveliness': Known(str, '', 'who asserts that a publisher is alive',
                        choices=('system_default', 'automatic', 'manual_by_topic')),
    'liveliness_lease_duration': Known(int, 0, 'time after which a publisher that did not assert '
                                       'it counts as gone', 'ns', SHORTEST, LONGEST, or_none=True),
    'lifespan': Known(int, 0, 'age from which a message is not delivered any more', 'ns',
                      SHORTEST, LONGEST, or_none=True),
}
_OF_PUBLISHERS = ('lifespan',)


def kept() -> QoSProfile:
    """Return a profile of a topic whose last message late joiners see, for rclpy to write into."""
    return QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def qos_options() -> QoSOverridingOptions:
    """
    Let parameters change the quality of service of a topic that is opened with this.

    rclpy writes what they say into the profile it is given: give it a copy of a shared one.
    """
    return QoSOverridingOptions([QoSPolicyKind[policy.upper()] for policy in _POLICIES])


def qos_parameters(ends: Iterable[tuple[str, str]]) -> dict[str, Known]:
    """Return the parameters of these (resolved topic, 'publisher' or 'subscription')."""
    return {f'{QOS}.{topic}.{end}.{policy}': replace(
                entry, description=f'{entry.description} of the {end} on {topic}')
            for topic, end in ends for policy, entry in _POLICIES.items()
            if end != 'subscription' or policy not in _OF_PUBLISHERS}


def misfit(publisher: QoSProfile, subscription: QoSProfile) -> str:
    """
    Say what is offered and what wanted where it is too little; '' when messages pass.

    Each may be a profile that was never opened, whose times are 0, or one of the graph, which says
    forever: rmw takes these for different.
    """
    offered, requested = _levels(publisher), _levels(subscription)
    return ', '.join(f'{policy} is {offered[policy][1] or "none"}, wanted '
                     f'{requested[policy][1] or "none"}' for policy in offered
                     if offered[policy][0] < requested[policy][0])


def mends(publisher: QoSProfile, subscription: QoSProfile, topic: str, end: str) -> list[str]:
    """
    Return the parameters of our end that let two others meet: what is offered and what requested.

    end: ours, 'publisher' or 'subscription'. Empty when no parameter can do it.
    """
    offered, requested = _levels(publisher), _levels(subscription)
    theirs = requested if end == 'publisher' else offered
    entries = qos_parameters([(topic, end)])
    lines = []
    for policy in offered:
        if offered[policy][0] >= requested[policy][0]:
            continue
        name, value = f'{QOS}.{topic}.{end}.{policy}', theirs[policy][1]
        try:
            entries[name].check(value, '', name)
        except BadInput:
            return []
        lines.append(f'{name}: {value}')
    return lines


def _levels(qos: QoSProfile) -> dict[str, tuple[float, str | int]]:
    """Return by policy how much is offered or requested, and how a parameter says so."""
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    kept = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    manual = qos.liveliness == LivelinessPolicy.MANUAL_BY_TOPIC
    deadline, lease = (0 if ns >= ENDLESS else ns for ns in (
        qos.deadline.nanoseconds, qos.liveliness_lease_duration.nanoseconds))
    return {
        'reliability': (reliable, 'reliable' if reliable else 'best_effort'),
        'durability': (kept, 'transient_local' if kept else 'volatile'),
        'deadline': (1 / deadline if deadline else 0, deadline),
        'liveliness': (manual, 'manual_by_topic' if manual else 'automatic'),
        'liveliness_lease_duration': (1 / lease if lease else 0, lease),
    }
