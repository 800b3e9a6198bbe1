"""A robot of threads: drivers, a controller and a fault isolation, each a node of its own."""

import os
from pathlib import Path
import subprocess
import sys
from threading import Event, Thread
import time

# before any message class is loaded
os.environ['ROS_PYTHON_CHECK_FIELDS'] = '1'
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ.setdefault('AMENT_PREFIX_PATH', sys.prefix)
os.environ.setdefault('FASTRTPS_DEFAULT_PROFILES_FILE', str(
    Path(__file__).parents[2] / 'config' / 'fastdds_localhost.xml'))

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
import pytest
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from vsensor_ros import design, load_plant
from vsensor_ros.lab.domain import reserved_domain
from vsensor_ros.lab.process import die_with_parent
from vsensor_ros.node.accessor import put_stamp

ROOT = Path(__file__).parents[2]
KEPT = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PATIENCE = (3, 12, 50)  # s that a verb listens: a busy machine discovers late


class Robot:
    """Publishes what it is told to, until it is closed."""

    def __init__(self, domain):
        self.context = Context()
        self.context.init(domain_id=domain)
        self.domain, self.nodes, self.work, self.stop = domain, {}, [], Event()
        self.thread = Thread(target=self._run)
        self.thread.start()

    def _run(self):
        while not self.stop.is_set():
            for act in list(self.work):
                act()
            time.sleep(0.01)

    def node(self, name):
        if name not in self.nodes:
            self.nodes[name] = Node(name, context=self.context)
        return self.nodes[name]

    def drive(self, name, kind, topic, make, qos=10, late=0.0, whole=False):
        """Have a node publish what `make` of the time makes, stamped `late` s ago; whole: in s."""
        publisher = self.node(name).create_publisher(kind, topic, qos)

        def send():
            now = time.time_ns()
            message = make(now * 1e-9)
            if hasattr(message, 'header'):
                stamp = now - round(late * 1e9)
                put_stamp(message, stamp - stamp % 10**9 if whole else stamp)
            publisher.publish(message)
        self.work.append(send)

    def hear(self, name, kind, topic, qos=10):
        self.node(name).create_subscription(kind, topic, lambda message: None, qos)

    def isolate(self, topic='/isolation', sensors=('y1', 'y2', 'y3')):
        publisher = self.node('isolator').create_publisher(DiagnosticArray, topic, KEPT)
        publisher.publish(DiagnosticArray(status=[DiagnosticStatus(name=s) for s in sensors]))

    def run(self, verb, *arguments, cwd=None, **options):
        """Run a verb as a process on the domain of this robot."""
        return subprocess.run(
            [sys.executable, '-m', f'vsensor_ros.command.{verb}', *map(str, arguments)],
            env={**os.environ, 'ROS_DOMAIN_ID': str(self.domain), 'PYTHONPATH': str(ROOT)},
            capture_output=True, text=True, timeout=300, cwd=cwd or ROOT,
            preexec_fn=die_with_parent, **{'input': '', **options})

    def run_until(self, good, verb, *arguments, **options):
        """Run a verb, and if need be again with more patience; return what it said last."""
        for seconds in PATIENCE:
            done = self.run(verb, *arguments, '--for', seconds, **options)
            if good(done):
                break
        return done

    def close(self):
        self.stop.set()
        self.thread.join()
        for node in self.nodes.values():
            node.destroy_node()
        self.context.try_shutdown()


@pytest.fixture
def robot():
    with reserved_domain() as domain:
        made = Robot(domain)
        yield made
        made.close()


@pytest.fixture(scope='session')
def designs(tmp_path_factory):
    """Return the design files of two plants, by name."""
    folder = tmp_path_factory.mktemp('designs')
    files = {}
    for name in ('servo', 'three_tank'):
        files[name] = folder / f'{name}.design.json'
        design(load_plant(ROOT / 'config' / name / 'plant.yaml')).save(files[name])
    return files
