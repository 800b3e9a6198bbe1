"""Saving a design: whole or not at all, to wherever the path leads."""

import json
import os
from pathlib import Path
import stat
from threading import Thread

from design_example import example
import pytest

from vsensor_ros import Design
from vsensor_ros.bad_input import BadInput
from vsensor_ros.observers.file import VERSION


def test_failed_save_leaves_the_old_file_whole(written, monkeypatch):
    before = written.read_bytes()

    def broken(*_):
        raise OSError(28, 'No space left on device')
    monkeypatch.setattr('os.replace', broken)
    with pytest.raises(BadInput, match='No space left'):
        example().save(written)
    assert written.read_bytes() == before
    assert list(written.parent.iterdir()) == [written]


@pytest.mark.parametrize('path', ['no/such/folder.json', '', '.', 'a\0b', 'x' * 300])
def test_save_where_nothing_can_be_written_says_so(tmp_path, path):
    with pytest.raises(BadInput, match='cannot be written'):
        example().save(tmp_path / path)
    assert not list(tmp_path.iterdir())


def test_save_keeps_links_and_modes(written):
    link, dangling = written.with_name('link'), written.with_name('dangling')
    link.symlink_to(written.name)
    dangling.symlink_to('new.json')
    written.chmod(0o640)
    old = os.umask(0o027)
    try:
        for path in (link, dangling):
            example().save(path)
            assert path.is_symlink()
    finally:
        os.umask(old)
    mode = {path.name: stat.S_IMODE(path.lstat().st_mode) for path in written.parent.iterdir()}
    assert mode == {**mode, written.name: 0o640, 'new.json': 0o640} and len(mode) == 4
    assert Design.load(dangling).entries.keys() == Design.load(link).entries.keys()


def test_save_writes_into_a_pipe_and_a_device(tmp_path):
    pipe, read = tmp_path / 'pipe', []
    os.mkfifo(pipe)
    reader = Thread(target=lambda: read.append(json.loads(pipe.read_text())), daemon=True)
    reader.start()
    example().save(pipe)
    reader.join(10.0)
    assert read[0]['version'] == VERSION and list(tmp_path.iterdir()) == [pipe]
    example().save('/dev/null')
    assert stat.S_ISCHR(Path('/dev/null').stat().st_mode)


