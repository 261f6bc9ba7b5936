"""Files that an evaluation leaves, on disks of all kinds."""
import errno
import os
from pathlib import Path

from neo_ros.errors import NeoError
from neo_ros.machine.files import share_file, write_bytes
import pytest


@pytest.mark.parametrize('links', [True, False], ids=['hard links', 'no hard links'])
def test_a_file_is_shared_or_copied(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool) -> None:
    def refuse(source: Path, target: Path) -> None:
        raise PermissionError(1, 'not on this disk')

    if not links:
        monkeypatch.setattr(os, 'link', refuse)
    source, target = tmp_path / 'source', tmp_path / 'target'
    source.write_bytes(b'new')
    target.write_bytes(b'old')
    share_file(source, target)
    assert target.read_bytes() == b'new'
    assert target.samefile(source) is links
    assert sorted(path.name for path in tmp_path.iterdir()) == ['source', 'target']


def test_a_file_that_cannot_be_shared_is_named(tmp_path: Path) -> None:
    with pytest.raises(NeoError, match='target: cannot write: No such file'):
        share_file(tmp_path / 'missing', tmp_path / 'target')


def test_a_file_that_cannot_be_written_whole_leaves_the_old_one(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / 'new' / 'run.json'
    write_bytes(path, b'old')

    def fill_disk(partial: Path, content: bytes) -> None:
        partial.open('wb').write(content[:1])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, 'write_bytes', fill_disk)
    with pytest.raises(NeoError, match='No space left on device; make room, and give'):
        write_bytes(path, b'new')
    assert path.read_bytes() == b'old' and [file.name for file in path.parent.iterdir()] == [
        'run.json']
