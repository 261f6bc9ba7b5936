"""Files appear whole or not at all."""
from pathlib import Path

from neo_ros.machine.files import whole_file
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
