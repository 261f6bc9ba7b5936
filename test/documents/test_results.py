"""Tables of results: cells, columns without values, where the figures come from."""
import json
from pathlib import Path

from neo_ros.documents import results
from neo_ros.documents.results import rows, sources, stated, suite
from neo_ros.documents.tables import Column, Rows
from neo_ros.errors import NeoError
import pytest


@pytest.mark.parametrize('column, row, cell', [
    (Column('', 'a', '{:.1f}'), {'a': 1.26}, '1.3'),
    (Column('', 'a', '{:.0f} %', 100), {'a': 0.94}, '94 %'),
    (Column('', 'a.b'), {'a': {'b': 'x'}}, 'x'),
    (Column('', 'a.b'), {'a': None}, ''),
    (Column('', 'a', '`{}`'), {'a': 'naive'}, '`naive`'),
    (Column('', 'a'), {'a': 0}, '0'),
], ids=['digits', 'factor', 'inner', 'missing', 'text', 'zero'])
def test_a_cell_is_the_value_in_its_format(column: Column, row: dict, cell: str) -> None:
    assert column.cell(row) == cell


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make a checkout with results of two scenes, two methods and one thing that was noted."""
    files = {
        'few': [{'scene': scene, 'method': method, 'score': score, 'none': None,
                 'commit': commit, 'host': 'a machine'}
                for scene, method, score, commit in (
                    ('hall', 'ours', 2.0, 'abc'), ('hall', 'theirs', 1.0, 'abc'),
                    ('attic', 'ours', 3.0, 'def'))],
        'whole': {'commit': 'abc', 'host': {'cpu': 'another', 'commit': 'fed'}, 'records': [{}]},
        'sources': {'few': {'command': 'neo few', 'labels': {'ours': 'this one'}},
                    'whole': {'command': 'neo whole', 'note': 'noisy'}},
        'stated': {'old': {'command': 'neo old', 'commit': '123', 'host': 'gone', 'note': 'noted',
                           'columns': ['a', 'b'], 'rows': [['1', 2]]}}}
    (tmp_path / 'results').mkdir()
    for name, content in files.items():
        (tmp_path / 'results' / f'{name}.json').write_text(json.dumps(content))
    monkeypatch.setattr(results, 'TABLES', {'few': Rows(
        'few', (Column('who', 'method'), Column('empty', 'none'), Column('dB', 'score')),
        lambda row: row['scene'] == 'hall')})
    monkeypatch.setattr(results, 'MEASURES', {'score': ('{:.0f}', 10.0)})
    return tmp_path


def test_rows_have_their_words_and_no_empty_column(checkout: Path) -> None:
    assert rows(checkout, 'few').splitlines() == [
        '| who | dB |', '| --- | --- |', '| this one | 2.0 |', '| theirs | 1.0 |']


def test_a_suite_has_a_column_for_each_scene(checkout: Path) -> None:
    assert suite(checkout, 'few', 'score').splitlines()[2:] == [
        '| `ours` | 20 | 30 |', '| `theirs` | 10 |  |']


def test_sources_name_command_commits_and_machine(checkout: Path) -> None:
    few, whole, old = sources(checkout, 'few', 'whole', 'stated:old').splitlines()
    assert few.endswith('`neo few`; commit abc, def; a machine')
    assert whole.endswith('`neo whole`; commit fed; another; noisy')
    assert old.startswith('- [old](../../results/stated.json)')
    assert old.endswith('`neo old`; commit 123; gone; noted')


def test_what_was_noted_is_a_table(checkout: Path) -> None:
    assert stated(checkout, 'old').splitlines()[2] == '| 1 | 2 |'


def test_a_file_that_is_not_there_is_named(checkout: Path) -> None:
    (checkout / 'results/few.json').unlink()
    with pytest.raises(NeoError, match=r'results/few\.json: expected a JSON file'):
        rows(checkout, 'few')
