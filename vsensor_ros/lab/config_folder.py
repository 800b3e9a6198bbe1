"""Where the systems of this package are."""

import os
from pathlib import Path
import sys


def config_folder() -> Path | None:
    """Return the folder of the systems: the repository's, else the installed one, if any."""
    roots = [Path(prefix) / 'share' / 'vsensor_ros'
             for prefix in [*os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep), sys.prefix]
             if prefix]
    return next((root / 'config' for root in [Path(__file__).parents[2], *roots]
                 if (root / 'config').is_dir()), None)
