"""The quality of service of each topic, as `qos_overrides.*` may change it when it is opened."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.qos import QoSPolicyKind
from rclpy.qos_overriding_options import QoSOverridingOptions

from vsensor_ros.node.known import Known

DIAGNOSTICS_TOPIC = '/diagnostics'
STATUS = '~/status'
ESTIMATES = '~/estimates'
QOS = 'qos_overrides'  # what their names begin with
DEEPEST = 1000  # messages kept for a topic: more is memory that nobody bounds

_POLICIES = {
    'history': Known(str, 'keep_last', 'which messages are kept', choices=('keep_last',)),
    'depth': Known(int, 0, 'number of messages kept', low=1, high=DEEPEST),
    'reliability': Known(str, '', 'reliability', choices=('reliable', 'best_effort')),
    'durability': Known(str, '', 'durability', choices=('volatile', 'transient_local')),
}


def qos_options() -> QoSOverridingOptions:
    """
    Let parameters change the quality of service of a topic that is opened with this.

    rclpy writes what they say into the profile it is given: give it a copy of a shared one.
    """
    return QoSOverridingOptions([QoSPolicyKind[policy.upper()] for policy in _POLICIES])


def qos_parameters(ends: Iterable[tuple[str, str]]) -> dict[str, Known]:
    """Return the parameters of these (resolved topic, 'publisher' or 'subscription')."""
    return {f'{QOS}.{topic}.{end}.{policy}': Known(
                entry.type, entry.default, f'{entry.description} of the {end} on {topic}',
                low=entry.low, high=entry.high, choices=entry.choices)
            for topic, end in ends for policy, entry in _POLICIES.items()}
