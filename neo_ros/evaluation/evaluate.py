"""
Score methods on the wide truth of a scene: per frame, in the mean, and as result rows.

The input of a test frame is the window of its wide truth that the expansion calls observed, so
input and truth agree to the bit.
"""
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
import tempfile
import time
from typing import Any, Protocol, runtime_checkable

from neo_ros.errors import ImageRejected, SceneError
from neo_ros.evaluation.baselines import Method
from neo_ros.evaluation.metrics import Estimate, score_frame, summarise
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.evenly import evenly
from neo_ros.machine.host import commit, host
from neo_ros.reports.kept_pictures import KeptPictures, pick_frames, read_picture
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

# The contract of every file of results; null where not measured.
ROW_KEYS = (
    'scene', 'protocol', 'scale', 'method', 'n_frames',
    'ring_psnr', 'ring_ssim', 'ring_lpips_vgg', 'ring_lpips_alex',
    'whole_psnr', 'whole_ssim', 'whole_lpips_vgg', 'oracle_gap_closed', 'warping_error',
    'latency_ms_median', 'latency_ms_p95', 'train_minutes', 'model_mb', 'commit', 'host')
_SCALE_NAMES = {1.0: 'full', 0.5: 'half', 0.25: 'quarter'}

# (truth, wide image, expansion, which pixels of the truth show the scene or None: all) -> scores
Scorer = Callable[[np.ndarray, np.ndarray, ViewExpansion, np.ndarray | None], dict[str, float]]
# Looks at every wide image: (index of the frame, image) -> further scores of the frame.
Watcher = Callable[[int, np.ndarray], dict[str, float]]


@runtime_checkable
class TruePoseMethod(Protocol):
    """A method that is told the true pose: an upper bound, not a rival."""

    def expand_at(self, narrow_image: np.ndarray, true_pose: CameraPose) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""


@runtime_checkable
class StatefulMethod(Protocol):
    """A method whose result depends on the frames before."""

    def reset(self) -> None:
        """Forget them: another walk begins."""


@runtime_checkable
class TalkingMethod(Protocol):
    """A method that can say more of its last frame than the image."""

    def notes(self, true_pose: CameraPose) -> dict[str, float]:
        """Return named figures, e.g. how far the estimated pose was off."""


@dataclass(frozen=True)
class MethodScores:
    """
    What one method scored on a scene.

    frames     per test frame: frame (file name), path_id, milliseconds and every score
    estimates  mean of every score with a bootstrap 95 % interval over the walking paths
    row        the means under the keys ROW_KEYS
    figures    of the method as a whole, e.g. flicker
    pictures   by index of the frame: the wide images of the best, the median and the worst
    """

    method: str
    observed_pasted: bool
    frames: list[dict[str, Any]]
    estimates: dict[str, Estimate]
    row: dict[str, Any]
    figures: dict[str, float] = field(default_factory=dict)
    pictures: dict[int, np.ndarray] = field(default_factory=dict, compare=False, repr=False)

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the row and the pictures, ready for JSON."""
        return {'method': self.method, 'observed_pasted': self.observed_pasted,
                'estimates': {name: estimate._asdict()
                              for name, estimate in self.estimates.items()},
                'figures': self.figures, 'frames': self.frames}


class TruthFrames:
    """
    Wide truth at the resolution of an expansion, with the narrow inputs cut out of it.

    Test images may show more than the expansion's target: the target is cut out. `most` keeps
    only so many frames, spread evenly. Raises SceneError when there are no test images or when
    they do not show the target.
    """

    def __init__(self, test: PosedImages | None, expansion: ViewExpansion,
                 most: int | None = None) -> None:
        if test is None:
            raise SceneError('scene: expected wide test frames to score against, got none; '
                             'add transforms_test.json')
        if most is not None:
            test = test.subset(evenly(len(test), most).tolist())
        self.images = test
        self.expansion = expansion
        self.scale = expansion.target.fx / test.intrinsics.fx
        # Sizes in whole pixels may make the focal length a little off.
        by_width = expansion.target.width / test.intrinsics.width
        if abs(self.scale / by_width - 1) * expansion.target.width < 1:
            self.scale = by_width
        self.window = _window_of_target(test, expansion, self.scale)

    def __len__(self) -> int:
        return len(self.images)

    def read(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Return narrow input (h, w, 3) and wide truth (H, W, 3) of a frame, RGB uint8."""
        truth = np.ascontiguousarray(self.images.read_image(index, self.scale)[self.window])
        return np.ascontiguousarray(self.expansion.crop(truth)), truth

    def read_usable(self, index: int) -> np.ndarray | None:
        """
        Return which pixels of a frame's truth show the scene, bool (H, W); None without a mask.

        Raises SceneError for a mask that leaves nothing of the ring.
        """
        usable = self.images.read_usable(index, self.scale)
        if usable is None:
            return None
        usable = usable[self.window]
        if not usable[self.expansion.extrapolated_mask].any():
            raise SceneError(
                f'{self.images.mask_paths[index]}: expected a mask that leaves some of what the '
                'camera does not see, to score on; take its frame out of transforms_test.json')
        return usable

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        return (self.read(index) for index in range(len(self)))


def evaluate(scene_name: str, frames: TruthFrames, methods: Sequence[Method],
             scorers: Sequence[Scorer] = (score_frame,),
             progress: Callable[[int], None] = lambda done: None) -> list[MethodScores]:
    """
    Score every method on every test frame, and keep three of its pictures.

    `progress` is called with the number of (method, frame) pairs done.
    """
    results = []
    for m, method in enumerate(methods):
        with tempfile.TemporaryDirectory() as folder:
            kept = Path(folder) / 'pictures'
            scores = score_frames(
                frames, method, scorers, [KeptPictures(kept)],
                lambda done, m=m: progress(m * len(frames) + done))  # type: ignore[misc]
            pictures = {index: read_picture(kept, index, frames.expansion.target)
                        for index in pick_frames(scores).values()}
        results.append(replace(method_scores(scene_name, frames, method, scores),
                               pictures=pictures))
    return results


def score_frames(frames: TruthFrames, method: Method, scorers: Sequence[Scorer] = (score_frame,),
                 watchers: Sequence[Watcher] = (),
                 progress: Callable[[int], None] = lambda done: None) -> list[dict[str, Any]]:
    """
    Run a method over the test frames, in their order; returns every frame's scores.

    The method runs once before the clock starts, and is reset where another path begins.
    """
    results: list[dict[str, Any]] = []
    run_method(method, frames, 0, frames.read(0)[0])
    path_id = None
    for index, (narrow_image, truth) in enumerate(frames):
        if frames.images.path_ids[index] != path_id and isinstance(method, StatefulMethod):
            method.reset()
        path_id = frames.images.path_ids[index]
        start = time.perf_counter()
        wide_image = run_method(method, frames, index, narrow_image)
        scores: dict[str, Any] = {
            'frame': frames.images.image_paths[index].name, 'path_id': path_id,
            'milliseconds': (time.perf_counter() - start) * 1e3}
        _check_pasted(method, narrow_image, wide_image, frames.expansion)
        usable = frames.read_usable(index)
        for scorer in scorers:
            scores.update(scorer(truth, wide_image, frames.expansion, usable))
        for watcher in watchers:
            scores.update(watcher(index, wide_image))
        if isinstance(method, TalkingMethod):
            scores.update(method.notes(frames.images.poses[index]))
        results.append(scores)
        progress(index + 1)
    return results


def run_method(method: Method, frames: TruthFrames, index: int,
               narrow_image: np.ndarray) -> np.ndarray:
    """Widen a narrow image that was taken where frame `index` was."""
    if isinstance(method, TruePoseMethod):
        return method.expand_at(narrow_image, frames.images.poses[index])
    return method.expand(narrow_image)


def protocol_of(expansion: ViewExpansion) -> str:
    """Name the paper's protocol: 'square', 'horizontal', or 'custom' for any other growth."""
    grow = expansion
    if grow.left == grow.right and grow.top == grow.bottom == 0:
        return 'horizontal'
    if grow.left == grow.right == grow.top == grow.bottom:
        return 'square'
    return 'custom'


def method_scores(scene_name: str, frames: TruthFrames, method: Method,
                  scores: list[dict[str, Any]]) -> MethodScores:
    """Summarise the scores of every frame."""
    estimates = summarise(scores)
    milliseconds = [frame['milliseconds'] for frame in scores]
    row: dict[str, Any] = dict.fromkeys(ROW_KEYS)
    row.update({name: estimate.mean for name, estimate in estimates.items() if name in row})
    row.update({
        'scene': scene_name, 'protocol': protocol_of(frames.expansion),
        'scale': _SCALE_NAMES.get(frames.scale, f'{frames.scale:.4g}'), 'method': method.name,
        'n_frames': len(scores),
        'latency_ms_median': float(np.median(milliseconds)),
        'latency_ms_p95': float(np.percentile(milliseconds, 95)),
        'train_minutes': method.train_minutes, 'model_mb': method.model_mb,
        'commit': commit(), 'host': host()})
    return MethodScores(method.name, method.observed_pasted, scores, estimates, row)


def _window_of_target(test: PosedImages, expansion: ViewExpansion,
                      scale: float) -> tuple[slice, slice]:
    """Find the rows and columns of the resampled test images that are the wide view."""
    target, truth = expansion.target, test.intrinsics
    scaled = truth.scaled(scale)
    left, top = round(scaled.cx - target.cx), round(scaled.cy - target.cy)
    inside = (0 <= left <= scaled.width - target.width
              and 0 <= top <= scaled.height - target.height)
    # Half a pixel at the rim is what rounding to whole pixels may cost.
    rim = max(abs(target.width / scaled.fx - target.width / target.fx) * target.fx / 2,
              abs(target.height / scaled.fy - target.height / target.fy) * target.fy / 2,
              abs(scaled.cx - left - target.cx), abs(scaled.cy - top - target.cy))
    if not inside or rim > 0.5:
        raise SceneError(
            f'test frames: expected the wide view of the model, {target.width}x{target.height} '
            f'with f = {target.fx:.1f} px or the same at another resolution, got '
            f'{truth.width}x{truth.height} with f = {truth.fx:.1f} px, principal point '
            f'({truth.cx:.1f}, {truth.cy:.1f}); use the model that was trained on this scene')
    return (slice(top, top + target.height), slice(left, left + target.width))


def _check_pasted(method: Method, narrow_image: np.ndarray, wide_image: np.ndarray,
                  expansion: ViewExpansion) -> None:
    """Keep the `observed_pasted` of the tables honest."""
    if method.observed_pasted and not np.array_equal(expansion.crop(wide_image), narrow_image):
        raise ImageRejected('observed', f'{method.name}: says that it pastes the observed pixels, '
                            'but they came back changed')
