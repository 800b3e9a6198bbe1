import sys

import pytest


@pytest.fixture(scope='module')
def without_alternatives():
    """Let refusals look for no alternative, which takes long; test_bounded.py asks for them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys.modules['vsensor_ros.designer.design'], 'alternative', lambda _: '')
        yield
