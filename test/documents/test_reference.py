"""Tables of the reference: settings with the comments beside them, commands."""
from pathlib import Path

from neo_ros.documents.reference import commands, fields, rooms, words
from neo_ros.errors import NeoError
import pytest

SOURCE = """
MOST = 7


class Config:
    '''Words.'''

    plain: int = 3  # beside it
    bare: str
    named: int = MOST
    # above it,
    # in two lines
    above: float | None = None

    other: str = 'a'
    group: Part = Part()   # a | b
    quiet: int = 1  # noqa: A003
"""


def test_fields_have_their_comments(tmp_path: Path) -> None:
    (tmp_path / 'x.py').write_text(SOURCE)
    assert fields(tmp_path, 'x.py', 'Config', 'part.').splitlines()[2:] == [
        '| `part.plain` | int | `3` | beside it |',
        '| `part.bare` | str | required |  |',
        '| `part.named` | int | `7` |  |',
        r'| `part.above` | float \| None | `None` | above it, in two lines |',
        "| `part.other` | str | `'a'` |  |",
        r'| `part.group` | Part |  | a \| b |',
        '| `part.quiet` | int | `1` |  |']
    with pytest.raises(NeoError, match='expected the class Confg'):
        fields(tmp_path, 'x.py', 'Confg')
    assert words(tmp_path, 'x.py', 'Config') == 'Words.'


def test_rooms_have_what_the_law_says(tmp_path: Path) -> None:
    for path, text in (
            ('test/test_import_law.py',
             "LAW: dict[str, set[str]] = {'cellar': {'numba'}, "
             "'hall': {'cellar', 'plan', 'cv2'}}"),
            ('neo_ros/cellar/__init__.py', ''), ('neo_ros/plan.py', ''),
            ('neo_ros/hall/__init__.py', '"""Where all\nmeet.\n\nMore.\n"""')):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text(text)
    assert rooms(tmp_path).splitlines()[2:] == [
        '| `cellar` |  |  | numba |', '| `hall` | Where all meet. | `cellar`, `plan` | cv2 |']


def test_commands_have_their_options() -> None:
    text = commands(Path())
    train = text[text.index('## neo train'):text.index('## neo evaluate')]
    assert '| `--out` | required | Folder for the model' in train
    assert '| `SCENE` | required |' in train and '`--cache-gb` | `0.0`' in train
    assert '| `--watch`, `--no-watch` |  |' in text
    # Also of what is in a group.
    compact = text[text.index('## neo memory compact'):]
    assert '| `MODEL` | required |' in compact
