"""Rows that were measured once are found again by the next run."""
from pathlib import Path

from neo_ros.machine.host import commit, host
from neo_ros.machine.result_rows import ResultRows


def test_rows_are_kept_one_by_one_and_found_again(tmp_path: Path) -> None:
    path = tmp_path / 'rows.json'
    key = {'scene': 'room', 'minutes': 3}
    assert ResultRows(path).find(key) is None
    ResultRows(path).add({**key, 'psnr': 25.0})
    ResultRows(path).add({'scene': 'room', 'minutes': 5, 'host': 'a GPU'})
    again = ResultRows(path)
    assert again.find(key) == {**key, 'psnr': 25.0, 'commit': commit(), 'host': host()}
    assert [row['host'] for row in again.rows] == [host(), 'a GPU']
    assert again.find({'scene': 'hall'}) is None
