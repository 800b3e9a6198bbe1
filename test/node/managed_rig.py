"""A managed node as `ros2 run` has it, in threads of this process, and an engineer beside it."""

import gc
from threading import Event, Thread
import time
from types import SimpleNamespace

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Log
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Range
from std_msgs.msg import Float64, String

from vsensor_ros.node import lifecycle, start
from vsensor_ros.node.lifecycle import ManagedNode, run_node

# What pytest holds is frozen for good in test/conftest.py: else each node would look through it.
THRIFTY = SimpleNamespace(collect=gc.collect, freeze=lambda: None, unfreeze=lambda: None)
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Machine:
    """The node, its drivers, and one who listens and calls services."""

    def __init__(self, parameters, ros_args=(), role=lifecycle.REPLACER):
        self.context = Context()
        self.context.init(args=['--ros-args', *ros_args])
        self.node = ManagedNode(
            self.context, [Parameter(name, value=value) for name, value in parameters.items()],
            role=role)
        self.engineer = Node('engineer', context=self.context, start_parameter_services=False)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.engineer)
        self.log = []
        self.engineer.create_subscription(Log, '/rosout', self.log.append, QoSProfile(
            depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self.clients = {}
        self.stop = Event()
        self.exit_status = None
        self.thread = Thread(target=self._run)
        self.thread.start()

    def _run(self):
        self.exit_status = run_node(self.node, self.stop)

    def end(self):
        """Stop the node as a signal does; return its exit status."""
        self.stop.set()
        self.thread.join(60.0)
        assert not self.thread.is_alive()
        return self.exit_status

    def close(self):
        self.end()
        self.executor.shutdown()
        self.engineer.destroy_node()
        self.context.try_shutdown()

    def spin_until(self, condition, timeout=60.0):
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                return False
            self.executor.spin_once(timeout_sec=0.01)
        return True

    def spin(self, seconds):
        self.spin_until(lambda: False, seconds)

    def call(self, kind, name, **fields):
        """Call a service of the node; return the response."""
        name = f'{self.node.get_fully_qualified_name()}/{name}'
        if name not in self.clients:
            self.clients[name] = self.engineer.create_client(kind, name)
        assert self.clients[name].wait_for_service(60.0), name
        future = self.clients[name].call_async(kind.Request(**fields))
        assert self.spin_until(future.done), name
        return future.result()

    def change(self, label):
        """Ask for a transition; return whether it succeeded, and the state afterwards."""
        changed = self.call(ChangeState, 'change_state', transition=Transition(label=label))
        return changed.success, self.call(GetState, 'get_state').current_state.label

    def listen(self, kind, topic, qos=10):
        """Return the list that the messages of a topic will go to."""
        heard = []
        self.engineer.create_subscription(kind, topic, heard.append, qos)
        return heard

    def drive(self):
        """Publish what the sensors of the plant read at rest, and its command, at 50 Hz."""
        publishers = [(self.engineer.create_publisher(Range, f'/y{i}_raw', 10), Range(range=value))
                      for i, value in ((1, 1.5), (2, 3.0), (3, 0.0))]
        publishers.append((self.engineer.create_publisher(Float64, '/u1', 10), Float64(data=1.5)))

        def send():
            now = self.engineer.get_clock().now().to_msg()
            for publisher, message in publishers:
                if isinstance(message, Range):
                    message.header.stamp = now
                publisher.publish(message)
        self.engineer.create_timer(0.02, send)

    def isolate(self, names):
        """Say which sensors are faulty, once the node hears it."""
        if 'isolation' not in self.clients:
            self.clients['isolation'] = self.engineer.create_publisher(String, '/isolation', KEPT)
        self.clients['isolation'].publish(String(data=names))

    def logged(self, text):
        """Return the log lines with a text in them."""
        return [line.msg for line in self.log if text in line.msg]


def machines(parameters):
    """Be the fixture that starts managed nodes with parameters beyond these; all end with it."""
    started = []
    discovery, start.DISCOVERY = start.DISCOVERY, 0.0  # what isolation said is waited for, still
    longest, lifecycle.LONGEST = lifecycle.LONGEST, 0.05  # s until its executor sees that it ends
    lifecycle.gc = THRIFTY

    def start_one(ros_args=(), role=lifecycle.REPLACER, **more):
        # a busy machine makes no driver silent, and no jump of the clock
        started.append(Machine({**parameters, 'isolation.type': 'std_msgs/msg/String',
                                'max_age': 60.0, 'max_jump': 60.0,
                                **{key.replace('__', '.'): more[key] for key in more}}, ros_args,
                               role))
        return started[-1]
    yield start_one
    for machine in started:
        machine.close()
    start.DISCOVERY, lifecycle.LONGEST, lifecycle.gc = discovery, longest, gc


def logged(capfd):
    """Return what tells how often a text was logged; /rosout loses lines on a busy machine."""
    said = []

    def count(text):
        said.append(capfd.readouterr().err)
        return ''.join(said).count(text)
    return count


def told(heard, name):
    """Return level, message and facts of a status, as told last."""
    for s in heard[-1].status if heard else ():
        if s.name == name:
            return s.level, s.message, {v.key: v.value for v in s.values}
    return b'', '', {}
