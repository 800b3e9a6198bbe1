"""A machine that was healthy for six minutes, learnt once and copied for each test."""

from copy import deepcopy
from functools import cache
from pathlib import Path
import sys

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from three_sensors import Machine


@cache
def _learnt():
    machine = Machine()
    verdict = machine.run(360.0)
    assert verdict.state == 'healthy' and verdict.notes == ()
    return machine


@pytest.fixture
def machine():
    return deepcopy(_learnt())
