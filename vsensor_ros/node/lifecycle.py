"""
The replacer as a managed node: configured, activated, deactivated and cleaned up on request.

The main thread runs the loop while the node is active; an executor in a background thread serves
transitions, services, parameters, the reports and the look at the graph.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import gc
import sys
from threading import Event, Lock, Thread
import time
import traceback
from typing import Any

from lifecycle_msgs.srv import ChangeState
import rclpy
from rclpy.context import Context
from rclpy.exceptions import InvalidTopicNameException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions

from vsensor_ros.bad_input import BadInput
from vsensor_ros.engine import Live
from vsensor_ros.node.isolator import Announcer, Isolator, offer_clear
from vsensor_ros.node.loop import run
from vsensor_ros.node.parameters import (
    Block,
    check_addressed,
    check_files,
    read,
    Refused,
    Settings,
    watch,
)
from vsensor_ros.node.private_rclpy import end_state_machine, lacking
from vsensor_ros.node.replacer import Replacer
from vsensor_ros.node.services import offer
from vsensor_ros.node.status import Reporter

PATIENCE = 5.0  # s that the loop may take to come to its end
IDLE = 0.05  # s between two looks whether there is something to run
LONGEST = 1.0  # s that the executor waits for something to do
AGAIN = 60.0  # s between two lines on the same failure of a callback
MOST_SHOWN = 1000  # characters of what others are given
SUCCESS, FAILURE, ERROR = (TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE,
                           TransitionCallbackReturn.ERROR)


@dataclass(frozen=True)
class Role:
    """What a managed node is there for."""

    name: str  # of the node, unless it is remapped
    speaks: bool  # in place of sensors
    work: Any  # is made of the node and its settings, opens its topics
    tell: Any  # is made of the node and the work, tells what that does
    offer: Callable[..., Sequence[Service]]  # opens its services


REPLACER = Role('replacer', True, Replacer, Reporter, offer)
ISOLATOR = Role('isolator', False, Isolator, Announcer, offer_clear)


class ManagedNode(LifecycleNode):
    """
    The node and its states; what it does in them is the replacer's, or whatever its role is.

    Unconfigured: no topics but rclpy's. Inactive: all topics are open, nothing goes out. Active:
    the loop runs. Transitions come from the executor's thread, or from the main one while there
    is no executor.
    """

    def __init__(self, context: Context | None = None,
                 overrides: Sequence[Parameter] = (), blocks: Sequence[Block] = (),
                 role: Role = REPLACER) -> None:
        """Make the node; blocks: where its parameters come from, for those that do not fit."""
        super().__init__(role.name, context=context, parameter_overrides=list(overrides),
                         automatically_declare_parameters_from_overrides=True)
        self._blocks, self._role = blocks, role
        self.replacer: Replacer | Isolator | None = None
        self.reporter: Reporter | Announcer | None = None
        self.refused: Refused | None = None  # why it could not be configured the last time
        self.active = Event()  # the loop may run
        self.ended = False  # shut down, for good
        self._running = Lock()  # held by the main thread while it runs
        self._offered: Sequence[Service] = ()
        self._unwatch: Callable[[], None] | None = None
        for service in self.services:
            if service.srv_type is ChangeState:
                service.callback = self._unharmed(service.callback)

    def serve(self, stop: Event) -> None:
        """Run the loop whenever the node is active, in this thread, until told to stop."""
        while not stop.is_set():
            self.active.wait(IDLE)
            with self._running:
                if self.active.is_set() and self.replacer is not None:
                    run(self.replacer, stop, self.active)

    def destroy_node(self) -> None:
        """Destroy the state machine, too, which rclpy forgets: it would keep the node alive."""
        end_state_machine(self)
        super().destroy_node()

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Check the parameters, load the design and open all topics; log what is wrong."""
        return self._transit(self._configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Let the loop run."""
        return self._transit(self._activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the loop: nothing goes out, the observers rest."""
        return self._transit(self._deactivate)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close all topics; the node may be configured again."""
        return self._transit(self._close)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop the loop and close all topics, for good."""
        self.ended = True
        return self._transit(self._close)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close what is open, so that the node may be configured again."""
        return self._transit(self._close)

    def _transit(self, act: Callable[[], None]) -> TransitionCallbackReturn:
        """Do it; rclpy would not say what was raised."""
        try:
            act()
        except Refused as refused:
            self.refused = refused  # told by whoever asked for the transition
            return FAILURE
        except Exception:
            self.get_logger().fatal(traceback.format_exc())
            return ERROR
        return SUCCESS

    def _configure(self) -> None:
        if missing := lacking():
            raise Refused([BadInput(self.get_fully_qualified_name(), 'rclpy', f'lacks {part}',
                                    'use the one of ROS 2 Jazzy') for part in missing])
        settings = read(self, self._blocks, self._role.speaks)
        before = self._entities()
        try:
            self.replacer = self._role.work(self, settings)
            self.reporter = self._role.tell(self, self.replacer)
            self._offered = self._role.offer(self, self.replacer, self.active.is_set)
        except Exception as error:
            self._close()
            for kind, entity in self._entities() - before:  # of what was half open
                getattr(self, f'destroy_{kind}')(entity)
            if not isinstance(error, (RuntimeError, InvalidTopicNameException)):  # RCLError
                raise
            raise Refused([BadInput(
                self.get_fully_qualified_name(), 'topics', str(error).partition(', at ')[0],
                'give the topics other names, or allow them in the policy')]) from None
        self._unwatch = watch(self, settings, self._apply)
        self._log_topics(settings)

    def _entities(self) -> set[tuple[str, Any]]:
        """Return what is open on the node, each with what it is."""
        return {(kind, entity) for kind in ('publisher', 'subscription', 'service', 'timer')
                for entity in getattr(self, f'{kind}s')}

    def _log_topics(self, settings: Settings) -> None:
        log = self.get_logger()
        for s in settings.sensors:
            way = f'{s.input} -> {s.output}' if self._role.speaks else s.input
            log.info(f'{s.name}: {way} ({s.type}, {s.accessor.path})')
        for c in settings.commands:
            log.info(f'{c.name}: {c.topic} ({c.type}, {c.accessor.path})')
        if settings.for_others:
            log.info(f'not for this node, it seems: {", ".join(settings.for_others)[:MOST_SHOWN]} '
                     '(given to all nodes)')
        if not self._role.speaks:
            return
        log.info(f'isolation: {settings.isolation_topic} ({settings.isolation_type})')
        log.info(f'{len(settings.design.virtual_sensors)} virtual sensors of '
                 f'{settings.design.plant_name} at {settings.rate:g} Hz; without an estimate: '
                 f'{settings.live.without_estimate}')

    def _apply(self, live: Live) -> None:
        """Take new parameters over between two polls."""
        if self.replacer is not None and self.reporter is not None:
            self.replacer.apply(live)

    def _activate(self) -> None:
        assert self.replacer is not None and self.reporter is not None
        gc.collect()
        gc.freeze()  # what is there stays; looking through it again would hold up the loop
        self.replacer.activate(patient=True)
        self.reporter.turn(active=True)
        self.active.set()

    def _deactivate(self) -> None:
        self.active.clear()
        if not self._running.acquire(timeout=PATIENCE):
            raise TimeoutError(f'the loop has not ended within {PATIENCE:g} s')
        self._running.release()
        if self.replacer is not None and self.reporter is not None:
            self.replacer.deactivate()
            self.reporter.turn(active=False)
            self.reporter.report()

    def _close(self) -> None:
        if self.active.is_set():
            self._deactivate()
        if self._unwatch is not None:
            self._unwatch()
        for service in self._offered:
            self.destroy_service(service)
        if self.reporter is not None:
            self.reporter.close()
        if self.replacer is not None:
            self.replacer.close()
        self.replacer, self.reporter, self._unwatch, self._offered = None, None, None, ()
        gc.unfreeze()  # what the loop froze is garbage now

    def _unharmed(self, change: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
        """Refuse a transition that there is not, at which rclpy would raise in the executor."""
        def change_state(request: Any, response: Any) -> Any:
            try:
                response = change(request, response)
            except RuntimeError as error:  # RCLError
                self.get_logger().warning(str(error).partition(', at ')[0])
                response.success = False
            refused, self.refused = self.refused, None
            for problem in refused.problems if refused else ():
                self.get_logger().error(str(problem))
            return response
        return change_state


def spin(executor: SingleThreadedExecutor, node: ManagedNode, ending: Event) -> None:
    """
    Serve callbacks until it is ending; what one raises ends only that one.

    No wait is without a bound, and the executor is shut down only when this has returned: rclpy
    destroys with it what would wake it, and who is about to wait then would never be woken.
    """
    last, at = '', 0.0
    while not ending.is_set():
        try:
            executor.spin_once(LONGEST)
        except ExternalShutdownException:
            return
        except Exception:
            text = traceback.format_exc()
            if text != last or time.monotonic() > at + AGAIN:
                node.get_logger().error(text)
                last, at = text, time.monotonic()


def start(arguments: Sequence[str], stop: Event, role: Role = REPLACER) -> int:
    """
    Run the replacer, or another role, until told to stop.

    Signals are the caller's: rclpy would shut the context down under a loop that is publishing.
    Returns the exit status: 0, or 2 when it was given something it cannot start with; then there
    is one line on stderr for each problem. 1 when it failed to start for another reason.
    """
    try:
        blocks = check_files(arguments)
        place, mend = 'arguments', 'correct the arguments after --ros-args'
        try:
            rclpy.init(args=list(arguments), signal_handler_options=SignalHandlerOptions.NO)
            place, mend = 'node', 'correct its name, its parameters or its security files'
            node = ManagedNode(blocks=blocks, role=role)
        except (RuntimeError, ValueError) as error:  # what rcl raises, and rclpy for []
            raise Refused([BadInput(
                role.name, place, str(error).partition(', at /')[0], mend)]) from None
        check_addressed(node, blocks)
        return run_node(node, stop)
    except Refused as refused:
        print(refused, file=sys.stderr)
        return 2
    finally:
        rclpy.try_shutdown()


def run_node(node: ManagedNode, stop: Event) -> int:
    """Serve until told to stop, active at once if so configured; raise Refused, return status."""
    autostart = node.get_parameter_or('autostart', Parameter('autostart', value=True)).value
    if autostart is not False:  # what else it may be is looked at when it is configured
        for transit in (node.trigger_configure, node.trigger_activate):
            if transit() != SUCCESS:
                if node.refused is not None:
                    raise node.refused
                return 1
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    ending = Event()
    thread = Thread(target=spin, args=(executor, node, ending), name='executor')
    thread.start()
    try:
        node.serve(stop)
    finally:
        ending.set()
        executor.wake()
        thread.join()
        executor.shutdown()
        if not node.ended:
            node.trigger_shutdown()
        node.destroy_node()
    return 0
