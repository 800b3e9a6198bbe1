"""A ROS domain of our own, and what is done there by hand, without an executor."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
import socket
from typing import Any

from rclpy.context import Context
from rclpy.node import Node

from vsensor_ros.bad_input import BadInput
from vsensor_ros.lab.config_folder import config_folder
from vsensor_ros.lab.process import Failed

DOMAIN_PORT = 27400     # TCP port held while domain 1, 2, .. is in use; the tests hold the same


@contextmanager
def reserved_domain() -> Iterator[int]:
    """Yield a ROS domain that nobody else on this machine reserves meanwhile."""
    for domain in range(1, 101):
        with socket.socket() as held:
            try:
                held.bind(('127.0.0.1', DOMAIN_PORT + domain))
            except OSError:
                continue
            yield domain
            return
    raise Failed('all ROS domains from 1 to 100 are in use on this machine')


def stay_on_this_computer() -> None:
    """Have this process and its children be found on this computer only, and quickly."""
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    config = config_folder()
    if config is not None and (profile := config / 'fastdds_localhost.xml').is_file():
        os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(profile))


@contextmanager
def open_nodes(*names: str, domain: int | None = None,
               ros_args: Sequence[str] = ()) -> Iterator[list[Node]]:
    """
    Yield nodes of these names in a context of their own; domain: None for the environment's.

    ros_args: what stands after --ros-args. Raise BadInput when it cannot be read.
    """
    context = Context()
    nodes: list[Node] = []
    try:
        try:
            # Ctrl-C stays Python's, so that the processes are ended in order
            context.init(args=['--ros-args', *ros_args], domain_id=domain)
            nodes += [Node(name, context=context) for name in names]
        except RuntimeError as error:  # what rcl raises
            raise BadInput('', 'arguments', str(error).partition(', at ')[0],
                           'correct the arguments after --ros-args') from None
        yield nodes
    finally:
        for node in nodes:
            node.destroy_node()
        context.try_shutdown()


def by_hand(message: Any) -> None:
    """Stand in for a callback where no executor runs and messages are taken by hand."""
