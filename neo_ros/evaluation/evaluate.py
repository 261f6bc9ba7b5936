"""
Score methods on the wide truth of a scene: per frame, in the mean, and as result rows.

The input of a test frame is the window of its wide truth that the expansion calls observed, so
input and truth agree to the bit.
"""
from dataclasses import dataclass
import os
from pathlib import Path
import platform
import subprocess
import time
from typing import Any, Callable, Iterator, Sequence

from neo_ros.errors import ImageRejected, SceneError
from neo_ros.evaluation.baselines import Method
from neo_ros.evaluation.metrics import Estimate, score_frame, summarise
from neo_ros.geometry import ViewExpansion
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

# The contract of every file of results; null where not measured.
ROW_KEYS = (
    'scene', 'protocol', 'scale', 'method', 'n_frames',
    'ring_psnr', 'ring_ssim', 'ring_lpips_vgg', 'ring_lpips_alex',
    'whole_psnr', 'whole_ssim', 'whole_lpips_vgg', 'oracle_gap_closed', 'warping_error',
    'latency_ms_median', 'latency_ms_p95', 'train_minutes', 'model_mb', 'commit', 'host')
_SCALE_NAMES = {1.0: 'full', 0.5: 'half', 0.25: 'quarter'}

Scorer = Callable[[np.ndarray, np.ndarray, ViewExpansion], dict[str, float]]


@dataclass(frozen=True)
class MethodScores:
    """
    What one method scored on a scene.

    frames     per test frame: frame (file name), path_id, milliseconds and every score
    estimates  mean of every score with a bootstrap 95 % interval over the walking paths
    row        the means under the keys ROW_KEYS
    """

    method: str
    observed_pasted: bool
    frames: list[dict[str, Any]]
    estimates: dict[str, Estimate]
    row: dict[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the row, ready for JSON."""
        return {'method': self.method, 'observed_pasted': self.observed_pasted,
                'estimates': {name: estimate._asdict()
                              for name, estimate in self.estimates.items()},
                'frames': self.frames}


class TruthFrames:
    """
    Wide truth at the resolution of an expansion, with the narrow inputs cut out of it.

    `most` keeps only so many frames, spread evenly. Raises SceneError when there are no test
    images or when they show another view than the expansion's target.
    """

    def __init__(self, test: PosedImages | None, expansion: ViewExpansion,
                 most: int | None = None) -> None:
        if test is None:
            raise SceneError('scene: expected wide test frames to score against, got none; '
                             'add transforms_test.json')
        if most is not None and most < len(test):
            test = test.subset(np.linspace(0, len(test) - 1, most).round().astype(int).tolist())
        self.images = test
        self.expansion = expansion
        self.scale = expansion.target.width / test.intrinsics.width
        _check_same_view(test, expansion, self.scale)

    def __len__(self) -> int:
        return len(self.images)

    def read(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Return narrow input (h, w, 3) and wide truth (H, W, 3) of a frame, RGB uint8."""
        truth = self.images.read_image(index, self.scale)
        return np.ascontiguousarray(self.expansion.crop(truth)), truth

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        return (self.read(index) for index in range(len(self)))


def evaluate(scene_name: str, frames: TruthFrames, methods: Sequence[Method],
             scorers: Sequence[Scorer] = (score_frame,),
             progress: Callable[[int], None] = lambda done: None) -> list[MethodScores]:
    """
    Score every method on every test frame.

    `progress` is called with the number of (frame, method) pairs done. Frames are read once for
    all methods; each method runs once before the clock starts.
    """
    per_method: list[list[dict[str, Any]]] = [[] for _ in methods]
    for method in methods:
        method.expand(frames.read(0)[0])
    for index, (narrow_image, truth) in enumerate(frames):
        for m, method in enumerate(methods):
            start = time.perf_counter()
            wide_image = method.expand(narrow_image)
            milliseconds = (time.perf_counter() - start) * 1e3
            scores: dict[str, Any] = {
                'frame': frames.images.image_paths[index].name,
                'path_id': frames.images.path_ids[index], 'milliseconds': milliseconds}
            _check_pasted(method, narrow_image, wide_image, frames.expansion)
            for scorer in scorers:
                scores.update(scorer(truth, wide_image, frames.expansion))
            per_method[m].append(scores)
            progress(index * len(methods) + m + 1)
    return [_method_scores(scene_name, frames, method, scores)
            for method, scores in zip(methods, per_method)]


def protocol_of(expansion: ViewExpansion) -> str:
    """Name the paper's protocol: 'square', 'horizontal', or 'custom' for any other growth."""
    grow = expansion
    if grow.left == grow.right and grow.top == grow.bottom == 0:
        return 'horizontal'
    if grow.left == grow.right == grow.top == grow.bottom:
        return 'square'
    return 'custom'


def _method_scores(scene_name: str, frames: TruthFrames, method: Method,
                   scores: list[dict[str, Any]]) -> MethodScores:
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


def _check_same_view(test: PosedImages, expansion: ViewExpansion, scale: float) -> None:
    target, truth = expansion.target, test.intrinsics
    scaled = truth.scaled(scale)
    same_size = (scaled.width, scaled.height) == (target.width, target.height)
    # Half a pixel at the rim is what rounding to whole pixels may cost.
    rim = max(abs(target.width / scaled.fx - target.width / target.fx) * target.fx / 2,
              abs(target.height / scaled.fy - target.height / target.fy) * target.fy / 2,
              abs(scaled.cx - target.cx), abs(scaled.cy - target.cy))
    if not same_size or rim > 0.5:
        raise SceneError(
            f'test frames: expected the wide view of the model, {target.width}x{target.height} '
            f'with f = {target.fx:.1f} px or the same at another resolution, got '
            f'{truth.width}x{truth.height} with f = {truth.fx:.1f} px, principal point '
            f'({truth.cx:.1f}, {truth.cy:.1f}); use the model that was trained on this scene')


def _check_pasted(method: Method, narrow_image: np.ndarray, wide_image: np.ndarray,
                  expansion: ViewExpansion) -> None:
    """Keep the `observed_pasted` of the tables honest."""
    if method.observed_pasted and not np.array_equal(expansion.crop(wide_image), narrow_image):
        raise ImageRejected('observed', f'{method.name}: says that it pastes the observed pixels, '
                            'but they came back changed')


def commit() -> str | None:
    """Return the commit of the source checkout, None for an installed package."""
    root = Path(__file__).resolve().parents[2]
    if not (root / '.git').exists():
        return None
    command = ['git', '-C', str(root), 'describe', '--always', '--dirty', '--exclude=*']
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() or None


def host() -> str:
    """Describe the processor that the latencies were taken on."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
        name = next(line.split(':')[1].strip() for line in lines if 'model name' in line)
    except (OSError, StopIteration, IndexError):
        pass  # Not Linux, or a processor that does not say its name.
    return f'{name}, {os.cpu_count()} cores'
