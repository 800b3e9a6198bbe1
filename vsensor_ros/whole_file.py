"""Write a text file so that nobody ever reads half of it."""

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
    if os.path.exists(path) and not os.path.isfile(path):
        Path(path).write_text(text, encoding='utf-8')
        return
    target = Path(os.path.realpath(path))
    beside = target.with_name(f'.{target.stem[:40]}.{secrets.token_hex(8)}')
    try:
        with open(beside, 'x', encoding='utf-8') as file:
            file.write(text)
        if target.exists():
            shutil.copymode(target, beside)
        os.replace(beside, target)
    finally:
        beside.unlink(missing_ok=True)
