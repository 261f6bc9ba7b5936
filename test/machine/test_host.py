"""What is said of this machine and this checkout beside a figure."""
from pathlib import Path
import subprocess

from neo_ros.machine import host
import pytest


def test_a_commit_is_dirty_by_code_and_settings_alone(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*arguments: str) -> None:
        subprocess.run(['git', '-c', 'user.name=n', '-c', 'user.email=e@x', *arguments],
                       cwd=tmp_path, check=True, capture_output=True)

    commit = host.commit.__wrapped__  # The answer is kept, and here it changes.
    monkeypatch.setattr(host, '__file__', str(tmp_path / 'neo_ros/machine/x.py'))
    assert commit() is None
    for name in ('neo_ros', 'config', 'results'):
        (tmp_path / name).mkdir()
        (tmp_path / name / 'file').write_text('before')
    git('init')
    assert commit() is None
    git('add', '.')
    git('commit', '-m', 'first')
    clean = commit()
    assert clean and '-' not in clean
    (tmp_path / 'results/file').write_text('after')
    assert commit() == clean
    (tmp_path / 'config/file').write_text('after')
    assert commit() == f'{clean}-dirty'
