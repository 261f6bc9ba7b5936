"""Parts of the page that need no browser."""
from pathlib import Path
import shutil
import subprocess

import neo_ros
import pytest

PAGE = Path(neo_ros.__file__).parent / 'viewer' / 'page'
PARTS = Path(__file__).parents[1] / 'helpers' / 'page_parts.mjs'


@pytest.mark.parametrize('name', [
    'shortest', 'sleep', 'seen', 'loads', 'silence', 'overtaken', 'clock'])
def test_a_part_of_the_page_does_what_it_says(tmp_path: Path, name: str) -> None:
    node = shutil.which('node')
    if node is None:
        pytest.skip('needs node: apt install nodejs')
    page = shutil.copytree(PAGE, tmp_path / 'page')
    (page / 'package.json').write_text('{"type": "module"}')
    result = subprocess.run([node, PARTS, page, name], capture_output=True, text=True,
                            check=False)
    assert result.returncode == 0, result.stderr
