"""Recordings of real machines: found in VSENSOR_DATA, else fetched from their public origin."""

import hashlib
import os
from pathlib import Path
import re

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from vsensor_ros.bad_input import BadInput


class NoRecording(BadInput):
    """A recording that is not here and cannot be fetched."""


def find_recording(file: str, url: str, sha256: str) -> Path:
    """
    Return the path of a recording whose content has the checksum.

    `file` is its path in the folder that the environment variable VSENSOR_DATA names. If it is
    not there, `url` is fetched once and kept in the user's cache. Raise NoRecording if neither
    has it, BadInput if the content is another.
    """
    folder = os.environ.get('VSENSOR_DATA')
    if folder and (path := Path(folder) / file).is_file():
        found = hashlib.sha256(path.read_bytes()).hexdigest()
        if found != sha256:
            raise BadInput(str(path), 'sha256', f'is {found[:12]}.., not {sha256[:12]}..',
                           f'put the file of {url} there')
        return path
    problem = f'not in {folder}' if folder else 'VSENSOR_DATA is not set'
    mend = f'set VSENSOR_DATA to a folder that holds it, or give access to {url}'
    try:
        import pooch
    except ImportError:
        raise NoRecording(file, 'recording', f'{problem}, and pooch is not installed',
                          mend) from None
    pooch.get_logger().setLevel('ERROR')
    try:
        return Path(pooch.retrieve(url, f'sha256:{sha256}', Path(file).name,
                                   pooch.os_cache('vsensor_ros'),
                                   downloader=pooch.HTTPDownloader(timeout=10)))
    except OSError:         # no network, no such page
        raise NoRecording(file, 'recording', f'{problem}, and it cannot be fetched',
                          mend) from None
    except ValueError:      # the checksum
        raise BadInput(url, 'sha256', 'is not that of the recording', mend) from None


def load_columns(path: Path, columns: dict[str, str]) -> dict[str, NDArray[np.float64]]:
    """
    Return named columns of a MATLAB file, each of shape (T,).

    A column is written as its place in the file: `data.ydat[0]` is the first column of the array
    `ydat` of the structure `data`, `qm` an array that has one. Raise BadInput.
    """
    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False, appendmat=False)
    except (OSError, ValueError, TypeError, IndexError, NotImplementedError,
            MatReadError) as error:
        raise BadInput(str(path), 'recording', f'cannot be read ({str(error)[:80]})',
                       'give a MATLAB file of version 7.2 or older') from None
    return {name: _column(content, place, str(path)) for name, place in columns.items()}


def _column(content: dict[str, object], place: str, where: str) -> NDArray[np.float64]:
    match = re.fullmatch(r'([\w.]+?)(?:\[(\d+)\])?', place)
    if not match:
        raise BadInput(where, place, 'is no place in a MATLAB file', 'write it as data.ydat[0]')
    names, column = match[1].split('.'), match[2]
    found: object = content.get(names[0])
    for name in names[1:]:
        found = getattr(found, name) if name in getattr(found, '_fieldnames', ()) else None
    array = np.asarray(found if found is not None else np.nan)
    if array.ndim == 2 and column is not None and int(column) < array.shape[1]:
        array = array[:, int(column)]
    if array.ndim != 1 or array.dtype.kind not in 'fiu':
        raise BadInput(where, place, 'is not a column of numbers there',
                       'name an array, with [column] if it has several')
    return array.astype(float)
