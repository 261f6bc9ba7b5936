"""
How steady a widened view is: along a walk, and while the camera stands still.

Warping error as in Lai et al. (ECCV 2018): the last wide image is brought to the present one by
the true motion; what then differs was not steady. Depth and poses are the truth's, not a flow.
"""
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

from neo_ros.evaluation.baselines import Method
from neo_ros.evaluation.evaluate import run_method, StatefulMethod, TruthFrames
from neo_ros.geometry import Intrinsics
from neo_ros.machine.files import whole_file
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.filling import sample_pixels
import numpy as np

DepthOf = Callable[[int], np.ndarray]


@dataclass(frozen=True)
class StabilityRules:
    """What counts as steady; figures of one table have the same."""

    # A point is hidden in the last frame where something is nearer there by this share: half
    # precision and the slant of a pixel stay below.
    hidden: float = 0.05
    least_counted: float = 0.01  # of the pixels; of fewer an error says nothing
    noise: float = 2.0           # standard deviation of the sensor noise, grey levels
    standing: int = 8            # frames of a camera that stands still


class WarpingError:
    """
    Score every wide image against the last one of its walk; a watcher of `score_frames`.

    depth_of(index) is the true depth of a frame: float (H, W), metres along the optical axis.
    The truth is scored beside it: what changes in the scene, and what is wrong with the depth, is
    an error of every faithful method.
    """

    def __init__(self, frames: TruthFrames, depth_of: DepthOf) -> None:
        self.frames, self.depth_of = frames, depth_of
        self.last: tuple[int, tuple[np.ndarray, np.ndarray], np.ndarray] | None = None

    def __call__(self, index: int, wide_image: np.ndarray) -> dict[str, float]:
        """Return warping_error and truth_warping_error; nothing for a walk's first frame."""
        now = wide_image, self.frames.read(index)[1]
        usable = self.frames.read_usable(index)
        if usable is None:
            usable = np.ones(wide_image.shape[:2], bool)
        last, self.last = self.last, (index, now, usable)
        images = self.frames.images
        if last is None or images.path_ids[last[0]] != images.path_ids[index]:
            return {}
        T_last_now = images.poses[last[0]].inverse() @ images.poses[index].T_world_cam
        where, visible = follow_points(self.frames.expansion.target, self.depth_of(index),
                                       self.depth_of(last[0]), T_last_now)
        usable = usable & (sample_pixels(last[2].astype(np.float32), where) > 0.9999)
        counted = visible & usable & self.frames.expansion.extrapolated_mask
        names = ('warping_error', 'truth_warping_error')
        errors = {name: warping_error(image, before, where, counted)
                  for name, image, before in zip(names, now, last[1])}
        return {name: error for name, error in errors.items() if error is not None}


def follow_points(camera: Intrinsics, depth: np.ndarray, last_depth: np.ndarray,
                  T_last_now: np.ndarray, rules: StabilityRules = StabilityRules(),
                  ) -> tuple[np.ndarray, np.ndarray]:
    """
    Find where the points that are seen now were seen in the last frame.

    depth, last_depth: float (H, W), metres along the optical axis. Returns pixels (H, W, 2)
    float32, and bool (H, W): inside the last frame and not hidden there.
    """
    points = camera.pixel_rays() * depth[..., None]
    before = points @ T_last_now[:3, :3].T + T_last_now[:3, 3]
    where = np.nan_to_num(camera.project(before), nan=-1e3).astype(np.float32)
    inside = ((where > 0.5) & (where < np.array([camera.width, camera.height]) - 0.5)).all(-1)
    seen = sample_pixels(last_depth.astype(np.float32), where)
    # Of a point whose depth in either frame is not known, nobody can tell.
    visible = before[..., 2] <= seen * (1 + rules.hidden)
    return where, inside & visible & np.isfinite(depth)


def warping_error(wide_image: np.ndarray, last_image: np.ndarray, where: np.ndarray,
                  counted: np.ndarray, rules: StabilityRules = StabilityRules(),
                  ) -> float | None:
    """
    Return the mean squared difference to the last image brought here; colours in 0 ... 1.

    Images RGB uint8 (H, W, 3), where (H, W, 2) as of `follow_points`. None if too little is
    counted to say anything.
    """
    if counted.mean() < rules.least_counted:
        return None
    brought = sample_pixels(last_image, where)
    difference = (wide_image[counted].astype(np.float64) - brought[counted]) / 255
    return float((difference ** 2).mean())


def flicker(method: Method, frames: TruthFrames,
            rules: StabilityRules = StabilityRules()) -> float:
    """
    Return how much the ring flickers while the camera stands, grey levels.

    The first view of every walk is shown several times with new sensor noise; the result is the
    mean over ring pixels, channels and walks of the standard deviation over time.
    """
    ring = frames.expansion.extrapolated_mask
    starts = [index for index, path_id in enumerate(frames.images.path_ids)
              if path_id not in frames.images.path_ids[:index]]
    random = np.random.default_rng(0)
    deviations = []
    for index in starts:
        if isinstance(method, StatefulMethod):
            method.reset()
        narrow_image = frames.read(index)[0]
        shown = []
        for _ in range(rules.standing):
            noise = random.normal(0, rules.noise, narrow_image.shape)
            noisy = np.clip(narrow_image + noise + 0.5, 0, 255).astype(np.uint8)
            shown.append(run_method(method, frames, index, noisy)[ring])
        deviations.append(np.std(np.stack(shown).astype(np.float32), axis=0).mean())
    if isinstance(method, StatefulMethod):
        method.reset()
    return float(np.mean(deviations))


def stored_depths(frames: TruthFrames, render: DepthOf, cache: Path,
                  progress: Progress = no_progress) -> DepthOf:
    """Render the depth of every frame once; float16 metres in the file `cache`."""
    try:
        with np.load(cache) as stored:
            depths = stored['depths']
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        depths = None
    target = frames.expansion.target
    if depths is None or depths.shape != (len(frames), target.height, target.width):
        depths = np.empty((len(frames), target.height, target.width), np.float16)
        for index in range(len(frames)):
            depths[index] = render(index)
            progress(index + 1, len(frames))
        with whole_file(cache) as partial, partial.open('wb') as file:
            np.savez(file, depths=depths)
    return lambda index: depths[index].astype(np.float32)
