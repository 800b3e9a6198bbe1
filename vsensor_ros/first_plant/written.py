"""A plant file is written when it has shown that it can be read."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory

from vsensor_ros.bad_input import BadInput, reason
from vsensor_ros.plant import load_plant, Plant
from vsensor_ros.whole_file import write_whole


def write_plant(text: str, path: Path, force: bool = False) -> Plant:
    """
    Write a plant file that loads, and return its plant.

    Raises BadInput where there is a file already, unless force, and where it does not load.
    """
    if os.path.lexists(path) and not force:
        raise BadInput(path, '', 'is there already', 'name another file, or give --force')
    with TemporaryDirectory() as folder:
        trial = Path(folder) / 'plant.yaml'
        trial.write_text(text, encoding='utf-8')
        try:
            plant = load_plant(trial)
        except BadInput as error:
            raise BadInput('', error.key, error.problem, error.mend) from None
    try:
        write_whole(path, text)
    except (OSError, ValueError) as error:
        raise BadInput(path, '', f'cannot be written ({reason(error)})',
                       'name a file in a folder that is there') from error
    return plant
