"""What is used of rclpy's private parts, and what is said when a release lacks some."""

from types import SimpleNamespace

import pytest

from vsensor_ros.bad_input import BadInput
from vsensor_ros.node import lifecycle
from vsensor_ros.node.parameters import Refused
from vsensor_ros.node.private_rclpy import lacking, PARTS


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
