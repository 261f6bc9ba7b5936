"""The commands of docs/guides/your-own-robot.md, as they stand there, on a generated bag."""
import csv
from dataclasses import asdict, replace
from pathlib import Path
import shlex

import neo_ros
from neo_ros.bags import BagReader, write_demo_bag
from neo_ros.cli.main import app
from neo_ros.geometry import Intrinsics, ViewExpansion
import pytest
from typer.testing import CliRunner
import yaml

pytestmark = pytest.mark.slow

DOCUMENT = Path(neo_ros.__file__).parent.parent / 'docs' / 'guides' / 'your-own-robot.md'
EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 32, 1.5708), 64, 64)
FRAMES = 60


def documented(word: str) -> list[str]:
    """Return the first documented command line that begins with `neo WORD`, without `neo`."""
    line = next(line.strip() for line in DOCUMENT.read_text().splitlines()
                if line.startswith(f'    neo {word} '))
    return shlex.split(line)[1:]


def run(arguments: list[str]) -> str:
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, f'{arguments}: {result.output} {result.exception!r}'
    return result.output


def write_drive(path: Path) -> None:
    """Render a walk through the demo flat; the bag has no wide truth, like a robot's own."""
    from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
    from neo_ros.flat.scene_writing import render_demo_views
    walk = walking_paths(build_demo_flat(), 1, FRAMES, 3)[0]
    images = render_demo_views(EXPANSION.target, walk, workers=1)
    write_demo_bag(path, ((1_000_000_000 + 100_000_000 * index, image, pose)
                          for index, (image, pose) in enumerate(zip(images, walk))), EXPANSION)


@pytest.mark.timeout(300)
@pytest.mark.skipif(not DOCUMENT.is_file(), reason='the tested neo_ros is not a source checkout')
def test_from_a_bag_to_the_widened_view(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip('torch')
    from tiny_training import TINY
    monkeypatch.chdir(tmp_path)
    write_drive(Path('drive'))
    settings = replace(TINY, memory=None, outpaint=replace(TINY.outpaint, steps=4))
    Path('tiny.yaml').write_text(yaml.safe_dump(asdict(settings)))

    assert 'Next: neo import drive out/scenes/drive' in run(documented('bag-info'))
    assert 'Next: neo train out/scenes/hall' in run(
        [*documented('import'), '--image-topic', '/camera/image_raw'])
    assert Path('out/scenes/hall/capture.html').is_file()
    *train, minutes, _ = documented('train')
    assert minutes == '--minutes'  # Tiny steps take none.
    run([*train, '--config', 'tiny.yaml'])
    assert 'Next: neo view --bag out/hall_wide' in run(
        [*documented('replay'), '--image-topic', '/camera/image_raw'])
    with BagReader('out/hall_wide') as bag:
        counts = {topic.name: topic.count for topic in bag.topics}
    assert counts['/camera/wide/image'] == counts['/camera/image_raw'] == FRAMES
    with open('out/hall_wide/scores.csv', encoding='utf-8') as file:
        assert len(list(csv.DictReader(file))) == FRAMES
    assert Path('out/hall_wide/report.html').is_file()


def test_the_view_command_takes_what_is_documented() -> None:
    pytest.importorskip('aiohttp')
    assert documented('view') == ['view', '--bag', 'out/hall_wide']
    assert '--bag' in run(['view', '--help'])
    result = CliRunner().invoke(app, documented('view'))
    assert 'out/hall_wide: no such bag' in str(result.exception)
