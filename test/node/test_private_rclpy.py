"""What is used of rclpy's private parts, and what is said when a release lacks some."""

from types import SimpleNamespace

import pytest
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node import lifecycle, private_rclpy
from vsensor_ros.node.parameters import Refused
from vsensor_ros.node.polling import drain, Polled, subscribe
from vsensor_ros.node.private_rclpy import (
    identifying_taker,
    IdentifyingTaker,
    lacking,
    PARTS,
)


def test_this_release_has_them_all():
    assert lacking() == []


def test_a_release_without_some_is_told_which_and_what_for():
    kinds = {kind: type(kind, (), {part: None for of, part in PARTS if of == kind})
             for kind, _ in PARTS}
    assert lacking(SimpleNamespace(**kinds)) == []
    del kinds['WaitSet'].wait
    assert lacking(SimpleNamespace(**kinds)) == [
        'WaitSet.wait (to wait for messages without an executor)']
    assert len(lacking(SimpleNamespace())) == len(PARTS)


def test_the_node_is_not_configured_without_them(rig, parameters, monkeypatch):
    monkeypatch.setattr(lifecycle, 'lacking', lambda: ['WaitSet.wait (to wait for messages)'])
    r = rig(parameters)
    with pytest.raises(Refused) as refused:
        lifecycle.ManagedNode._configure(r.replacer.node)
    problem, = refused.value.problems
    assert isinstance(problem, BadInput) and str(problem) == (
        '/replacer: rclpy: lacks WaitSet.wait (to wait for messages); use the one of ROS 2 Jazzy')


def test_who_sent_a_message_is_told_beside_what_rclpy_tells(rig, parameters):
    r = rig(parameters)
    end = subscribe(r.node, Polled(), String, '/text', QoSProfile(depth=10), overridden=False)
    both = subscribe(r.node, Polled(), String, '/text', QoSProfile(depth=10), overridden=False)
    publisher = r.publisher(String, '/text', subscribers=2)
    texts = ['a', 'b' * 100_000, '', 'c' * 10]  # the room for them grows, and stays
    for text in texts:
        publisher.publish(String(data=text))
    identify, told, plain = IdentifyingTaker(end), [], []

    def take():
        told.extend(iter(lambda: identify(String, True), None))
        plain.extend(drain(both))
        return len(told) == len(plain) == len(texts)
    assert r.spin_until(take)
    assert [deserialize_message(raw, String).data for raw, _ in told] == texts
    gid = bytes(r.node.get_publishers_info_by_topic('/text')[0].endpoint_gid)
    for (raw, info), (same, facts) in zip(told, plain, strict=True):
        assert raw == same and info['publisher_gid'] == gid
        assert info['source_timestamp'] == facts['source_timestamp']
        assert info['received_timestamp'] - info['source_timestamp'] >= 0
    r.node.destroy_subscription(end)
    with pytest.raises(private_rclpy._rclpy.InvalidHandle):
        identify(String, True)


def test_a_release_that_cannot_tell_who_sent_a_message(monkeypatch):
    def missing(name):
        raise OSError(f'{name}: cannot open shared object file')
    monkeypatch.setattr(private_rclpy.ctypes, 'PyDLL', missing)
    assert identifying_taker(None) is None
