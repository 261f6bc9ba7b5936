"""Files appear whole or not at all."""
from pathlib import Path

from neo_ros.machine.files import share_file, whole_file
import pytest


def test_a_file_appears_under_its_name_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / 'field.npz'
    path.write_text('old')
    with whole_file(path) as partial:
        partial.write_text('new')
        assert partial.parent == tmp_path and path.read_text() == 'old'
    assert path.read_text() == 'new' and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize('error', [OSError('disk full'), KeyboardInterrupt()])
def test_what_ends_the_writing_leaves_the_old_file(tmp_path: Path, error: BaseException) -> None:
    path = tmp_path / 'field.npz'
    path.write_text('old')
    with pytest.raises(type(error)), whole_file(path) as partial:
        partial.write_text('ha')
        raise error
    assert path.read_text() == 'old' and list(tmp_path.iterdir()) == [path]


def test_of_a_relative_link_its_file_is_shared(tmp_path: Path) -> None:
    for name in ('a', 'b/c'):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / 'photo.png').write_text('photo')
    (tmp_path / 'a/link.png').symlink_to('../photo.png')
    share_file(tmp_path / 'a/link.png', tmp_path / 'b/c/0.png')
    assert (tmp_path / 'b/c/0.png').read_text() == 'photo'
    assert (tmp_path / 'b/c/0.png').samefile(tmp_path / 'photo.png')
