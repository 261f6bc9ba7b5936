"""Many bags in one command: names, failures, what is finished, the same bytes as one by one."""
import json
import math
from pathlib import Path
import shutil

from bag_files import write_text_bag, write_walk_bag
import box_room
from neo_ros.bags import BagReader, write_demo_bag
from neo_ros.cli.main import app
from neo_ros.errors import BagError, ConfigError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.memory.journal import journal_path
from neo_ros.replaying import bag_jobs
from neo_ros.replaying.bag_replayer import BagReplayer, ReplayOptions
from neo_ros.replaying.many_bags import replay_bags
from neo_ros.replaying.summary import ReplayedBag, summary_of, summary_table
from neo_ros.runtime.model_file import open_model
import pytest
from tiny_model import write_tiny_model
from typer.testing import CliRunner, Result

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
TRUTH = '/camera/wide/image_raw'


@pytest.fixture
def bags(tmp_path: Path) -> list[Path]:
    """Three bags of a walk, of other lengths, with the truth, beside the model m.onnx."""
    write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    return [write_walk_bag(tmp_path / 'in' / name, EXPANSION, count)
            for name, count in (('one', 2), ('two', 3), ('three', 4))]


def run(folder: Path, bags: list[Path], *options: object) -> Result:
    """Replay bags into `out` with the model m.onnx, both of the folder."""
    return CliRunner().invoke(app, [str(word) for word in (
        'replay', *bags, '--model', folder / 'm.onnx', '--out', folder / 'out', *options)])


def files(folder: Path) -> dict[str, bytes]:
    """Return the content of all files of a folder but the one that names it."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob('*')
            if path.is_file() and path.name != bag_jobs.DONE_FILE}


def summary(folder: Path) -> dict[str, dict]:
    """Return what bags.json says of each bag."""
    found = json.loads((folder / 'out' / 'bags.json').read_text())
    return {row['name']: row for row in found['bags']}


def test_each_bag_becomes_what_it_is_by_itself(tmp_path: Path, bags: list[Path]) -> None:
    result = run(tmp_path, bags, '--score')
    assert result.exit_code == 0, result.output
    for text in ('replaying, bags 3/3', '3 of 3 bags', TRUTH, 'report.html'):
        assert text in result.output.replace('\n', ''), 'a path may be longer than a line'
    assert {path.name for path in (tmp_path / 'out').iterdir()} == {
        'one', 'two', 'three', 'bags.json', 'report.html'}
    for bag in bags:
        alone = tmp_path / 'alone' / bag.name
        replayer = BagReplayer(tmp_path / 'm.onnx')
        found = replayer.replay(bag, alone, ReplayOptions(score=True))
        assert found.scores is not None
        found.scores.write(alone, found.about)
        assert files(tmp_path / 'out' / bag.name) == files(alone)
        row = summary(tmp_path)[bag.name]
        assert row['frames'] == row['scored'] == len(found.scores.rows)
        assert row['ring_psnr'] == found.scores.mean['ring_psnr']
        assert (row['error'], row['rejected'], row['lost'], row['guided']) == ('', {}, 0, None)


def test_a_bag_leaves_no_trace_in_the_next_one(tmp_path: Path) -> None:
    model = box_room.write_box_model(tmp_path)
    poses = box_room.box_walk(6)
    bags = [tmp_path / 'first', tmp_path / 'second']
    for bag, part in zip(bags, (poses[:3], poses[3:])):
        write_demo_bag(bag, [(i * 100_000_000, box_room.view(
            pose, box_room.EXPANSION.target)[0], pose) for i, pose in enumerate(part)],
            box_room.EXPANSION)
    options = ReplayOptions(outputs=('pose', 'status', 'depth'))
    rows = replay_bags(bags, model, tmp_path / 'out', options)
    assert [row.guided for row in rows] == [3, 3]
    for bag in bags:
        # One core, as in a worker of a cluster.
        BagReplayer(model, threads=1).replay(bag, tmp_path / 'alone' / bag.name, options)
        assert files(tmp_path / 'out' / bag.name) == files(tmp_path / 'alone' / bag.name)


def test_an_empty_journal_beside_the_memory_says_nothing(tmp_path: Path) -> None:
    model = box_room.write_box_model(tmp_path)
    card, options = open_model(model)[1], ReplayOptions()
    before = bag_jobs.asked_of_all(model, card, options)
    journal = journal_path(tmp_path / 'box.memory')
    journal.touch()  # As a disk that was full leaves it.
    assert bag_jobs.asked_of_all(model, card, options) == before
    journal.write_bytes(b'something')
    assert bag_jobs.asked_of_all(model, card, options) != before


def test_one_bag_is_the_folder_itself(tmp_path: Path, bags: list[Path]) -> None:
    result = run(tmp_path, bags[:1], '--score')
    assert result.exit_code == 0, result.output
    assert {path.name for path in (tmp_path / 'out').iterdir()} == {
        'out.mcap', 'metadata.yaml', 'scores.csv', 'scores.json', 'report.html'}


@pytest.mark.parametrize('name', ['two', 'two.mcap', 'two.db3.zstd'])
def test_names_that_clash_are_named(tmp_path: Path, bags: list[Path], name: str) -> None:
    other = tmp_path / 'other' / name
    with pytest.raises(ConfigError, match=rf'in/two, .*other/{name}: expected bags of different'):
        replay_bags([*bags, other], tmp_path / 'm.onnx', tmp_path / 'out', ReplayOptions())
    assert not (tmp_path / 'out').exists()


def test_a_bag_may_not_have_the_name_of_the_summary(tmp_path: Path, bags: list[Path]) -> None:
    named = shutil.copytree(bags[0], tmp_path / 'report.html')
    with pytest.raises(ConfigError, match='report.html is kept'):
        replay_bags([*bags, named], tmp_path / 'm.onnx', tmp_path / 'out', ReplayOptions())


def test_bags_that_fail_are_told_and_the_others_go_on(tmp_path: Path, bags: list[Path]) -> None:
    other_camera = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, 1.0), 64, 48)
    bags = [write_text_bag(tmp_path / 'in' / 'no camera', 3), *bags,
            write_walk_bag(tmp_path / 'in' / 'other', other_camera, 2),
            tmp_path / 'in' / 'nowhere', write_walk_bag(tmp_path / 'in' / 'cut', EXPANSION, 20)]
    for bag, kept in (('one', 100), ('cut', 200_000)):
        storage = tmp_path / 'in' / bag / f'{bag}.mcap'
        storage.write_bytes(storage.read_bytes()[:kept])
    result = run(tmp_path, bags)
    assert result.exit_code == 1
    rows = summary(tmp_path)
    assert list(rows) == ['no camera', 'one', 'two', 'three', 'other', 'nowhere', 'cut']
    failed = {name for name, row in rows.items() if row['error']}
    assert failed == {'no camera', 'one', 'other', 'nowhere'}
    assert 'no such bag' in rows['nowhere']['error']
    assert 0 < rows['cut']['frames'] < 20 and rows['cut']['lost'] > 0
    assert {path.name for path in (tmp_path / 'out').iterdir() if path.is_dir()} == {
        'two', 'three', 'cut'}
    words = ' '.join(result.output.split())
    for text in ('3 of 7 bags', 'one failed:', 'no such bag', 'cut: cut.mcap:', '4 failed'):
        assert text in words
    page = (tmp_path / 'out' / 'report.html').read_text()
    assert 'no such bag' in page and 'cut.mcap:' in page


def test_what_is_finished_is_not_done_again(
        tmp_path: Path, bags: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    replayed, real = [], BagReplayer.replay

    def breaks_off(self: BagReplayer, bag: Path, *others, **options) -> object:
        found = real(self, bag, *others, **options)
        replayed.append(bag.name)
        if replayed == ['one', 'two']:
            raise KeyboardInterrupt
        return found

    monkeypatch.setattr(BagReplayer, 'replay', breaks_off)
    assert run(tmp_path, bags, '--score').exit_code != 0
    before = files(tmp_path / 'out' / 'one')
    # As after a kill.
    (tmp_path / 'out' / '.partial' / 'two.abc' / 'two').mkdir(parents=True)
    assert run(tmp_path, bags, '--score').exit_code == 0
    assert replayed == ['one', 'two', 'two', 'three']
    assert files(tmp_path / 'out' / 'one') == before
    assert not (tmp_path / 'out' / '.partial').exists()
    rows = summary(tmp_path)
    assert [row['frames'] for row in rows.values()] == [2, 3, 4]
    assert all(row['ring_psnr'] > 0 for row in rows.values())


def test_what_was_made_of_something_else_is_not_taken_for_finished(
        tmp_path: Path, bags: list[Path]) -> None:
    assert run(tmp_path, bags).exit_code == 0
    write_tiny_model(tmp_path / 'm.onnx', EXPANSION, scene_id='b')
    with pytest.raises(BagError, match=r'out/.*exists already.*differs: model\)'):
        replay_bags(bags, tmp_path / 'm.onnx', tmp_path / 'out', ReplayOptions())
    with pytest.raises(BagError, match=r'differs: .*options'):
        replay_bags(bags, tmp_path / 'm.onnx', tmp_path / 'out', ReplayOptions(copy=False))


def test_a_bag_that_was_made_of_something_else_does_not_stop_the_others(
        tmp_path: Path, bags: list[Path]) -> None:
    assert run(tmp_path, bags[:2]).exit_code == 0
    shutil.rmtree(tmp_path / 'in' / 'two')
    write_walk_bag(tmp_path / 'in' / 'two', EXPANSION, 4)
    before = files(tmp_path / 'out' / 'two')
    result = run(tmp_path, bags)
    assert result.exit_code == 1
    words = ' '.join(result.output.split())
    assert 'two failed:' in words and '(differs: bytes); remove it or choose' in words
    rows = summary(tmp_path)
    assert [row['frames'] for row in rows.values()] == [2, 0, 4] and rows['two']['error']
    assert files(tmp_path / 'out' / 'two') == before


def test_one_bag_joins_a_folder_of_several(tmp_path: Path, bags: list[Path]) -> None:
    assert run(tmp_path, bags[:2]).exit_code == 0
    result = run(tmp_path, bags[2:])
    assert result.exit_code == 0, result.output
    assert {path.name for path in (tmp_path / 'out').iterdir() if path.is_dir()} == {
        'one', 'two', 'three'}


def test_folders_of_others_are_left_alone(tmp_path: Path, bags: list[Path]) -> None:
    with pytest.raises(BagError, match=r'one: exists already.*no replay.json'):
        replay_bags(bags, tmp_path / 'm.onnx', tmp_path / 'in', ReplayOptions())
    with pytest.raises(BagError, match='is a bag itself.*single one; remove'):
        replay_bags(bags[1:], tmp_path / 'm.onnx', bags[0], ReplayOptions())


def test_a_second_run_keeps_out_of_the_folder(tmp_path: Path, bags: list[Path]) -> None:
    def show(stage: str, done: int, total: int, note: str = '') -> None:
        if stage == 'replaying, bags' and done == 1:
            with pytest.raises(BagError, match='another neo replay writes there'):
                replay_bags(bags, tmp_path / 'm.onnx', tmp_path / 'out', ReplayOptions())
            refused.append(done)

    refused: list[int] = []
    replay_bags(bags, tmp_path / 'm.onnx', tmp_path / 'out', ReplayOptions(), progress=show)
    assert refused == [1]


@pytest.mark.parametrize(('count', 'options', 'message'), [
    (3, ['--side-by-side', 'a.mp4'], '--side-by-side: of one bag only'),
    (3, ['--learn'], '--learn: what is learnt from one bag'),
    (1, ['--cluster'], '--cluster: it shares out several bags')],
    ids=['video', 'learn', 'cluster of one'])
def test_options_that_make_no_sense_are_refused(
        tmp_path: Path, bags: list[Path], count: int, options: list[str], message: str) -> None:
    result = run(tmp_path, bags[:count], *options)
    assert isinstance(result.exception, ConfigError) and message in str(result.exception)
    assert not (tmp_path / 'out').exists()


def test_scores_of_two_kinds_have_no_mean() -> None:
    truth = ReplayedBag('a', '/a', frames=4, guided=1, scored=2, ring_psnr=20.0, truth_topic='/t')
    own = ReplayedBag('b', '/b', frames=4, guided=4, scored=6, ring_psnr=12.0)
    assert summary_of([truth, own])['ring_psnr'] is None
    assert summary_of([truth, truth])['ring_psnr'] == 20.0
    columns, lines = summary_table([truth, own, ReplayedBag('c', '/c', lost=None, error='gone')])
    assert columns == ['bag', 'frames', 'guided', 'ring PSNR, dB', 'scored against',
                       'messages lost']
    assert lines == [['a', '4', '25%', '20.00', '/t', ''],
                     ['b', '4', '100%', '12.00', 'its own border', ''],
                     ['c', 'failed', '', '', '', 'unknown'],
                     ['2 of 3 bags', '8', '62%', '', '', '']]


def test_the_new_bag_can_be_read(tmp_path: Path, bags: list[Path]) -> None:
    assert run(tmp_path, bags, '--no-copy').exit_code == 0
    with BagReader(tmp_path / 'out' / 'three') as reader:
        names = [message.topic.name for message in reader.messages()]
        assert not reader.damages
    assert names.count('/camera/wide/image') == 4 and '/camera/image_raw' not in names
