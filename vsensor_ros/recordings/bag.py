"""Bags of ROS 2 (sqlite3 or mcap, compressed or not) and of ROS 1, one message after the other."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vsensor_ros.bad_input import BadInput

Progress = Callable[[int, int, str], None]

SUFFIXES = ('.bag', '.db3', '.mcap')
SHOWN = 2000  # messages between two looks at how far it is
MEND = 'name the folder of a rosbag2, its .db3 or .mcap file, or a .bag file of ROS 1'


def is_bag(path: Path) -> bool:
    """Tell whether a path looks like a bag."""
    return path.is_dir() or path.suffix in SUFFIXES


@dataclass(frozen=True)
class Bag:
    """An open bag."""

    path: Path
    form: str  # ROS 1 or ROS 2
    topics: Mapping[str, tuple[str, int]]  # by name: type (package/msg/Name), number of messages
    kinds: Mapping[str, Any]  # by type: its class
    _reader: Any

    def messages(self, topics: Collection[str],
                 progress: Progress | None = None) -> Iterator[tuple[str, int, bytes]]:
        """
        Yield topic, time of the recording [ns] and bytes (CDR) of each message on some topics.

        Raises BadInput.
        """
        from vsensor_ros.recordings.bag_kinds import cdr_of

        reader, total = self._reader, sum(self.topics[t][1] for t in topics)
        connections = [c for c in reader.connections if c.topic in topics]
        found = reader.messages(connections) if connections else iter(())
        count = 0
        while True:
            try:
                connection, recorded, raw = next(found)
                if self.form == 'ROS 1':
                    raw = cdr_of(self.kinds[connection.msgtype], raw)
            except StopIteration:
                return
            except Exception as error:  # whatever the libraries make of a broken file
                raise _broken(self.path, f'after {count} messages', error) from error
            if progress is not None and count % SHOWN == 0:
                progress(count, total, self.path.name)
            count += 1
            yield connection.topic, recorded, bytes(raw)


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """Open a bag; meanwhile its own types stand in for those installed. Raises BadInput."""
    from rosbags import rosbag1, rosbag2

    from vsensor_ros.node.field_path import standing_in  # these need ROS, and tables do not
    from vsensor_ros.recordings.bag_kinds import kinds_of

    ros1 = path.suffix == '.bag'
    reader: Any = None
    try:
        if not path.exists():
            raise FileNotFoundError('it is not there')
        reader = rosbag1.Reader(path) if ros1 else rosbag2.Reader(path)
        reader.open()
        kinds = kinds_of(_definitions(reader.connections))
    except Exception as error:  # whatever the libraries make of what is no bag
        raise _broken(path, '', error) from error
    try:
        topics: dict[str, tuple[str, int]] = {}
        for connection in reader.connections:
            kind, count = topics.get(connection.topic, (connection.msgtype, 0))
            topics[connection.topic] = kind, count + connection.msgcount
        with standing_in(kinds):
            yield Bag(path, 'ROS 1' if ros1 else 'ROS 2', topics, kinds, reader)
    finally:
        reader.close()


def _definitions(connections: Iterable[Any]) -> dict[str, Any]:
    """
    Return the types that a bag defines, and those of Jazzy, by name.

    They are parsed, no more: the stores of rosbags would make code of them, and run it.
    """
    from rosbags.interfaces import MessageDefinitionFormat as Format
    from rosbags.typesys import get_types_from_idl, get_types_from_msg, get_typestore, Stores

    found = dict(get_typestore(Stores.ROS2_JAZZY).fielddefs)  # not all bags define their types
    for connection in connections:
        form, text = connection.msgdef.format, connection.msgdef.data
        if form == Format.MSG:
            found.update(get_types_from_msg(text, connection.msgtype))
        elif form == Format.IDL:
            parts = [part.partition('\n')[2] for part in text.split(f'{"=" * 80}\n')
                     if part.startswith('IDL: ')]
            for part in parts or [text]:
                found.update(get_types_from_idl(part))
    return found


def _broken(path: Path, where: str, error: Exception) -> BadInput:
    said = ' '.join(str(error).split()) or type(error).__name__
    return BadInput(path, where, f'cannot be read ({said[:160]})', _mend(path, said))


def _mend(path: Path, said: str) -> str:
    """Return what helps: recorders that were killed leave bags that are not whole."""
    if 'magic' in said:
        return 'it was not closed: mcap recover FILE.mcap -o WHOLE.mcap, and name that'
    if 'malformed' in said:
        return 'it is cut off: sqlite3 FILE.db3 .recover | sqlite3 WHOLE.db3, and name that'
    if 'metadata' in said and path.is_dir() and any(f.suffix in SUFFIXES for f in path.iterdir()):
        return 'write it anew: ros2 bag reindex FOLDER; or name the file in it'
    return MEND
