"""Write a file so that nobody ever reads half of it."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import secrets
import shutil


def write_whole(path: str | Path, text: str) -> None:
    """
    Write a text; an old file stays whole until the new one is complete.

    A link stays a link, the mode is kept, a pipe or a device is written into. Raises OSError, or
    ValueError for what is no path.
    """
    with written_whole(path) as beside, open(beside, 'w', encoding='utf-8') as file:
        file.write(text)


@contextmanager
def written_whole(path: str | Path) -> Iterator[Path]:
    """
    Give the path of a new file to write to, which takes the place of `path` when that is done.

    As `write_whole` says. If it is not done, or is ended, all is as it was.
    """
    if os.path.exists(path) and not os.path.isfile(path):
        yield Path(path)
        return
    target = Path(os.path.realpath(path))
    beside = target.with_name(f'.{target.stem[:40]}.{secrets.token_hex(8)}')
    try:
        beside.open('x').close()
        yield beside
        if target.exists():
            shutil.copymode(target, beside)
        os.replace(beside, target)
    finally:
        beside.unlink(missing_ok=True)
