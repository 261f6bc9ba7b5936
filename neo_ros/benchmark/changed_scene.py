"""
What happens where the camera contradicts what the model remembers: the flat with chairs moved.

    python -m neo_ros.benchmark.changed_scene models/demo_flat.onnx

Renders walks before and after somebody moved four chairs and widens both. Prints, over
the frames in which a change crosses the border of the camera's view: whether the pose holds, how
much of the change the wide image shows, and whether the confidence falls where it is now wrong.
"""
from dataclasses import asdict, dataclass
import json
from pathlib import Path
import sys

from neo_ros.evaluation.metrics import auroc, psnr
from neo_ros.flat.demo_flat import build_demo_flat, DemoFlat, walking_paths
from neo_ros.flat.visits import CHAIRS, changed_flat
from neo_ros.geometry import CameraPose
from neo_ros.runtime import FovExtrapolator
import numpy as np


@dataclass(frozen=True)
class ChangeRules:
    """What counts as a change, and where it is looked at."""

    changed: float = 25.0      # grey levels, mean of the channels: more is another thing
    near_seam: float = 0.125   # of the camera's width: how far from the seam the ring counts
    least_pixels: int = 8      # that a change has at either side of the seam
    nearest: float = 0.8       # metres that the camera keeps off a moved chair
    # Of the walks: others than the test walks (0), on which settings of the memory were looked at.
    walk_seed: int = 1


@dataclass(frozen=True)
class ChangeScores:
    """
    Means over the frames with a change across the seam.

    guided: share of the frames. unchanged_psnr: of the ring where nothing changed, dB, before
    and after; changed_psnr: of the rest, after. wrong: share of what changed near the seam that
    the wide image does not show. confidence: 0 ... 255 in that, before and after; auroc: how well
    the confidence tells it from unchanged pixels there; of the frames that have some, or NaN.
    """

    frames: int
    guided: float
    unchanged_psnr: tuple[float, float]
    changed_psnr: float
    wrong: float
    confidence: tuple[float, float]
    auroc: float


def score_change(extrapolator: FovExtrapolator, walks: list[list[CameraPose]],
                 rules: ChangeRules = ChangeRules()) -> ChangeScores:
    """Widen the walks before and after the chairs are moved; ValueError where none is crossed."""
    before = build_demo_flat()
    after = changed_flat(before, CHAIRS)
    pairs = list(zip(*(_walk(extrapolator, flat, walks, rules.nearest)
                       for flat in (before, after))))
    expansion = extrapolator.expansion
    ring = expansion.extrapolated_mask
    near = _near_seam(expansion.observed, ring.shape, rules.near_seam * expansion.source.width)
    rows, shares, confidence, ranked = [], [], [], []
    for (truth, wide, sure, _), (new_truth, new_wide, new_sure, guided) in pairs:
        changed = np.abs(new_truth.astype(float) - truth).mean(-1) > rules.changed
        sides = (changed & near & ring, changed & near & ~ring)
        if min(side.sum() for side in sides) < rules.least_pixels:
            continue
        same, outside = ring & ~changed, ring & changed
        rows.append((guided, psnr(truth[same], wide[same]), psnr(new_truth[same], new_wide[same]),
                     psnr(new_truth[outside], new_wide[outside])))
        wrong = sides[0] & (np.abs(new_wide.astype(float) - new_truth).mean(-1) > rules.changed)
        shares.append(wrong.sum() / sides[0].sum())
        if wrong.sum() < rules.least_pixels:
            continue
        confidence.append((sure[wrong].mean(), new_sure[wrong].mean()))
        ranked.append(auroc(255.0 - new_sure[wrong], 255.0 - new_sure[near & same]))
    if not rows:
        raise ValueError('walks: no frame shows a moved chair across the border of its view')
    guided, psnr_before, psnr_after, changed_psnr = np.mean(rows, 0).tolist()
    nothing = [(np.nan, np.nan)]
    sure_before, sure_after = np.mean(confidence or nothing, 0).tolist()
    return ChangeScores(len(rows), guided, (psnr_before, psnr_after), changed_psnr,
                        float(np.mean(shares)), (sure_before, sure_after),
                        float(np.mean(ranked or np.nan)))


def _walk(extrapolator: FovExtrapolator, flat: DemoFlat, walks: list[list[CameraPose]],
          nearest: float) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, bool]]:
    """Return truth, wide image, confidence and whether it was guided, of all frames in order."""
    moved = np.array([chair.goal for chair in CHAIRS])
    frames = []
    for walk in walks:
        extrapolator.reset()
        for pose in walk:
            if np.linalg.norm(moved - pose.position[:2], axis=1).min() < nearest:
                continue
            truth = flat.render(extrapolator.expansion.target, pose)[0]
            wide = extrapolator.expand(np.ascontiguousarray(extrapolator.expansion.crop(truth)))
            frames.append((truth, wide.wide_image, wide.confidence, wide.guided))
    return frames


def _near_seam(observed: tuple[slice, slice], shape: tuple[int, ...], reach: float) -> np.ndarray:
    """Return which pixels, bool (H, W), lie within `reach` of the border of the observed part."""
    rows, columns = np.indices(shape)
    distances = []
    for index, span in ((rows, observed[0]), (columns, observed[1])):
        distances.append(np.maximum(span.start - index, index - (span.stop - 1)))
    return np.abs(np.maximum(*distances)) <= reach


def main() -> None:
    """Score the model of the command line and print JSON."""
    if len(sys.argv) != 2:
        sys.exit('usage: python -m neo_ros.benchmark.changed_scene MODEL.onnx')
    extrapolator = FovExtrapolator.load(Path(sys.argv[1]))
    walks = walking_paths(build_demo_flat(), 8, 25, ChangeRules().walk_seed)
    scores = score_change(extrapolator, walks)
    print(json.dumps(asdict(scores), indent=1))


if __name__ == '__main__':
    main()
