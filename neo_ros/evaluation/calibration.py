"""
Is the confidence true? Reliability and sparsification of it over the ring of test frames.

Expected calibration error: pixels in bins of predicted error; the mean distance of a bin's
prediction to its mean error. Sparsification: the error that is left when the least sure pixels
are dropped, against an oracle that drops the worst ones; the area between the two (AUSE, Ilg et
al., Uncertainty Estimates and Multi-Hypotheses Networks for Optical Flow, 2018) is 0 at best.
"""
from dataclasses import dataclass, field
from pathlib import Path

from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.evaluation.metrics import check_pair
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.progress import no_progress, of_several, Progress
from neo_ros.reports.report import Plot, Section, Series, Table
from neo_ros.runtime import FovExtrapolator
from neo_ros.runtime.confidence import expected_error
import numpy as np

BINS = 10
DROPPED = np.linspace(0, 0.95, 20)
# Errors are kept exactly: the sum over three channels of uint8 differences.
_LARGEST = 3 * 255


@dataclass
class Calibration:
    """
    Errors of ring pixels by the confidence they came with.

    counts  int64 (256, 766): pixels of a confidence with a sum of absolute differences
    """

    counts: np.ndarray = field(
        default_factory=lambda: np.zeros((256, _LARGEST + 1), np.int64))

    def add(self, truth: np.ndarray, wide_image: np.ndarray, confidence: np.ndarray,
            expansion: ViewExpansion, usable: np.ndarray | None = None) -> None:
        """
        Count a frame: two RGB uint8 (H, W, 3) and confidence uint8 (H, W).

        usable: as in `score_frame`.
        """
        check_pair(truth, wide_image, expansion)
        ring = expansion.extrapolated_mask if usable is None else (
            expansion.extrapolated_mask & usable)
        error = np.abs(truth.astype(np.int64) - wide_image)[ring].sum(-1)
        index = confidence[ring].astype(np.int64) * (_LARGEST + 1) + error
        self.counts += np.bincount(index, minlength=self.counts.size).reshape(self.counts.shape)

    def reliability(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """
        Return mean predicted error, mean error (both of 255) and pixels of each bin.

        Bins hold as nearly the same number of pixels as whole confidence values allow; empty
        ones are left out.
        """
        pixels = self.counts.sum(1)[::-1]  # surest first
        errors = (self.counts @ _per_pixel())[::-1]
        predicted = 255 * expected_error(np.arange(255, -1, -1, dtype=np.uint8)) * pixels
        # A value of the confidence goes where the middle of its pixels lies.
        middle = (np.cumsum(pixels) - pixels / 2) / max(pixels.sum(), 1)
        bins = np.minimum((middle * BINS).astype(int), BINS - 1)
        count, prediction, error = (np.bincount(bins, values, BINS)
                                    for values in (pixels, predicted, errors))
        some = count > 0
        return prediction[some] / count[some], error[some] / count[some], count[some]

    def calibration_error(self) -> float:
        """Return the expected calibration error in steps of 1/255."""
        predicted, actual, count = self.reliability()
        return float(np.average(np.abs(predicted - actual), weights=count))

    def sparsification(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean error (of 255) left after dropping DROPPED: by confidence, by truth."""
        surest = self.counts[::-1]
        by_confidence = _left(surest.sum(1), surest @ _per_pixel())
        totals = self.counts.sum(0)
        return by_confidence, _left(totals, totals * _per_pixel())

    def sparsification_error(self) -> float:
        """Return the AUSE, a share of the mean error: 0 perfect, order of the errors known."""
        model, oracle = self.sparsification()
        excess = (model - oracle) / model[0]
        return float(np.diff(DROPPED) @ (excess[1:] + excess[:-1]) / 2)

    def summary(self) -> dict[str, float]:
        """Return the figures for a file of results, errors in steps of 1/255."""
        return {'mean_error': float(self.sparsification()[0][0]),
                'expected_calibration_error': self.calibration_error(),
                'sparsification_error': self.sparsification_error()}

    def sections(self, whose: str) -> list[Section]:
        """Return a report's part on the confidence, a sentence says whose: figures and curves."""
        summary = self.summary()
        rows = [('Mean absolute error of the ring', f'{summary["mean_error"]:.2f} / 255'),
                ('Expected calibration error',
                 f'{summary["expected_calibration_error"]:.2f} / 255'),
                ('Area between sparsification and its oracle (AUSE)',
                 f'{summary["sparsification_error"]:.3f}')]
        predicted, actual, _ = self.reliability()
        model, oracle = self.sparsification()
        dropped = (100 * DROPPED).tolist()
        return [
            Table(('confidence', 'value'), rows, 'Is the confidence true?', whose),
            Plot('Error that the confidence promises and error there is, each of 255',
                 'predicted', 'found', [Series('model', predicted.tolist(), actual.tolist()),
                                        Series('perfect', predicted.tolist(),
                                               predicted.tolist())]),
            Plot('Error left after dropping the least sure pixels, of 255', 'dropped, %',
                 'mean error', [Series('by confidence', dropped, model.tolist()),
                                Series('by the true error', dropped, oracle.tolist())])]


def calibrate(model: FovExtrapolator, frames: TruthFrames, progress: Progress = no_progress
              ) -> Calibration:
    """Run a model over the test frames as they are scored: anew where another path begins."""
    result = Calibration()
    path_id = None
    for index, (narrow_image, truth) in enumerate(frames):
        if frames.images.path_ids[index] != path_id:
            model.reset()
        path_id = frames.images.path_ids[index]
        view = model.expand(narrow_image)
        result.add(truth, view.wide_image, view.confidence, frames.expansion,
                   frames.read_usable(index))
        progress(index + 1, len(frames))
    return result


def judge_confidence(path: Path, frames: TruthFrames, progress: Progress = no_progress
                     ) -> tuple[dict[str, dict[str, float]], list[Section]]:
    """
    Judge the confidence of a model file over the ring of test frames.

    Returns the figures, `confidence` of the network by itself and `guided_confidence` of a model
    with a scene memory, and a report's part on both.
    """
    judged = f'in the ring of {len(frames)} test frames.'
    network = FovExtrapolator.load(path, guided=False)
    models = {'confidence': (
        network, f'Of the network by itself, where no scene memory guides it; {judged}')}
    if network.card.memory is not None:
        models['guided_confidence'] = (
            FovExtrapolator.load(path), f'Of the model with its scene memory; {judged}')
    figures, sections = {}, []
    for number, (name, (model, whose)) in enumerate(models.items()):
        calibration = calibrate(model, frames, of_several(progress, number, len(models)))
        figures[name] = calibration.summary()
        sections += calibration.sections(whose)
    return figures, sections


def _per_pixel() -> np.ndarray:
    return np.arange(_LARGEST + 1) / 3


def _left(pixels: np.ndarray, errors: np.ndarray) -> np.ndarray:
    """Return the mean error of what is kept; groups of pixels come surest first."""
    total = pixels.sum()
    kept = (1 - DROPPED) * total
    # Within a group all pixels are alike: its error grows evenly with its pixels.
    some = pixels > 0
    pixel_steps = np.concatenate([[0], np.cumsum(pixels[some])])
    error_steps = np.concatenate([[0], np.cumsum(errors[some])])
    return np.interp(kept, pixel_steps, error_steps) / np.maximum(kept, 1e-9)
