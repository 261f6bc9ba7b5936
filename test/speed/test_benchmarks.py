import json
from pathlib import Path
import subprocess
import sys

from box_room import box_walk, SOURCE, view, write_box_model
from neo_ros.cli.bench import bench
from neo_ros.errors import ConfigError, ModelError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.host import CACHED_BYTES, core_count, Machine, measure_machine
from neo_ros.outpaint.networks import NetworkConfig
from neo_ros.runtime import FovExtrapolator
from neo_ros.speed import networks as speed_networks
from neo_ros.speed.benchmarks import BENCHMARKS, run_benchmarks
from neo_ros.speed.model import count_flops, write_stand_in_model
from neo_ros.speed.node import measure_graph
from neo_ros.speed.record import Effort, QUICK, Record, time_calls, Work
from neo_ros.speed.runtime import measure_messages
import numpy as np
import onnx
from onnx import helper, TensorProto
import pytest
from tiny_model import write_tiny_model
import typer
from typer.testing import CliRunner

pytestmark = pytest.mark.slow

MACHINE = Machine({1: 100.0, 2: 150.0}, {1: 10.0, 2: 8.0}, {1: 50.0, 2: 90.0})
APP = typer.Typer()
APP.command()(bench)


@pytest.fixture
def model(tmp_path):
    return write_tiny_model(tmp_path / 'tiny.onnx')


def test_a_record_holds_the_spread_of_its_durations():
    record = Record.of('part', 'name', np.arange(101.0))
    assert (record.n, record.mean_ms, record.median_ms, record.p95_ms, record.p99_ms,
            record.max_ms, record.rate_hz) == (101, 50, 50, 95, 99, 100, 20)


@pytest.mark.parametrize('work, threads, floor_of, floor_ms', [
    (Work(1e9, 1e3), 1, 'flops', 10.0),
    (Work(1e9, 1e3), 2, 'flops', 1e9 / 150e6),
    (Work(1e9, 1e3), 0, 'flops', 1e9 / 150e6),
    (Work(1e3, 1e8), 1, 'bytes', 10.0),
    (Work(1e3, 1e8), 2, 'bytes', 10.0),
    (Work(None, 1e6), 1, 'bytes', 0.02),
    (Work(None, 1e8, 1e6), 1, 'bytes', 2.0),
], ids=['flops', 'more threads', 'all threads', 'memory', 'fewer threads are faster', 'cache',
        'again and again in the cache'])
def test_the_floor_is_what_takes_longest(work, threads, floor_of, floor_ms):
    record = Record.of('part', 'name', [20.0]).with_floor(work, MACHINE, threads)
    assert record.floor_of == floor_of
    assert record.floor_ms == pytest.approx(floor_ms)
    assert record.measured_over_floor == pytest.approx(20 / floor_ms)


def test_figures_that_are_no_number_are_null_in_json():
    record = Record('part', 'name', mean_ms=float('nan'), rate_hz=1.23456789, details={
        'deep': {'inf': float('inf')}}).to_dict()
    assert (record['mean_ms'], record['rate_hz'], record['details']['deep']['inf']) == (
        None, 1.2346, None)


def test_calls_are_timed_one_by_one_without_the_first():
    calls = []
    durations = time_calls(lambda: calls.append(0), 0.0, least=7)
    assert len(durations) == 7 and len(calls) == 8 and (durations >= 0).all()


def test_the_machine_is_measured_with_one_thread_and_with_all():
    machine = measure_machine(0.02)
    for rates in vars(machine).values():
        assert rates.keys() == {1, core_count()}
        assert all(rate > 0 for rate in rates.values())
    assert machine.bandwidth(CACHED_BYTES, 1) == 1e9 * machine.cache_gb_s[1]
    assert machine.bandwidth(100 * CACHED_BYTES, 1) == 1e9 * machine.memory_gb_s[1]


@pytest.mark.parametrize('rates, load, busy', [
    ({1: 100.0, 2: 190.0}, 0.1, False), ({1: 100.0, 2: 60.0}, 0.1, True),
    ({1: 100.0, 2: 190.0}, 1.1, True), ({1: 100.0}, 0.1, False), ({1: 100.0}, 0.6, True),
], ids=['two cores', 'others compute', 'load of two cores', 'one core', 'load of one core'])
def test_a_busy_machine_is_told_from_a_quiet_one(rates, load, busy):
    assert Machine(rates, {1: 1.0}, {1: 1.0}).is_busy(load) is busy


def one_node(kind, shapes, out, **attributes):
    """Return a model of one node; the output's shape is left to inference."""
    inputs = [f'in_{index}' for index in range(len(shapes))]
    value = helper.make_tensor_value_info
    graph = helper.make_graph(
        [helper.make_node(kind, inputs, ['out'], **attributes)], 'one',
        [value(name, TensorProto.FLOAT, shape) for name, shape in zip(inputs, shapes)],
        [value('out', TensorProto.FLOAT, out)])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid('', 18)])


@pytest.mark.parametrize('kind, shapes, attributes, flops', [
    ('Conv', [(1, 4, 10, 8), (6, 4, 3, 3)], {'pads': [1] * 4}, 2 * 6 * 80 * 36),
    ('Conv', [(1, 4, 10, 8), (8, 2, 3, 3)], {'group': 2, 'strides': [2, 2]}, 2 * 8 * 12 * 18),
    ('MatMul', [(5, 2, 7), (7, 3)], {}, 2 * 5 * 2 * 3 * 7),
    ('Gemm', [(7, 2), (7, 3)], {'transA': 1}, 2 * 2 * 3 * 7),
    ('Gemm', [(2, 7), (3, 7)], {'transB': 1}, 2 * 2 * 3 * 7),
    ('Add', [(2, 7), (2, 7)], {}, 0),
    ('MatMul', [('batch', 7), (7, 3)], {}, None),
], ids=['conv', 'grouped and strided', 'matmul', 'gemm A', 'gemm B', 'nothing', 'unknown shape'])
def test_multiply_adds_count_twice(tmp_path, kind, shapes, attributes, flops):
    onnx.save_model(one_node(kind, shapes, None, **attributes), str(tmp_path / 'one.onnx'))
    assert count_flops(tmp_path / 'one.onnx') == flops


def test_without_the_onnx_package_the_cost_is_not_known(model, monkeypatch):
    monkeypatch.setitem(sys.modules, 'onnx', None)
    assert count_flops(model) is None


def test_the_stand_in_is_a_valid_model_of_any_size(tmp_path):
    view = ViewExpansion(Intrinsics(48, 32, 24.0, 24.0, 24.0, 16.0), 16, 8, 0, 24)
    path = write_stand_in_model(tmp_path / 'a.onnx', view)
    image = np.random.default_rng(1).integers(0, 256, (32, 48, 3), np.uint8)
    wide = FovExtrapolator.load(path).expand(image)
    assert np.array_equal(view.crop(wide.wide_image), image)
    assert (view.crop(wide.confidence) == 255).all()
    assert wide.wide_image[view.extrapolated_mask].std() > 5
    cells = 72 // 8 * 56 // 8
    assert count_flops(path) == 2 * 9 * cells * (192 * 48 + 4 * 48 * 48 + 48 * 256)
    again = write_stand_in_model(tmp_path / 'b.onnx', view)
    assert again.read_bytes() == path.read_bytes()


def test_what_needs_no_graph_is_measured(model):
    results = run_benchmarks(model, ['expand', 'messages', 'replay'], quick=True)
    records = results['records']
    assert [record['benchmark'] for record in records] == (
        ['expand'] * 2 + ['messages'] * 4 + ['replay'])
    for record in records:
        spread = [record[f'{name}_ms'] for name in ('median', 'p95', 'p99', 'max')]
        assert 0 < spread[0] and spread == sorted(spread) and record['rate_hz'] > 0
        assert (record['floor_ms'] is None) == (record['floor_of'] is None)
    assert 0 < records[-1]['details']['share_in_model'] < 1
    assert records[-1]['n'] == records[-1]['details']['frames'] == QUICK.frames
    assert results['quick'] and results['host']['cores'] == core_count()
    assert json.loads(json.dumps(results, allow_nan=False)) == results


def test_an_rgb_image_is_read_without_a_copy_and_has_no_floor():
    floors = {record.name.split()[1]: record.floor_of
              for record in measure_messages(MACHINE, QUICK) if record.name.startswith('read')}
    assert floors == {'rgb8': None, 'bgr8': 'bytes', 'bayer_rggb8': 'bytes'}


@pytest.fixture
def small_network(monkeypatch):
    """Measure the stream beside the training of a network that is as small as can be."""
    pytest.importorskip('torch')
    monkeypatch.setattr('neo_ros.speed.stream.NetworkConfig', lambda: NetworkConfig(
        width=8, hidden=16))


def test_the_field_is_measured_in_a_room_that_is_closed(small_network):
    from neo_ros.speed.field import box_room, measure_field, room_poses
    from neo_ros.field.rendering import render_view
    field, wide = box_room(20_000), Intrinsics.from_hfov(64, 64, 2 * np.arctan(2))
    for pose in room_poses(4):
        view = render_view(field, wide, pose, 1)
        assert view.opacity.min() > 0.8 and view.opacity.mean() > 0.98
        assert 0.5 < np.median(view.depth) < 5
        assert view.image.std() > 0.05
    assert np.array_equal(field.grid, box_room(20_000).grid)
    records = list(measure_field(
        MACHINE, Effort(seconds=0.0, voxels=20_000), wide=wide))
    assert [record.name.split(' 64x')[0] for record in records] == [
        'step of the fit', 'wide view', 'wide view', 'panorama for wide views', 'wide view',
        '64 views of the stream, with a new panorama',
        '64 views of the stream, panoramas there', '64 views of the stream, while training']
    assert 10 < records[0].details['samples_per_ray'] < 40
    assert records[2].details['rays'] == 4 * records[1].details['rays'] == 4 * 64 * 64
    whole, cut = records[3].mean_ms, records[4].mean_ms
    assert whole is not None and cut is not None
    assert records[4].details['views_per_s_with_panorama'] == pytest.approx(
        72_000 / (whole + 72 * cut))
    fresh, there, training = (record.details for record in records[5:])
    assert fresh['views_per_s'] > 0 and there['views_per_s'] > 0
    assert fresh['psnr_against_rendered'] > 35
    assert 0 < training['share_of_stream'] < 1
    assert training['training_views_per_s'] < training['views_per_s']
    assert all(record.floor_ms and record.floor_ms > 0 for record in records)


def test_a_gpu_is_measured_as_the_cpu_is_or_skipped_with_a_reason(small_network):
    torch = pytest.importorskip('torch')
    from neo_ros.speed import gpu as speed_gpu
    records = list(speed_gpu.measure_gpu(Effort(seconds=0.0, voxels=8_000)))
    if not torch.cuda.is_available():
        assert [record.skipped for record in records] == ['no GPU that torch can use']
    # What a GPU does, on this CPU.
    rates = speed_gpu.device_rates(torch.device('cpu'), 0.0, side=64)
    assert all(0.01 < rate < 1e4 for best in vars(rates).values() for rate in best.values())
    small = Intrinsics.from_hfov(16, 16, 2.0)
    records = list(speed_gpu.measure_field(
        rates, Effort(seconds=0.0, voxels=8_000), 'torch', small))
    assert records[0].name == 'step of the fit' and '16x16' in records[1].name
    fresh, there, training = records[5:]
    assert fresh.details['psnr_against_rendered'] > 25
    assert min(record.details['views_per_s'] for record in (fresh, there, training)) > 0
    assert all(record.floor_ms and record.floor_ms > 0 for record in records)


def test_the_network_of_a_training_is_measured_in_float_and_integers():
    view = ViewExpansion.to_size(Intrinsics.from_hfov(16, 16, 1.5), 32, 32)
    records = list(speed_networks.measure_networks(
        MACHINE, Effort(seconds=0.0), view, NetworkConfig(patch=4, width=4, hidden=8)))
    assert [(record.benchmark, record.name) for record in records] == [
        ('networks', f'neo_fast, {number_format}, 16x16 to 32x32, {threads}')
        for number_format in ('fp32', 'int8') for threads in ('1 thread', 'all threads')]
    assert all(record.n >= 3 and (record.floor_ms or 0) > 0 for record in records)


def test_the_field_is_skipped_with_a_reason_where_training_is_not_installed():
    code = ('import sys; sys.modules["torch"] = None\n'
            'from neo_ros.speed.benchmarks import measure_trained, QUICK\n'
            'records = list(measure_trained("field", None, QUICK))\n'
            'print(len(records), records[0].skipped)')
    result = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                            cwd=Path(__file__).parents[2], check=False)
    assert result.stdout.startswith('1 torch is not installed'), result.stderr


def test_the_node_is_measured_on_a_real_graph(model):
    record = measure_graph(model, MACHINE, Effort(graph_s=1.0))
    details = record.details
    assert details['sent'] == 30 and record.n + details['missed'] == 30 and record.n > 5
    assert record.median_ms is not None
    assert 0 < record.median_ms < 1000 and details['jitter_ms'] > 0
    assert 0 <= details['idle_cpu_percent'] < details['cpu_percent'] < 250
    # Unwatched, it does not hear the camera.
    assert details['unwatched_cpu_percent'] < details['cpu_percent'] / 2
    assert 20 < details['rss_mb'] < 2000
    stages = details['stages_ms']
    assert 0 < stages['infer']['median'] < stages['total']['median']
    assert 0 < details['share_outside_inference'] < 1


@pytest.mark.parametrize('only, error, words', [
    (['expand', 'nonsense'], ConfigError, 'nonsense'),
    (['replay'], ModelError, 'missing.onnx'),
], ids=['unknown name', 'no model'])
def test_what_cannot_be_measured_is_refused_before_the_work(tmp_path, only, error, words):
    with pytest.raises(error, match=words):
        run_benchmarks(tmp_path / 'missing.onnx', only, quick=True,
                       report=lambda *progress: pytest.fail('it began'))


def test_the_command_shows_a_table_and_writes_the_file(tmp_path):
    out = tmp_path / 'new' / 'bench.json'
    result = CliRunner().invoke(APP, ['--only', 'messages', '--quick', '--out', str(out)],
                                env={'COLUMNS': '200'})
    assert result.exit_code == 0, result.output
    records = json.loads(out.read_text())['records']
    assert len(records) == 4
    assert all(f'{record["median_ms"]:.3g}' in result.output for record in records)
    assert set(BENCHMARKS) == {
        'expand', 'messages', 'networks', 'guided', 'replay', 'field', 'gpu', 'node'}


def test_a_node_that_learns_is_measured_though_it_hears_the_camera_unwatched(tmp_path):
    images = np.stack([view(pose, SOURCE)[0] for pose in box_walk(4)])
    record = measure_graph(
        write_box_model(tmp_path), MACHINE, Effort(graph_s=1.0), images, learn=True)
    assert record.n > 5 and record.details['unwatched_cpu_percent'] > 0
