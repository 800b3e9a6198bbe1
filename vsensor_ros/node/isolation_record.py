"""Where what the isolator has learnt of the healthy machine is kept between two runs."""

from __future__ import annotations

import os
from pathlib import Path
from threading import RLock

from vsensor_ros.bad_input import BadInput
from vsensor_ros.engine import Engine
from vsensor_ros.node.known import AUTO, NONE
from vsensor_ros.node.log import Log

EVERY = 600.0  # s between two times that it is saved


def default_path(node: str, design_hash: str) -> Path:
    """Return a path of a node's own, and of a design's, in the folder in which ROS keeps files."""
    home = Path(os.environ.get('ROS_HOME') or Path.home() / '.ros')
    return home / 'vsensor_ros' / f'{node.strip("/").replace("/", ".")}-{design_hash[:12]}.json'


class IsolationRecord:
    """One file. What is wrong with it is said in one line; then it is left as it is."""

    def __init__(self, given: str, node: str, design_hash: str, engine: Engine, lock: RLock,
                 log: Log) -> None:
        """
        Let the isolator of an engine go on from what was kept.

        given: a path, auto or none. lock: is held while others use the engine.
        """
        self.path = None if given == NONE else default_path(node, design_hash) if given == AUTO \
            else Path(os.path.expanduser(given))
        self._own = given == AUTO
        self._hash, self._engine, self._lock, self._log = design_hash, engine, lock, log
        self._load()

    def _load(self) -> None:
        """Go on from what was kept; a file that cannot be used is not touched."""
        if self.path is None or not self.path.exists():
            return
        try:
            if not self.path.is_file():  # reading a pipe would never end
                raise BadInput(self.path, 'isolation record', 'is not a regular file',
                               'name another')
            self._engine.go_on_from(self.path, self._hash)
        except BadInput as error:
            self._log.say(f'{error}; what is learnt now is not kept')
            self.path = None

    def keep(self) -> None:
        """
        Keep what was learnt; only copying it takes the lock.

        The old file stays whole until the new one is complete.
        """
        with self._lock:
            learnt = self._engine.learnt()
        if self.path is None or learnt is None:
            return
        try:
            if self._own:
                self.path.parent.mkdir(parents=True, exist_ok=True)
            learnt.save(self.path, self._hash)
        except (BadInput, OSError) as error:
            self._log.say(str(error), 'warning', 'isolation record')
