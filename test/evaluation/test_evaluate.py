from dataclasses import replace
import json
import sys
from types import SimpleNamespace

import cv2
from neo_ros.errors import ImageRejected, NeoError, SceneError
from neo_ros.evaluation import evaluate as evaluate_module
from neo_ros.evaluation.baselines import EdgeReplication, Method, NeoModel
from neo_ros.evaluation.calibration import calibrate
from neo_ros.evaluation.evaluate import evaluate, protocol_of, ROW_KEYS, score_frames, TruthFrames
from neo_ros.evaluation.evaluation_report import evaluation_sections, write_evaluation
from neo_ros.evaluation.metrics import score_frame
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.pictures.usable import write_usable
from neo_ros.reports.kept_pictures import pick_frames
from neo_ros.reports.report import Strip
from neo_ros.reports.strips import outlined
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION, write_tiny_model


class Constant:
    """Paint everything in one colour: no observed pixel survives."""

    name = 'constant'
    observed_pasted = False
    train_minutes: float | None = None
    model_mb: float | None = 0.5

    def expand(self, narrow_image):
        return np.full((48, 64, 3), 100, np.uint8)


class Peeking(EdgeReplication):
    """Claim to paste, but change one observed pixel."""

    def expand(self, narrow_image):
        wide_image = super().expand(narrow_image).copy()
        wide_image[self.expansion.observed][0, 0] ^= 1
        return wide_image


def wide_frames(folder, intrinsics=TINY_EXPANSION.target.scaled(2), count=6):
    folder.mkdir(exist_ok=True)
    rng = np.random.default_rng(0)
    paths = []
    for index in range(count):
        coarse = rng.integers(0, 256, (6, 8, 3)).astype(np.uint8)
        image = cv2.resize(coarse, (intrinsics.width, intrinsics.height))
        paths.append(folder / f'wide_{index}.png')
        assert cv2.imwrite(str(paths[-1]), image[..., ::-1])
    poses = tuple(CameraPose.from_planar(0, 0, 1.5, 0) for _ in paths)
    return PosedImages(intrinsics, tuple(paths), poses, tuple(i % 3 for i in range(count)))


@pytest.fixture
def frames(tmp_path):
    return TruthFrames(wide_frames(tmp_path / 'test'), TINY_EXPANSION)


def test_the_input_is_the_window_of_the_area_resampled_truth(frames):
    narrow_image, truth = frames.read(2)
    full = frames.images.read_image(2)
    halved = full.reshape(48, 2, 64, 2, 3).mean(axis=(1, 3))
    assert np.abs(truth - halved).max() <= 0.5
    np.testing.assert_array_equal(narrow_image, TINY_EXPANSION.crop(truth))
    assert frames.scale == 0.5


def test_every_method_is_scored_on_every_frame(frames):
    done: list[int] = []
    methods: list[Method] = [EdgeReplication(TINY_EXPANSION), Constant()]
    edge, constant = evaluate('tiny', frames, methods, progress=done.append)
    assert done == list(range(1, 13))
    narrow_image, truth = frames.read(4)
    expected = score_frame(truth, methods[0].expand(narrow_image), TINY_EXPANSION)
    assert edge.frames[4] == {
        'frame': 'wide_4.png', 'path_id': 1, 'milliseconds': edge.frames[4]['milliseconds'],
        **expected}
    assert edge.frames[4]['milliseconds'] > 0
    assert (edge.observed_pasted, constant.observed_pasted) == (True, False)
    # Only one of them keeps the camera's pixels, and the whole image shows it.
    assert edge.estimates['whole_ssim'].mean > constant.estimates['whole_ssim'].mean + 0.1
    estimate = edge.estimates['ring_psnr']
    assert estimate.low is not None and estimate.high is not None
    assert estimate.low < estimate.high


def with_mask(frames, index, usable):
    """Give a frame a mask, which is as large as its file."""
    path = frames.images.image_paths[0].parent / 'mask.png'
    write_usable(path, usable)
    masks = [path if i == index else None for i in range(len(frames))]
    return TruthFrames(replace(frames.images, mask_paths=tuple(masks)), TINY_EXPANSION)


def test_scores_leave_out_what_a_frames_mask_does(frames):
    usable = np.ones((96, 128), bool)
    usable[60:, 70:] = False
    masked = with_mask(frames, 4, usable)
    plain, scored = (score_frames(some, Constant()) for some in (frames, masked))
    shown = usable[::2, ::2]
    expected = score_frame(frames.read(4)[1], Constant().expand(None), TINY_EXPANSION, shown)
    for index, (before, after) in enumerate(zip(plain, scored)):
        same = all(before[name] == after[name] for name in expected)
        assert same == (index != 4)
    assert {name: scored[4][name] for name in expected} == expected


def test_the_confidence_is_judged_on_what_masks_leave(frames, tmp_path):
    model = FovExtrapolator.load(write_tiny_model(tmp_path / 'm.onnx'))
    usable = np.ones((96, 128), bool)
    usable[:48] = False
    counted = [calibrate(model, some).counts.sum() for some in (
        frames, with_mask(frames, 2, usable))]
    ring = TINY_EXPANSION.extrapolated_mask
    assert counted[0] - counted[1] == ring[:24].sum()


def test_a_mask_that_leaves_nothing_of_the_ring_is_an_error(frames):
    usable = np.zeros((96, 128), bool)
    usable[30:60, 40:80] = True
    with pytest.raises(SceneError, match='mask.png: expected a mask that leaves some'):
        score_frames(with_mask(frames, 1, usable), Constant())


def test_rows_keep_the_contract(frames):
    row = evaluate('tiny', frames, [Constant()])[0].row
    assert tuple(row) == ROW_KEYS
    psnr = [score_frame(truth, Constant().expand(None), TINY_EXPANSION)['ring_psnr']
            for _, truth in frames]
    assert row['ring_psnr'] == pytest.approx(np.mean(psnr))
    assert (row['scene'], row['method'], row['scale']) == ('tiny', 'constant', 'half')
    assert (row['n_frames'], row['model_mb'], row['train_minutes']) == (6, 0.5, None)
    assert 0 < row['latency_ms_median'] <= row['latency_ms_p95']
    assert row['ring_lpips_vgg'] is row['oracle_gap_closed'] is row['warping_error'] is None
    assert 'cores' in row['host']


def test_further_scorers_fill_their_columns(frames):
    row = evaluate('tiny', frames, [Constant()], scorers=[
        score_frame, lambda *frame: {'ring_lpips_vgg': 0.25}])[0].row
    assert row['ring_lpips_vgg'] == 0.25


def test_a_method_that_only_claims_to_paste_is_found_out(frames):
    with pytest.raises(ImageRejected, match='came back changed'):
        evaluate('tiny', frames, [Peeking(TINY_EXPANSION)])


def test_fewer_frames_are_spread_over_the_walks(tmp_path):
    images = wide_frames(tmp_path / 'test')
    names = [path.name for path in TruthFrames(images, TINY_EXPANSION, 3).images.image_paths]
    assert names == ['wide_0.png', 'wide_2.png', 'wide_5.png']
    assert len(TruthFrames(images, TINY_EXPANSION, 99)) == 6


@pytest.mark.parametrize('intrinsics', [
    Intrinsics(128, 96, 40.0, 40.0, 64.0, 48.0),
    Intrinsics(128, 96, 32.0, 32.0, 60.0, 48.0),
    Intrinsics(128, 80, 32.0, 32.0, 64.0, 40.0),
], ids=['focal_length', 'principal_point', 'too_low'])
def test_frames_of_another_view_are_refused(tmp_path, intrinsics):
    images = wide_frames(tmp_path / 'test', intrinsics, count=1)
    with pytest.raises(SceneError, match='expected the wide view of the model, 64x48'):
        TruthFrames(images, TINY_EXPANSION)


def test_of_frames_that_show_more_the_target_is_cut_out(tmp_path):
    images = wide_frames(tmp_path / 'test', Intrinsics(128, 128, 32.0, 32.0, 64.0, 64.0), count=1)
    truth = TruthFrames(images, TINY_EXPANSION).read(0)[1]
    np.testing.assert_array_equal(truth, images.read_image(0, 0.5)[8:56])


def test_methods_are_told_the_pose_reset_and_asked_as_they_wish(frames):
    class Upper(EdgeReplication):

        def __init__(self):
            super().__init__(TINY_EXPANSION)
            self.seen = []

        def expand_at(self, narrow_image, true_pose):
            self.seen.append(true_pose)
            return self.expand(narrow_image)

        def reset(self):
            self.seen.append('reset')

        def notes(self, true_pose):
            return {'looked': 1.0}

    method = Upper()
    scored = score_frames(frames, method, watchers=[
        lambda index, wide_image: {'watched': float(index)}])
    # Paths are 0 1 2 0 1 2: each frame begins another; once more to warm up.
    assert method.seen[1:3] == ['reset', frames.images.poses[0]]
    assert method.seen.count('reset') == 6
    assert [frame['watched'] for frame in scored] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert all(frame['looked'] == 1.0 for frame in scored)


def test_a_scene_without_test_frames_is_refused():
    with pytest.raises(SceneError, match='transforms_test.json'):
        TruthFrames(None, TINY_EXPANSION)


@pytest.mark.parametrize('growth, protocol', [
    ((4, 4, 4, 4), 'square'), ((4, 4, 0, 0), 'horizontal'), ((8, 8, 6, 6), 'custom'),
    ((1, 2, 0, 0), 'custom')], ids=['square', 'horizontal', 'wider', 'lopsided'])
def test_protocols(growth, protocol):
    assert protocol_of(ViewExpansion(TINY_EXPANSION.source, *growth)) == protocol


def test_best_median_and_worst_frame():
    frames = [{'ring_psnr': value} for value in (12.0, 30.0, 5.0, 20.0, 14.0)]
    assert pick_frames(frames) == {'best': 1, 'median': 4, 'worst': 2}


def test_a_model_is_evaluated_from_file_to_report(frames, tmp_path):
    model = write_tiny_model(tmp_path / 'tiny.onnx', trained_seconds=120.0)
    methods: list[Method] = [NeoModel(model, 'neo'), EdgeReplication(TINY_EXPANSION)]
    results = evaluate('tiny', frames, methods)
    confidence = write_evaluation(tmp_path / 'out', 'tiny', frames, results, model)
    scores = json.loads((tmp_path / 'out/scores.json').read_text())
    assert confidence.keys() == {'confidence'} and scores['confidence'] == confidence['confidence']
    assert confidence['confidence'] == calibrate(FovExtrapolator.load(model), frames).summary()
    assert [row['method'] for row in scores['rows']] == ['neo', 'edge_replication']
    assert scores['rows'][0]['train_minutes'] == 2.0
    neo_scores = scores['methods'][0]
    assert neo_scores['observed_pasted'] is True
    assert neo_scores['estimates']['ring_psnr']['mean'] == scores['rows'][0]['ring_psnr']
    assert [frame['frame'] for frame in neo_scores['frames']] == [
        f'wide_{i}.png' for i in range(6)]
    page = (tmp_path / 'out/report.html').read_text()
    assert page.count('<img class="plot"') == 1 + 2
    assert page.count('<img ') == 3 + 2 * 3 * 4
    assert 'Is the confidence true?' in page
    assert f'{scores["rows"][0]["ring_psnr"]:.2f}' in page
    worst = min(neo_scores['frames'], key=lambda frame: frame['ring_psnr'])
    assert f'Worst: {worst["frame"]}' in page


def test_a_report_shows_the_images_that_were_scored(frames):
    class Ageing(EdgeReplication):
        """Show more of a ring at every call, as a method does that remembers frames."""

        def __init__(self):
            super().__init__(TINY_EXPANSION)
            self.shown = []

        def expand(self, narrow_image):
            ring = np.full((48, 64, 3), 20 * len(self.shown), np.uint8)
            self.shown.append(self.expansion.paste(narrow_image, ring))
            return self.shown[-1]

    method = Ageing()
    results = evaluate('tiny', frames, [method])
    strips = [section for section in evaluation_sections('tiny', frames, results)
              if isinstance(section, Strip)]
    scored = method.shown[1:]  # The first is to warm up.
    assert len(scored) == len(frames)
    picked = pick_frames(results[0].frames)
    assert [strip.images[1][0] for strip in strips] == ['widened view'] * 3
    for strip, index in zip(strips, picked.values()):
        np.testing.assert_array_equal(results[0].pictures[index], scored[index])
        np.testing.assert_array_equal(
            strip.images[1][1], outlined(scored[index], TINY_EXPANSION))


def test_the_gpu_is_named_where_it_is_used(monkeypatch):
    used: list[str] = []
    cuda = SimpleNamespace(is_initialized=lambda: bool(used), get_device_name=lambda: 'Some GPU')
    monkeypatch.setitem(sys.modules, 'torch', SimpleNamespace(cuda=cuda))
    alone = evaluate_module.host()
    assert 'Some GPU' not in alone
    used.append('the field')
    assert evaluate_module.host() == f'{alone}, Some GPU'


def test_an_unwritable_folder_is_named(frames, tmp_path):
    (tmp_path / 'file').write_text('')
    methods = [EdgeReplication(TINY_EXPANSION)]
    results = evaluate('tiny', frames, methods)
    model = write_tiny_model(tmp_path / 'tiny.onnx')
    with pytest.raises(NeoError, match='cannot write.*another output folder'):
        write_evaluation(tmp_path / 'file/out', 'tiny', frames, results, model)
