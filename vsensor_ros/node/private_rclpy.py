"""
What is used of rclpy beyond its public face, all of it here, and what each part is needed for.

The executors of rclpy rebuild their wait set several times a message and decode every one; the
replacer waits on the same wait set itself, and takes and sends bytes. Written for rclpy 7.1
(Jazzy). `lacking` says which of these parts a release does not have.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack
import ctypes
from typing import Any

from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation as _rclpy
from rclpy.lifecycle import LifecycleNode
from rclpy.publisher import Publisher
from rclpy.qos_overriding_options import _declare_qos_parameters
from rclpy.subscription import Subscription

PARTS = {  # (class, attribute): what it is needed for
    ('Subscription', 'take_message'): 'to take messages that no executor waits for',
    ('Subscription', 'pointer'): 'to know which subscription is ready',
    ('Publisher', 'publish_raw'): 'to send messages on as the bytes that came',
    ('LifecycleStateMachine', 'destroy_when_not_in_use'): 'to end a managed node',
    ('WaitSet', 'add_subscription'): 'to wait for messages without an executor',
    ('WaitSet', 'clear_entities'): 'to wait for messages again',
    ('WaitSet', 'wait'): 'to wait for messages without an executor',
    ('WaitSet', 'get_ready_entities'): 'to know which subscription is ready',
}


def lacking(implementation: Any = _rclpy) -> list[str]:
    """Return the parts that this release of rclpy lacks, each with what it is needed for."""
    return [f'{kind}.{part} ({use})' for (kind, part), use in PARTS.items()
            if not hasattr(getattr(implementation, kind, None), part)]


def taker(subscription: Subscription) -> Callable[[Any, bool], Any]:
    """
    Return what takes one message: called with (type, raw), it returns (message, info) or None.

    info: a dict with 'source_timestamp' and 'received_timestamp' in ns.
    """
    take: Callable[[Any, bool], Any] = subscription.handle.take_message
    return take


class _Info(ctypes.Structure):
    """rmw_message_info_t, and some space more."""

    _fields_ = (('source_timestamp', ctypes.c_int64), ('received_timestamp', ctypes.c_int64),
                ('publication', ctypes.c_uint64), ('reception', ctypes.c_uint64),
                ('implementation', ctypes.c_void_p), ('gid', ctypes.c_uint8 * 16),
                ('from_intra_process', ctypes.c_bool), ('more', ctypes.c_uint8 * 64))


class _Allocator(ctypes.Structure):
    """rcutils_allocator_t."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in (
        'allocate', 'deallocate', 'reallocate', 'zero_allocate', 'state'))


class _Bytes(ctypes.Structure):
    """rcutils_uint8_array_t."""

    _fields_ = (('buffer', ctypes.c_void_p), ('length', ctypes.c_size_t),
                ('capacity', ctypes.c_size_t), ('allocator', _Allocator))


class IdentifyingTaker:
    """
    Takes one message, as what `taker` returns does, but with its 'publisher_gid' in the info.

    That is the `endpoint_gid` of the graph. rclpy leaves it out of what it hands on; rcl has it.
    """

    def __init__(self, subscription: Subscription) -> None:
        """Prepare; raises OSError or AttributeError, see `identifying_taker`."""
        rcl, rcutils = ctypes.PyDLL('librcl.so'), ctypes.PyDLL('librcutils.so')
        self._take, self._forget = rcl.rcl_take_serialized_message, rcutils.rcutils_reset_error
        self._take.argtypes = (ctypes.c_void_p,) * 4
        self._end = rcutils.rcutils_uint8_array_fini
        rcutils.rcutils_get_default_allocator.restype = _Allocator
        self._handle, self._info = subscription.handle, _Info()
        self._bytes = _Bytes(allocator=rcutils.rcutils_get_default_allocator())

    def __call__(self, kind: Any, raw: bool) -> tuple[bytes, dict[str, Any]] | None:
        """Return a message as bytes, and the middleware's facts; None: there is none."""
        info, taken = self._info, self._bytes
        with self._handle:
            if self._take(self._handle.pointer, ctypes.byref(taken), ctypes.byref(info), None):
                self._forget()
                return None
        return ctypes.string_at(taken.buffer, taken.length), {
            'source_timestamp': info.source_timestamp,
            'received_timestamp': info.received_timestamp, 'publisher_gid': bytes(info.gid)}

    def __del__(self) -> None:
        """Free what the last message was written into."""
        if hasattr(self, '_bytes') and self._bytes.buffer:
            self._end(ctypes.byref(self._bytes))


def identifying_taker(subscription: Subscription) -> IdentifyingTaker | None:
    """Return what tells who sent a message; None: this release of rcl cannot."""
    try:
        return IdentifyingTaker(subscription)
    except (OSError, AttributeError):
        return None


def take_all(subscription: Subscription,
             raw: bool = False) -> Iterator[tuple[Any, dict[str, Any]]]:
    """Yield what has come: messages, or their bytes if raw, each with the middleware's facts."""
    with subscription.handle:
        take = taker(subscription)
        while taken := take(subscription.msg_type, raw):
            yield taken


def sender(publisher: Publisher) -> Callable[[bytes], None]:
    """Return what sends a serialized message; it raises RuntimeError (RCLError)."""
    send: Callable[[bytes], None] = publisher.handle.publish_raw
    return send


def key_of(subscription: Subscription) -> int:
    """Return by what `Waiting.wait` names a subscription."""
    return int(subscription.handle.pointer)


def override_qos(end: Any, node: Any, topic: str, qos: Any, options: Any) -> None:
    """Write into a profile what parameters say of an end (a class) that is not opened."""
    _declare_qos_parameters(end, node, topic, qos, options)


def end_state_machine(node: LifecycleNode) -> None:
    """Destroy the state machine of a node, which rclpy forgets: it would keep the node alive."""
    node._state_machine.destroy_when_not_in_use()


class Waiting:
    """Waits for some subscriptions; nobody can destroy them meanwhile. A context manager."""

    def __init__(self, subscriptions: Sequence[Subscription], context: Context) -> None:
        self._handles = [subscription.handle for subscription in subscriptions]
        self._context, self._stack = context, ExitStack()

    def __enter__(self) -> Waiting:
        """Hold the subscriptions."""
        with ExitStack() as stack:
            for handle in self._handles:
                stack.enter_context(handle)
            self._set = _rclpy.WaitSet(len(self._handles), 0, 0, 0, 0, 0, self._context.handle)
            stack.enter_context(self._set)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        """Let go of them."""
        self._stack.close()

    def wait(self, longest: int) -> Collection[int]:
        """Wait until a message has come, or so long [ns]; return the keys of who is ready."""
        self._set.clear_entities()
        for handle in self._handles:
            self._set.add_subscription(handle)
        self._set.wait(longest)
        ready: Collection[int] = self._set.get_ready_entities('subscription')
        return ready
