"""Where what the isolator has learnt of the healthy machine is kept between two runs."""

from __future__ import annotations

import os
from pathlib import Path

from vsensor_ros.bad_input import BadInput
from vsensor_ros.engine import Engine, Learnt
from vsensor_ros.node.known import AUTO, NONE
from vsensor_ros.node.log import Log

EVERY = 600.0  # s between two times that it is saved


def default_path(node: str, design_hash: str) -> Path:
    """Return a path of a node's own, and of a design's, in the folder in which ROS keeps files."""
    home = Path(os.environ.get('ROS_HOME') or Path.home() / '.ros')
    return home / 'vsensor_ros' / f'{node.strip("/").replace("/", ".")}-{design_hash[:12]}.json'


class IsolationRecord:
    """One file. What is wrong with it is said in one line; then it is left as it is."""

    def __init__(self, given: str, node: str, design_hash: str, log: Log) -> None:
        """given: a path, auto or none."""
        self.path = None if given == NONE else default_path(node, design_hash) if given == AUTO \
            else Path(os.path.expanduser(given))
        self._own = given == AUTO
        self._hash, self._log = design_hash, log

    def load(self, engine: Engine) -> None:
        """Let the isolator go on from what was kept; a file that cannot be used is not touched."""
        if self.path is None or not self.path.exists():
            return
        try:
            if not self.path.is_file():  # reading a pipe would never end
                raise BadInput(self.path, 'isolation record', 'is not a regular file',
                               'name another')
            engine.go_on_from(self.path, self._hash)
        except BadInput as error:
            self._log.say(f'{error}; what is learnt now is not kept')
            self.path = None

    def save(self, learnt: Learnt | None) -> None:
        """Keep what was learnt; the old file stays whole until the new one is complete."""
        if self.path is None or learnt is None:
            return
        try:
            if self._own:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            learnt.save(self.path, self._hash)
        except (BadInput, OSError) as error:
            self._log.say(str(error), 'warning', 'isolation record')
