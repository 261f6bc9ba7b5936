"""The report at the end of a training: what the field shows, what the model makes of it."""
from dataclasses import dataclass
import json

from neo_ros.evaluation.calibration import judge_confidence
from neo_ros.evaluation.evaluate import MethodScores, TruthFrames
from neo_ros.evaluation.evaluation_report import evaluation_sections
from neo_ros.evaluation.metrics import psnr
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.machine.files import write_bytes
from neo_ros.machine.progress import no_progress, of_stage, Progress
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.reports.report import Plot, Section, Series, Strip, Table, Text, write_report
from neo_ros.reports.strips import error_label, error_map
from neo_ros.runtime import FovExtrapolator
from neo_ros.training.look_alikes import look_alike_sections
from neo_ros.training.pose_map import pose_sections
from neo_ros.training.run import TrainingRun
from neo_ros.training.views import held_out_poses
import numpy as np

STRIPS = 4
# The oracle renders every so many test frames; all of them would take longer than they tell.
ORACLE_EVERY = 8


@dataclass(frozen=True)
class Scoring:
    """The model and the floors on the test frames of a scene."""

    frames: TruthFrames
    results: list[MethodScores]

    def to_json(self, figures: dict[str, float],
                confidence: dict[str, dict[str, float]]) -> str:
        """Return the figures of the training, the result rows and every frame's scores."""
        return json.dumps({'figures': figures, **confidence,
                           'rows': [result.row for result in self.results],
                           'methods': [result.to_dict() for result in self.results]}, indent=1)


def write_training_report(run: TrainingRun, field: RadianceField, scoring: Scoring | None,
                          views: np.ndarray | None) -> dict[str, float]:
    """
    Write report.html (and scores.json, if the scene has test frames) into the run's folder.

    views: of `calibration_views`.
    Returns the figures at its top: on held-out photos field_psnr, and the ring PSNR of the
    network from_photo_psnr and from_rendering_psnr; with test frames oracle_ring_psnr (the field
    at the true pose) and the model's ring_psnr. The field is shown at each photo's exposure.
    """
    figures: dict[str, float] = {}
    sections: list[Section] = [
        *_curves(run), *_held_out_strips(run, field, figures), *pose_sections(run.out)]
    sections += look_alike_sections(run)
    _compare_inputs(run, field, views, figures)
    confidence: dict[str, dict[str, float]] = {}
    if scoring is not None:
        figures['oracle_whole_psnr'], figures['oracle_ring_psnr'] = _oracle(
            field, scoring, of_stage(run.progress, 'field at the true poses'))
        figures['ring_psnr'] = scoring.results[0].estimates['ring_psnr'].mean
        sections += evaluation_sections(run.scene.name, scoring.frames, scoring.results)
        confidence, judged = judge_confidence(run.model_path, scoring.frames,
                                              of_stage(run.progress, 'report'))
        sections += judged
    source, target = run.expansion.source, run.expansion.target
    intro = (f'{len(run.fitted)} photos of {run.scene.name}, {source.width}x{source.height} '
             f'({np.degrees(source.hfov):.0f} deg) to {target.width}x{target.height} pixels '
             f'({np.degrees(target.hfov):.0f} deg), trained in {run.seconds / 60:.1f} minutes.')
    table = Table(('figure', 'value'), [
        (_TITLES[name], f'{value:.2f} dB') for name, value in figures.items()])
    write_report(run.out / 'report.html', f'Training of {run.scene.name}',
                 [Text(intro), table, *sections])
    if scoring is not None:
        write_bytes(run.out / 'scores.json', scoring.to_json(figures, confidence).encode())
    return figures


_TITLES = {
    'field_psnr': 'Field against photos it was not shown, PSNR',
    'from_photo_psnr': 'The network on these photos: ring, against the field around them',
    'from_rendering_psnr': 'The network on renderings in their place',
    'oracle_whole_psnr': f'Field at the true pose of every {ORACLE_EVERY}th test frame, whole '
                         'image (the field in the middle, too)',
    'oracle_ring_psnr': f'Field at the true pose of every {ORACLE_EVERY}th test frame, ring alone',
    'ring_psnr': 'The model on all test frames, ring alone'}


def _curves(run: TrainingRun) -> list[Section]:
    curves: list[Section] = []
    if run.log['field']:  # A mesh or splats were not fitted.
        curves.append(_curve(run, 'field', 'The field on its own photos, while it was fitted'))
    if run.log['validation']:
        curves.append(_curve(
            run, 'validation', 'The outpainter on photos held out, while it was trained: ring'))
    return curves


def _curve(run: TrainingRun, stage: str, title: str) -> Plot:
    rows = np.array(run.log[stage]).reshape(-1, 3)
    return Plot(title, 'minutes', 'PSNR, dB',
                [Series(stage, (rows[:, 1] / 60).tolist(), rows[:, 2].tolist())])


def _held_out_strips(run: TrainingRun, field: RadianceField,
                     figures: dict[str, float]) -> list[Section]:
    """Compare the field with photos that it was not shown."""
    photos = run.held_out
    if photos is None:
        return []
    scale = run.experiment.field_scale
    camera = photos.intrinsics.scaled(scale)
    scores, strips = [], []
    for index, pose in enumerate(photos.poses):
        run.progress('field on held-out photos', index, len(photos), '')
        photo, usable = photos.read_shown(index, scale)
        if not usable.any():
            continue
        rendered = render_view(field, camera, pose).image
        rendered = _exposed(rendered, rendered, photo, usable)
        scores.append(psnr(photo[usable], rendered[usable]))
        if index < STRIPS:
            strips.append(Strip(
                f'{photos.image_paths[index].name}: {scores[-1]:.2f} dB',
                [('field', rendered), ('photo', photo),
                 (error_label(), error_map(photo, rendered))]))
    if scores:
        figures['field_psnr'] = float(np.mean(scores))
    return [Text('Photos that the field was not shown.', 'The field against photos'), *strips]


def _compare_inputs(run: TrainingRun, field: RadianceField, views: np.ndarray | None,
                    figures: dict[str, float]) -> None:
    """
    Score the network on photos that nothing was trained on, and on the field's views there.

    It learns mostly from renderings: what real images cost is the difference. The truth around
    both is what the field shows.
    """
    if views is None or run.held_out is None:
        return
    network = FovExtrapolator.load(run.model_path, guided=False)
    expansion = run.expansion
    scores = []
    for index, (view, pose) in enumerate(zip(views, held_out_poses(run))):
        run.progress('network on held-out photos', index, len(views), '')
        ring = expansion.extrapolated_mask & (view[..., 3] > 127)
        photo = np.ascontiguousarray(expansion.crop(view[..., :3]))
        rendered = render_view(field, expansion.source, pose).image
        rendered = _exposed(rendered, rendered, photo, expansion.crop(view[..., 3]) > 127)
        if ring.any():
            scores.append([psnr(view[ring][:, :3], network.expand(image).wide_image[ring])
                           for image in (photo, rendered)])
    if scores:
        figures['from_photo_psnr'], figures['from_rendering_psnr'] = np.mean(scores, 0).tolist()


def _oracle(field: RadianceField, scoring: Scoring,
            progress: Progress = no_progress) -> tuple[float, float]:
    """Score the field at the true poses: mean PSNR of the whole image and of the ring."""
    frames, expansion = scoring.frames, scoring.frames.expansion
    ring = expansion.extrapolated_mask
    whole_scores, ring_scores = [], []
    for index in range(0, len(frames), ORACLE_EVERY):
        progress(index, len(frames))
        photo, truth = frames.read(index)
        rendered = render_view(field, expansion.target, frames.images.poses[index]).image
        usable = frames.read_usable(index)
        if usable is None:
            usable = np.ones(ring.shape, bool)
        rendered = _exposed(rendered, expansion.crop(rendered), photo, expansion.crop(usable))
        whole_scores.append(psnr(truth[usable], rendered[usable]))
        ring_scores.append(psnr(truth[ring & usable], rendered[ring & usable]))
    return float(np.mean(whole_scores)), float(np.mean(ring_scores))


def _exposed(rendered: np.ndarray, shown: np.ndarray, photo: np.ndarray, usable: np.ndarray
             ) -> np.ndarray:
    """Bring a rendering (0 to 1) to the exposure of a photo (uint8) of its part `shown`: uint8."""
    return to_uint8(rendered * exposure_gain(255 * shown[usable], photo[usable]))
