"""
Which remembered depth should be told: the share of the ring against how far off it is.

    python -m neo_ros.benchmark.depth_trust models/demo_flat.onnx WORK

Walks through the demo flat that no test uses are rendered into the folder WORK; the shipped model
follows them, and its depth is cut by other thresholds (`TrustThresholds`). Prints the rows and
writes results/depth_trust.json.
"""
from collections.abc import Mapping
from pathlib import Path
import sys
from typing import Any

from neo_ros.benchmark.true_depth import demo_depth
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.evaluation.geometry import DepthScores, follow, OccupancyGrid, TrueSpace
from neo_ros.evaluation.stability import DepthOf
from neo_ros.flat.scene_writing import write_demo_scene
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.machine.result_rows import ResultRows
from neo_ros.memory.sight import TrustThresholds
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.upright import read_upright_scene

RESULTS = Path('results/depth_trust.json')
SEED, WALKS, FRAMES = 77, 4, 6  # of walks that nothing else is measured on
NEVER = 1e9
TRIED = {
    'all that is remembered': TrustThresholds(NEVER, least_confidence=0),
    **{f'confidence at least {value}': TrustThresholds(NEVER, least_confidence=value)
       for value in (64, 96, 128, 160)},
    **{f'images differ by at most {value}': TrustThresholds(value, least_confidence=0)
       for value in (24, 12, 6)},
    **{f'bend at most {value}': TrustThresholds(NEVER, least_confidence=0, bend=value)
       for value in (0.2, 0.1, 0.05, 0.02)},
    'as sent': TrustThresholds(),
}


def measure(model: Path, frames: TruthFrames, true_depth: DepthOf, results: Path = RESULTS,
            tried: Mapping[str, TrustThresholds] = TRIED,
            progress: Progress = no_progress) -> list[dict[str, Any]]:
    """Follow the walks of the frames, score what each of `tried` tells, note and return rows."""
    scores = {name: DepthScores() for name in tried}
    grid, ring, told = OccupancyGrid(), frames.expansion.extrapolated_mask, 0
    for index, view in follow(frames, FovExtrapolator.load(model)):
        if view.guide is not None:
            told += 1
            truth = TrueSpace(
                true_depth(index), frames.images.poses[index], frames.expansion, grid)
            for name, thresholds in tried.items():
                scores[name].add(view.guide.trusted_depth(
                    view.wide_image, view.confidence, thresholds), view.guide.pose, truth)
        progress(index + 1, len(frames))
    kept = ResultRows(results)
    for name, found in scores.items():
        known = sum(len(errors) for errors in found.errors)
        kept.add({'setting': name, 'n_frames': told, 'told': known / max(told * ring.sum(), 1),
                  **found.figures()})
    return kept.rows


def main() -> None:
    """Measure the model that the command line names, and keep the figures."""
    if len(sys.argv) != 3:
        sys.exit('usage: python -m neo_ros.benchmark.depth_trust MODEL.onnx WORK')
    model, work = (Path(argument) for argument in sys.argv[1:])
    write_demo_scene(work, n_train=1, n_paths=WALKS, frames_per_path=FRAMES, seed=SEED)
    scene = read_upright_scene(work)
    frames = TruthFrames(scene.test, FovExtrapolator.load(model, guided=False).expansion)
    RESULTS.unlink(missing_ok=True)
    for row in measure(model, frames, demo_depth(frames)):
        print(row)


if __name__ == '__main__':
    main()
