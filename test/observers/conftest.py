from pathlib import Path
import sys

import pytest

sys.path.append(str(Path(__file__).parent))
from design_example import example


@pytest.fixture
def written(tmp_path):
    """Return where the example is written."""
    path = tmp_path / 'servo.design.json'
    example().save(path)
    return path
