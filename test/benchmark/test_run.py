"""A benchmark of a tiny scene from end to end: resumed, with its files."""
from dataclasses import replace
from functools import partial
import json
import shutil
import time

from neo_ros.baking.sparse_model import SparseModel
from neo_ros.benchmark import scoring, workbench
from neo_ros.benchmark.methods import make_method, METHODS
from neo_ros.benchmark.run import run_jobs
from neo_ros.benchmark.scoring import fill_gap_closed, run_benchmark
from neo_ros.benchmark.tables import markdown
from neo_ros.benchmark.workbench import Job, Workbench
from neo_ros.errors import ConfigError, ModelError
from neo_ros.evaluation import lpips
from neo_ros.evaluation.baselines import EdgeReplication, NeoModel
from neo_ros.evaluation.evaluate import evaluate, ROW_KEYS, TruthFrames
from neo_ros.evaluation.metrics import Estimate, score_frame
from neo_ros.experiment import read_experiment
from neo_ros.field import device
from neo_ros.field.fitting import FitRules
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import share_dir
from neo_ros.machine.progress import no_stage_progress as quiet
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.transforms_json import read_input_crop, read_transforms, write_transforms
import numpy as np
import pytest

pytestmark = pytest.mark.slow

# In 200 steps of a busy machine nothing tells the exposure of photos from errors of the field.
SETTINGS = {
    'field': {'voxels': 20_000, 'rays_per_step': 512, 'exposure': False},
    'sampling': {'positions': 8}, 'network': {'width': 8, 'hidden': 32},
    'outpaint': {'batch': 4}, 'memory': {'distance': 1.0}}
# Of one block, and narrow: their sizes are another test's.
SMALL = {'mat': NetworkConfig(name='mat', patch=8, width=16, depth=2, blocks=1, window=4),
         'lama': NetworkConfig(name='lama', width=8, depth=2, blocks=1)}
# Photos of 32 pixels have hardly a point that B3 could triangulate.
TRAINED = [name for name in METHODS if not name.startswith('relocalized')]


@pytest.fixture(autouse=True)
def plain_scores(monkeypatch):
    """Do without LPIPS, whose weights are a download, a process per method, and most steps."""
    monkeypatch.setattr(device, 'FitRules', partial(FitRules, least_steps=200))
    monkeypatch.setattr(scoring, 'load_scorers', lambda progress: {'psnr_ssim': score_frame})
    monkeypatch.setattr(scoring, 'measure_memory', lambda folder, name: 12.5)


def job(scene, **changed):
    return Job(**{'scene': str(scene), 'protocol': 'square', 'scale': 'full', 'minutes': 0.02,
                  'settings': SETTINGS, **changed})


@pytest.mark.timeout(300)  # a field and two networks; seconds on an idle machine
def test_all_that_can_be_trained_on_a_tiny_scene_is_scored(flat_scene, tmp_path, monkeypatch):
    monkeypatch.setattr(workbench, 'read_experiment', lambda path: replace(
        read_experiment(path), network=SMALL[path.stem]))
    rows_file = tmp_path / 'results/flat.json'
    table = run_jobs({'flat': job(flat_scene)}, TRAINED, tmp_path / 'work', rows_file, 'flat',
                     quiet)
    rows = json.loads(rows_file.read_text())
    assert [row['method'] for row in rows] == TRAINED
    by_name = {row['method']: row for row in rows}
    for row in rows:
        assert tuple(row) == ROW_KEYS
        assert (row['scene'], row['protocol'], row['scale']) == ('flat', 'square', 'full')
        assert row['n_frames'] == 6
        assert row['ring_psnr'] > 5
        assert row['warping_error'] >= 0
        assert row['latency_ms_p95'] >= row['latency_ms_median'] > 0
        assert row['ring_lpips_vgg'] is None
    assert by_name['naive']['oracle_gap_closed'] == 0
    assert by_name['oracle']['oracle_gap_closed'] == 1
    # The scene memory is charged to the method that uses it.
    assert by_name['guided']['train_minutes'] > by_name['neo_fast']['train_minutes'] > 0
    memory = json.loads((tmp_path / 'work/flat_square_full/neo_fast/memory.json').read_text())
    assert (by_name['guided']['train_minutes'] - by_name['neo_fast']['train_minutes']
            == pytest.approx(memory['seconds'] / 60))
    assert by_name['neo_fast']['model_mb'] > 0
    assert by_name['edge_replication']['train_minutes'] is None
    page = (tmp_path / 'work/flat.html').read_text()
    assert page.count('<h3>') == 3 * len(TRAINED)
    assert 'Ring PSNR over milliseconds a frame' in page
    assert 'The true images have a warping error of' in table
    assert '- guided: the memory knew' in table and ' minus ' in table
    assert '| oracle |' in table and '25.94 / 0.868 / 0.217' in table
    assert (tmp_path / 'work/flat.md').read_text() == table


def test_what_is_scored_is_not_scored_again(flat_scene, tmp_path, monkeypatch):
    bench = Workbench(job(flat_scene), tmp_path, quiet)
    first = run_benchmark(bench, ['edge_replication'])
    made = []
    real = scoring.make_method

    def make(name, bench):
        made.append(name)
        return real(name, bench)

    monkeypatch.setattr(scoring, 'make_method', make)
    seen = []
    names = ['edge_replication', 'mean_image']
    again = run_benchmark(Workbench(job(flat_scene), tmp_path, quiet), names,
                          lambda results: seen.append(len(results)))
    assert made == ['mean_image']
    assert seen == [1, 2]
    assert again[0].frames == first[0].frames
    assert again[0].estimates == first[0].estimates
    # Other frames are another question.
    fewer = run_benchmark(Workbench(job(flat_scene, most_frames=2), tmp_path, quiet), names[:1])
    assert made == ['mean_image', 'edge_replication']
    assert fewer[0].row['n_frames'] == 2


def test_what_lacks_a_measure_is_scored_again_and_not_trained(flat_scene, tmp_path, monkeypatch):
    def score(**further):
        bench = Workbench(job(flat_scene, most_frames=3), tmp_path, quiet)
        monkeypatch.setattr(scoring, 'load_scorers',
                            lambda progress: {'psnr_ssim': score_frame, **further})
        scored.clear()
        return run_benchmark(bench, ['edge_replication'])[0].row

    scored = []
    real = scoring._score

    def count(*arguments):
        scored.append(1)
        return real(*arguments)

    monkeypatch.setattr(scoring, '_score', count)
    with monkeypatch.context() as without_depth:
        without_depth.setattr(scoring, 'is_demo_flat', lambda folder: False)
        first = score()
    assert scored and first['warping_error'] is first['ring_lpips_vgg'] is None
    with_depth = score()
    assert scored and with_depth['warping_error'] >= 0
    score()
    assert not scored
    lpips_too = score(lpips_vgg=lambda *images: {'ring_lpips_vgg': 0.25})
    assert scored and lpips_too['ring_lpips_vgg'] == 0.25
    # Without the network, what is there is kept.
    assert score() == lpips_too and not scored
    file = tmp_path / 'scores/edge_replication.json'
    stored = json.loads(file.read_text())
    del stored['measures']
    file.write_text(json.dumps(stored))
    score()
    assert scored, 'an older file does not say what it was scored with'


def test_the_map_is_charged_to_those_that_use_it(flat_scene, tmp_path, monkeypatch):
    def triangulate(bank, folder, progress):
        if not (folder / 'points.npz').exists():
            folder.mkdir(exist_ok=True)
            (folder / 'points.npz').touch()
            time.sleep(0.12)
        return SparseModel(np.zeros((1000, 3)), [
            np.zeros(len(one.points), np.int64) for one in bank.features])

    def bench():
        found = Workbench(job(flat_scene), tmp_path, quiet)
        monkeypatch.setattr(found, 'field', lambda: (None, 2.0, 30.0))
        return found

    monkeypatch.setattr(workbench, 'read_sparse_model', triangulate)
    bank, minutes = bench().bank()
    assert minutes > 0 and make_method('warping', bench()).train_minutes == minutes
    pytest.importorskip('pycolmap')
    first, again = (make_method('relocalized', bench()) for _ in range(2))
    assert first.train_minutes == again.train_minutes >= 2 + minutes + 0.12 / 60
    features = sum(len(one.points) for one in bank.features)
    assert first.model_mb == pytest.approx(30 + bank.megabytes + (24_000 + 8 * features) / 1e6)
    # What was made before times were kept is made again.
    written = (tmp_path / 'features.npz').stat().st_mtime_ns
    (tmp_path / 'features.json').unlink()
    assert bench().bank()[1] not in (0, minutes)
    assert (tmp_path / 'features.npz').stat().st_mtime_ns > written


def test_a_run_that_dies_keeps_what_was_through(flat_scene, tmp_path, monkeypatch):
    def break_off(name, bench):
        if name == 'mean_image':
            raise KeyboardInterrupt
        return real(name, bench)

    real = scoring.make_method
    monkeypatch.setattr(scoring, 'make_method', break_off)
    with pytest.raises(KeyboardInterrupt):
        run_jobs({'flat': job(flat_scene)}, ['edge_replication', 'mean_image'], tmp_path / 'work',
                 tmp_path / 'rows.json', 'flat', quiet)
    rows = json.loads((tmp_path / 'rows.json').read_text())
    assert [row['method'] for row in rows] == ['edge_replication']


def test_a_working_folder_belongs_to_one_benchmark(flat_scene, tmp_path):
    Workbench(job(flat_scene), tmp_path, quiet)
    with pytest.raises(ConfigError, match='other minutes'):
        Workbench(job(flat_scene, minutes=3.0), tmp_path, quiet)


def test_a_working_folder_that_says_the_old_name_of_a_setting_is_continued(flat_scene, tmp_path):
    Workbench(job(flat_scene), tmp_path, quiet)
    note = tmp_path / 'job.json'
    assert '"hidden"' in note.read_text()
    note.write_text(note.read_text().replace('"hidden"', '"memory"'))
    Workbench(job(flat_scene), tmp_path, quiet)
    wider = {**SETTINGS, 'network': {'width': 8, 'hidden': 64}}
    with pytest.raises(ConfigError, match='other settings, experiments'):
        Workbench(job(flat_scene, settings=wider), tmp_path, quiet)


def test_what_a_network_was_scored_with_is_not_changed_below_it(
        flat_scene, tmp_path, monkeypatch):
    Workbench(job(flat_scene), tmp_path, quiet)
    shutil.copytree(share_dir() / 'config', tmp_path / 'share/config')
    monkeypatch.setattr(workbench, 'share_dir', lambda: tmp_path / 'share')
    Workbench(job(flat_scene), tmp_path, quiet)
    mat = tmp_path / 'share/config/experiments/networks/mat.yaml'
    mat.write_text(mat.read_text().replace('width: 32', 'width: 48'))
    with pytest.raises(ConfigError, match='other experiments, or of an older'):
        Workbench(job(flat_scene), tmp_path, quiet)


def test_without_the_weights_of_lpips_the_rest_is_scored(monkeypatch):
    def refuse(backbone):
        raise ModelError('offline')

    monkeypatch.undo()
    monkeypatch.setattr(lpips, 'Lpips', refuse)
    said = []
    assert scoring.load_scorers(
        lambda stage, done, total, note='': said.append(note)) == {'psnr_ssim': score_frame}
    assert 'offline' in said


def test_memory_is_measured_in_a_process_of_its_own(flat_scene, tmp_path):
    from neo_ros.benchmark.method_memory import measure_memory
    Workbench(job(flat_scene), tmp_path, quiet)
    megabytes = measure_memory(tmp_path, 'edge_replication')
    assert megabytes is not None and 0 < megabytes < 500
    assert measure_memory(tmp_path, 'no_such_method') is None


def test_a_world_with_another_axis_up_is_turned_for_all_methods_alike(flat_scene, tmp_path):
    turn = np.eye(4)
    turn[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]  # z to y
    for name in ('one', 'two'):
        folder = tmp_path / name
        shutil.copytree(flat_scene, folder)
        (folder / 'walkable.json').unlink()
        for file in folder.glob('transforms_*.json'):
            images = read_transforms(file)
            write_transforms(file, replace(images, poses=tuple(
                CameraPose(turn @ pose.T_world_cam) for pose in images.poses)),
                read_input_crop(file))
    upright = read_scene(flat_scene)
    assert upright.test is not None
    own = Workbench(job(tmp_path / 'one'), tmp_path / 'work_one', quiet)
    np.testing.assert_allclose(own.scene.train.T_world_cam, upright.train.T_world_cam, atol=1e-9)
    np.testing.assert_allclose(own.frames.images.T_world_cam, upright.test.T_world_cam, atol=1e-9)
    (tmp_path / 'one/transforms_test.json').unlink()
    other = Workbench(job(tmp_path / 'one', test_scene=str(tmp_path / 'two'),
                          protocol='horizontal'), tmp_path / 'work_two', quiet)
    np.testing.assert_allclose(other.frames.images.T_world_cam, upright.train.T_world_cam,
                               atol=1e-9)


def test_every_network_has_a_size_of_its_own(flat_scene, tmp_path, monkeypatch):
    trained = []
    monkeypatch.setattr(Workbench, 'field', lambda bench: None)
    monkeypatch.setattr(workbench, 'train', lambda scene, experiment, *rest, field_of: (
        trained.append((experiment.network, experiment.memory))))
    bench = Workbench(job(flat_scene, settings={'network': {'width': 8}}), tmp_path, quiet)
    for name in ('neo_fast', 'mat', 'lama'):
        bench.model(name)
    networks = {network.name: network for network, _ in trained}
    assert [memory is not None for _, memory in trained] == [True, False, False]
    assert networks['neo_fast'].width == 8
    for name in ('mat', 'lama'):
        file = share_dir() / 'config/experiments/networks' / f'{name}.yaml'
        assert networks[name] == read_experiment(file).network


def test_an_unknown_method_is_not_taken_for_another(flat_scene, tmp_path):
    with pytest.raises(ConfigError, match='got no_such_method'):
        make_method('no_such_method', Workbench(job(flat_scene), tmp_path, quiet))
    assert not (tmp_path / 'field').exists()


def test_guided_without_a_memory_is_refused_before_any_training(flat_scene, tmp_path):
    with pytest.raises(ConfigError, match='flat: guided needs a scene memory, got .* null'):
        run_jobs({'flat': job(flat_scene, settings={**SETTINGS, 'memory': None})},
                 ['naive', 'guided'], tmp_path / 'work', tmp_path / 'rows.json', 'flat', quiet)
    assert not list(tmp_path.rglob('*.ckpt')) and not (tmp_path / 'rows.json').exists()


def test_a_table_says_how_often_the_memory_knew_the_scene(tiny_run):
    frames = TruthFrames(tiny_run.scene.test, tiny_run.expansion)
    results = evaluate('flat', frames, [NeoModel(tiny_run.model_path)])
    known = sum(frame['guided'] for frame in results[0].frames)
    assert f'- guided: the memory knew {known:.0f} of 6 frames' in markdown([results])


def test_every_part_has_a_table_with_intervals(tiny_run):
    frames = TruthFrames(tiny_run.scene.test, tiny_run.expansion)
    results = evaluate('flat', frames, [EdgeReplication(tiny_run.expansion)])
    estimates = {'seam_psnr': Estimate(21.456, 20, 22), 'seam_ssim': Estimate(0.7654, 0.7, 0.8)}
    plain = replace(results[0], estimates=estimates)
    measured = replace(results[0], estimates={
        **estimates, 'seam_lpips_vgg': Estimate(0.1234, None, None)})
    table = markdown([[plain, measured]])
    assert '| seam | PSNR, dB | SSIM | LPIPS VGG | pasted |' in table
    assert '| 21.46 (20.00 to 22.00) | 0.765 (0.700 to 0.800) |  | yes |' in table
    assert '| 21.46 (20.00 to 22.00) | 0.765 (0.700 to 0.800) | 0.123 | yes |' in table


def test_the_gap_needs_both_of_its_ends():
    rows = [{'method': name, 'ring_psnr': psnr, 'oracle_gap_closed': None}
            for name, psnr in (('naive', 20.0), ('neo_fast', 23.0))]
    fill_gap_closed(rows)
    assert rows[1]['oracle_gap_closed'] is None
    rows.append({'method': 'oracle', 'ring_psnr': 30.0, 'oracle_gap_closed': None})
    fill_gap_closed(rows)
    assert [row['oracle_gap_closed'] for row in rows] == [0.0, 0.3, 1.0]


def test_every_method_has_a_description():
    assert {'naive', 'warping', 'relocalized', 'oracle', 'neo_fast'} <= METHODS.keys()
    assert all(entry.words for entry in METHODS.values())
