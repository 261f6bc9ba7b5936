"""`neo benchmark`: what it takes and refuses, where it writes, and what it leaves when it ends."""
from dataclasses import replace
import json
import os
import signal
import tarfile
import time
from typing import Any

from neo_ros.benchmark import bundle, run, scoring, suites
from neo_ros.benchmark.bundle import write_bundle
from neo_ros.benchmark.run import installed
from neo_ros.benchmark.workbench import Job, Workbench
from neo_ros.cli.main import app
from neo_ros.errors import ConfigError
from neo_ros.evaluation.metrics import score_frame
import pytest
from typer.testing import CliRunner


@pytest.fixture(autouse=True)
def plain_scores(monkeypatch):
    """Do without LPIPS, whose weights are a download, and without a process per method."""
    monkeypatch.setattr(scoring, 'load_scorers', lambda progress: {'psnr_ssim': score_frame})
    monkeypatch.setattr(scoring, 'measure_memory', lambda folder, name: 12.5)


def test_the_command_scores_a_scene_folder(flat_scene, tmp_path):
    result = CliRunner().invoke(app, [
        'benchmark', '--scene', str(flat_scene), '--protocol', 'square', '--scale', 'full',
        '--methods', 'edge_replication,mean_image', '--frames', '2',
        '--out', str(tmp_path / 'x.json'), '--work', str(tmp_path / 'work')],
        catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert [row['n_frames'] for row in json.loads((tmp_path / 'x.json').read_text())] == [2, 2]
    assert (tmp_path / 'work/flat.html').is_file()


def test_a_config_says_what_the_benchmark_leaves_open(flat_scene, tmp_path):
    config = tmp_path / 'x.yaml'
    config.write_text(json.dumps({
        'scale': 0.5, 'view': {'source': [8, 8], 'target': [16, 16]},
        'field': {'exposure': True},
        'network': {'name': 'mat', 'width': 128, 'depth': 1, 'patch': 4}}))
    for _ in range(2):  # The second goes on.
        result = CliRunner().invoke(app, [
            'benchmark', '--scene', str(flat_scene), '--scale', 'full', '--config', str(config),
            '--methods', 'edge_replication', '--frames', '2',
            '--out', str(tmp_path / 'x.json'), '--work', str(tmp_path / 'work')],
            catch_exceptions=False)
        assert result.exit_code == 0, result.output
    job = Job(**json.loads((tmp_path / 'work/flat_square_full/job.json').read_text())['job'])
    own, plain = (Workbench(job, tmp_path / str(job.settings is None), lambda *progress: None)
                  for job in (job, replace(job, settings=None)))
    assert own.base.field.exposure
    assert replace(own.base, field=plain.base.field) == plain.base


def test_a_method_whose_package_is_missing_is_left_out(monkeypatch):
    monkeypatch.setattr(run, 'find_spec', lambda package: None)
    said = []
    assert installed(['edge_replication', 'relocalized'], lambda stage, done, total, note='':
                     said.append(f'{stage}: {note}')) == ['edge_replication']
    assert said == ['without relocalized: pycolmap is not installed']


@pytest.fixture
def tiny_suite(flat_scene, tmp_path, monkeypatch):
    """Make a suite of two methods on the tiny scene, in a checkout of its own."""
    entry: dict[str, Any] = {'protocol': 'square', 'scale': 'full', 'minutes': 1}
    (tmp_path / 'tiny.yaml').write_text(json.dumps({
        'methods': ['edge_replication', 'mean_image'], 'folders': [str(flat_scene.parent)],
        'scenes': {'flat': {**entry, 'frames': 2}}, 'settings': {}}))
    bench = Workbench(Job(str(flat_scene), **entry), tmp_path / 'other', lambda *progress: None)
    (tmp_path / 'splits.json').write_text(json.dumps({'flat': bench.checksums}))
    (tmp_path / 'results').mkdir()
    tables = tmp_path / 'results/tiny.md'
    tables.write_text('before')
    for module in (suites, run):
        monkeypatch.setattr(module, 'config_folder', lambda: tmp_path)
    monkeypatch.chdir(tmp_path)
    return tables


def test_a_part_of_a_suite_replaces_nothing_that_is_kept(tiny_suite, tmp_path):
    def run_suite(*arguments):
        result = CliRunner().invoke(app, ['benchmark', '--suite', 'tiny', '--work', 'work',
                                          *arguments], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return ' '.join(result.output.split())

    kept = tmp_path / 'results/tiny.json'
    said = run_suite('--methods', 'mean_image')
    assert 'Not run: edge_replication' in said and 'Written: work/tiny.json' in said
    assert not kept.exists() and 'before' in tiny_suite.read_text()
    assert len(json.loads((tmp_path / 'work/tiny.json').read_text())) == 1
    assert 'Written: results/tiny.json' in run_suite()
    assert [row['method'] for row in json.loads(kept.read_text())] == [
        'edge_replication', 'mean_image']
    tables = tiny_suite.read_text()
    assert '| edge_replication |' in tables and 'before' not in tables
    run_suite('--methods', 'mean_image')
    assert len(json.loads(kept.read_text())) == 2 and tiny_suite.read_text() == tables


def test_a_bundle_is_cut_into_files_that_are_one_archive(tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, 'PART_BYTES', 4000)
    rows_file, work = tmp_path / 'full.json', tmp_path / 'work'
    content = {'full.json': b'[]', 'full.md': b'table', 'flat/job.json': b'{}',
               'flat/neo_fast/flat.onnx': bytes(range(256)) * 40,
               'flat/neo_fast/flat.memory': b'\7' * 5000}
    rows_file.write_bytes(content['full.json'])
    for name, text in (*content.items(), ('flat/field/field.npz', b'can be made again')):
        if name != 'full.json':
            (work / name).parent.mkdir(parents=True, exist_ok=True)
            (work / name).write_bytes(text)
    (tmp_path / 'bundle').mkdir()
    (tmp_path / 'bundle/full.tar.77').write_bytes(b'of an earlier call')
    parts = write_bundle(tmp_path / 'bundle', rows_file, work)
    assert sorted((tmp_path / 'bundle').iterdir()) == parts
    assert all(path.stat().st_size == 4000 for path in parts[:-1])
    whole = tmp_path / 'whole.tar'
    whole.write_bytes(b''.join(path.read_bytes() for path in parts))
    with tarfile.open(whole) as archive:
        extracted = {member.name: archive.extractfile(member) for member in archive}
        assert {name: file and file.read() for name, file in extracted.items()} == content


def test_a_broken_off_run_leaves_its_bundle(flat_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(scoring, 'make_method', lambda name, bench: 1 / 0)
    result = CliRunner().invoke(app, [
        'benchmark', '--scene', str(flat_scene), '--scale', 'full',
        '--methods', 'edge_replication',
        '--out', str(tmp_path / 'x.json'), '--work', str(tmp_path / 'work'),
        '--bundle', str(tmp_path / 'bundle')])
    assert isinstance(result.exception, ZeroDivisionError)
    with tarfile.open(tmp_path / 'bundle/x.tar.00') as archive:
        assert archive.getnames() == ['flat_square_full/job.json']


def test_a_run_that_is_told_to_end_leaves_its_bundle(flat_scene, tmp_path, monkeypatch):
    def told(name, bench):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
        raise AssertionError('nobody listened')

    monkeypatch.setattr(scoring, 'make_method', told)
    # Else the tests would end where the command does not listen.
    before = signal.signal(signal.SIGTERM, mine := lambda number, frame: None)
    try:
        result = CliRunner().invoke(app, [
            'benchmark', '--scene', str(flat_scene), '--scale', 'full',
            '--methods', 'edge_replication',
            '--out', str(tmp_path / 'x.json'), '--work', str(tmp_path / 'work'),
            '--bundle', str(tmp_path / 'bundle')])
        assert signal.getsignal(signal.SIGTERM) is mine
    finally:
        signal.signal(signal.SIGTERM, before)
    assert result.exit_code == 128 + signal.SIGTERM
    assert (tmp_path / 'bundle/x.tar.00').is_file()


@pytest.mark.parametrize('arguments, message', [
    ([], 'either --suite'), (['--suite', 'quarter', '--scene', '.'], 'either --suite'),
    (['--suite', 'eighth'], 'quarter'), (['--scene', '.', '--methods', 'mat,magic'], 'magic'),
    (['--scene', '.', '--scenes', '.'], '--scenes: expected only with --suite'),
    (['--suite', 'quarter', '--scale', 'half', '--frames', '2'],
     '--scale, --frames: expected only with --scene'),
    (['--suite', 'quarter', '--test-scene', '.'], '--test-scene: expected only'),
    (['--suite', 'quarter', '--config', 'x.yaml'], '--config: expected only'),
    (['--suite', 'quarter', '--protocol', 'square', '--budget-minutes', '18'],
     '--protocol, --budget-minutes: expected only'),
], ids=['nothing', 'both', 'unknown suite', 'unknown method', 'folders of a scene',
        'frames of a suite', 'truth of a suite', 'settings of a suite', 'defaults of a suite'])
def test_the_command_says_what_it_expects(arguments, message):
    result = CliRunner().invoke(app, ['benchmark', *arguments])
    assert isinstance(result.exception, ConfigError)
    assert message in str(result.exception)
