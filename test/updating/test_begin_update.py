"""What `neo update` looks at before it looks at any bag."""
import math
from pathlib import Path

from neo_ros.errors import ConfigError
from neo_ros.updating.update import MARK, update, UpdateOptions
import pytest

pytestmark = pytest.mark.torch


def partial_of(tmp_path: Path, *names: str) -> Path:
    """Return a folder with files of these names where an update to `new` does its work."""
    folder = tmp_path / 'new.partial'
    folder.mkdir()
    for name in names:
        (folder / name).touch()
    return folder


@pytest.mark.parametrize('names', [(), (MARK, 'stale')], ids=['empty', 'with a mark'])
def test_what_an_update_left_goes(tmp_path: Path, names: tuple[str, ...]) -> None:
    folder = partial_of(tmp_path, *names)
    assert update(tmp_path / 'run', [], tmp_path / 'new') == [] and not folder.exists()


def test_killed_while_it_tidies_up_it_is_still_known_for_an_updates(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = partial_of(tmp_path, MARK)
    (folder / '0').mkdir()
    gone = list[Path]()
    monkeypatch.setattr('neo_ros.updating.update.shutil.rmtree',
                        lambda path, **_: gone.append(path))
    update(tmp_path / 'run', [], tmp_path / 'new')
    assert gone[:2] == [folder / '0', folder]  # The mark goes with the folder.


@pytest.mark.parametrize('kind', ['folder', 'file', 'link'])
def test_what_is_somebody_elses_stays(tmp_path: Path, kind: str) -> None:
    path = tmp_path / 'new.partial'
    if kind == 'folder':
        partial_of(tmp_path, 'holiday.jpg')
    elif kind == 'file':
        path.touch()
    else:
        partial_of(tmp_path, MARK).rename(tmp_path / 'elsewhere')
        path.symlink_to('elsewhere')
    before = {found: found.lstat().st_mtime_ns for found in tmp_path.rglob('*')}
    with pytest.raises(ConfigError, match='new.partial: expected nothing there, .*move it away'):
        update(tmp_path / 'run', [], tmp_path / 'new')
    assert {found: found.lstat().st_mtime_ns for found in tmp_path.rglob('*')} == before


@pytest.mark.parametrize('minutes', [0.0, -1.0, math.inf, math.nan])
def test_minutes_that_never_end_are_refused(minutes: float) -> None:
    with pytest.raises(ConfigError, match='--minutes: expected a number > 0, got'):
        UpdateOptions(minutes=minutes)
    with pytest.raises(ConfigError, match='--network-minutes: expected a number > 0, got'):
        UpdateOptions(network_minutes=minutes)
