"""The engine: decides who serves each channel and what goes out; knows no ROS."""

from vsensor_ros.engine.bumpless import Bumpless
from vsensor_ros.engine.commands import CommandState
from vsensor_ros.engine.decision import CannotServe, Decision, Source
from vsensor_ros.engine.engine import Engine
from vsensor_ros.engine.events import (
    ANYBODYS,
    Composition,
    Forward,
    Functional,
    IsolationReport,
    Remark,
    Reserve,
    Substitute,
    together,
)
from vsensor_ros.engine.fault_sizes import SizeNow
from vsensor_ros.engine.own_isolator import Learnt, SOURCE
from vsensor_ros.engine.policy import Policy
from vsensor_ros.engine.settings import Live, Setup, StreamPlan
from vsensor_ros.engine.state import ChannelState, EngineState
from vsensor_ros.engine.switch import Switch

__all__ = [
    'ANYBODYS',
    'SOURCE',
    'Bumpless',
    'CannotServe',
    'ChannelState',
    'CommandState',
    'Composition',
    'Decision',
    'Engine',
    'EngineState',
    'Forward',
    'Functional',
    'IsolationReport',
    'Learnt',
    'Live',
    'Policy',
    'Remark',
    'Reserve',
    'Setup',
    'SizeNow',
    'Source',
    'StreamPlan',
    'Substitute',
    'Switch',
    'together',
]
