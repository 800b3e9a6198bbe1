"""Read a text file from outside whole, or say in one line what is wrong with it, and where."""

from __future__ import annotations

from codecs import BOM_UTF8
import os
from pathlib import Path
import re

from vsensor_ros.bad_input import BadInput, reason, shown

_NO_TEXT = re.compile('[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x84\x86-\x9f\ufffe\uffff]')
_BEFORE = 20  # characters shown before a wrong byte, to find it by


def read_text(path: str | Path, key: str, mend: str, largest: int) -> str:
    """
    Return the text of a UTF-8 file, without a byte order mark; raise BadInput.

    key: that of a problem with the whole file; mend: which file to name; largest: bytes of it.
    """
    try:
        with open(path, 'rb') as file:
            data = file.read(largest + 1)
    except (OSError, ValueError) as error:
        raise BadInput(path, key, f'cannot be read ({reason(error)}){looked_in(path)}',
                       mend) from None
    if len(data) > largest:
        raise BadInput(path, key, f'is larger than {largest // 2**20} MiB', mend)
    data = data.removeprefix(BOM_UTF8)
    try:
        text = data.decode('utf-8')
    except UnicodeDecodeError as error:
        line, before = _place(data[:error.start].decode('utf-8'))
        raise BadInput(path, key, f'is not UTF-8: line {line}, byte 0x{data[error.start]:02x}'
                       f'{before}', 'save it as UTF-8') from None
    if wrong := _NO_TEXT.search(text):
        line, before = _place(text[:wrong.start()])
        raise BadInput(path, key, f'is not a text file: line {line}, character '
                       f'0x{ord(wrong[0]):02x}{before}', mend)
    return text


def _place(text: str) -> tuple[int, str]:
    """Return the line in which a text ends, and what stands before its end there, to be shown."""
    before = text[text.rfind('\n') + 1:][-_BEFORE:]
    return text.count('\n') + 1, f' after {shown(before)}' if before.strip() else ''


def looked_in(path: str | Path) -> str:
    """Return where a relative path begins, to be put behind what is wrong; '' of a full one."""
    if os.path.isabs(path):
        return ''
    try:
        folder = os.getcwd()
    except OSError:
        folder = 'which is gone'
    home = ', and ~ is not the home directory here' if str(path).startswith('~') else ''
    return f'; relative paths begin in the working directory, {folder}{home}'
