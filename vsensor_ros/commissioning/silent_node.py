"""A node that only listens: whatever runs on it, nothing of it reaches the graph."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
from typing import Any

from rclpy.context import Context
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node.mute import Mute
from vsensor_ros.node.private_rclpy import override_qos

QUIETLY = Parameter('start_type_description_service', value=False)


class Notebook:
    """Stands in for a logger: keeps what is said, by level."""

    def __init__(self) -> None:
        self.errors: dict[str, None] = {}  # each once

    def error(self, text: str, **options: Any) -> None:
        """Keep it."""
        self.errors[text] = None

    fatal = error

    def warning(self, text: str, **options: Any) -> None:
        """Let it go: what is worth a warning is found otherwise."""

    warn = info = debug = warning


class SilentNode(Node):
    """
    A node without a publisher or a service, /rosout and /parameter_events included.

    `notebook` holds the errors that would be logged.
    """

    def __init__(self, name: str, context: Context, namespace: str = '',
                 overrides: Sequence[Parameter] = (), global_arguments: bool = True) -> None:
        self.notebook = Notebook()
        super().__init__(
            name, context=context, namespace=namespace, use_global_arguments=global_arguments,
            enable_rosout=False, start_parameter_services=False,
            parameter_overrides=[*overrides, QUIETLY],
            automatically_declare_parameters_from_overrides=True)

    def get_logger(self) -> Any:
        """Return what keeps the errors to itself."""
        return self.notebook

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: Any,
                         **options: Any) -> Any:
        """Return what sends nothing, with the QoS that parameters give it."""
        qos = QoSProfile(depth=qos_profile) if isinstance(qos_profile, int) else qos_profile
        resolved = self.resolve_topic_name(topic)
        if (overriding := options.get('qos_overriding_options')) is not None:
            override_qos(Publisher, self, resolved, qos, overriding)
        return Mute(resolved, qos)


@contextmanager
def open_context(ros_args: Sequence[str]) -> Iterator[Context]:
    """
    Yield a context that reads what stands after --ros-args; all its nodes end with it.

    Signals stay Python's. Raises BadInput.
    """
    context = Context()
    try:
        try:
            context.init(args=['--ros-args', *ros_args])
        except (RuntimeError, ValueError) as error:  # what rcl raises
            raise BadInput('', 'arguments', str(error).partition(', at ')[0],
                           'correct the arguments after --ros-args') from None
        yield context
    finally:
        context.try_shutdown()


@contextmanager
def open_silent(context: Context, name: str, namespace: str = '',
                overrides: Sequence[Parameter] = (),
                global_arguments: bool = True) -> Iterator[SilentNode]:
    """Yield a silent node; raises BadInput when there can be none."""
    try:
        node = SilentNode(name, context, namespace, overrides, global_arguments)
    except (RuntimeError, ValueError) as error:
        raise BadInput('', 'node', str(error).partition(', at ')[0],
                       'correct its name, its parameters or its security files') from None
    try:
        yield node
    finally:
        node.destroy_node()


def own_name(verb: str) -> str:
    """Return a name that no other node has, so that it may run beside whatever does."""
    return f'{verb}_{os.getpid()}'
