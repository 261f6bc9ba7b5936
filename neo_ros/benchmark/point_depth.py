"""
How true the depth of field and memory is where nothing measured it: against triangulated points.

    neo import CAPTURE DEV --test-runs 3
    neo train DEV --minutes 10 --out RUN
    python -m neo_ros.benchmark.point_depth DEV RUN

Photos and test frames are matched; a point counts in the test frames that show it, in their
ring. Prints the rows and adds them to results/point_depth.json.
"""
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
import sys
import tempfile
from typing import Any

from neo_ros.baking.landmarks import find_points
from neo_ros.benchmark.true_depth import field_depth
from neo_ros.errors import SceneError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.evaluation.geometry import DepthScores
from neo_ros.experiment import Experiment
from neo_ros.field.device import read_field
from neo_ros.machine.files import sha256_of
from neo_ros.machine.progress import no_stage_progress
from neo_ros.machine.result_rows import ResultRows
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.time_plan import PLAN_FILE, read_plan
import numpy as np

RESULTS = Path('results/point_depth.json')


def measure(scene: Path, run: Path, experiment: Experiment, results: Path = RESULTS
            ) -> list[dict[str, Any]]:
    """
    Compare the field and the memory of a run with points that its scene's photos show.

    experiment: what the run was trained with. Returns and keeps a row for each of the two. Raises
    SceneError for a scene without photos as test frames, or that show too little alike.
    """
    found = read_upright_scene(scene)
    if found.test is None or found.test.intrinsics != found.train.intrinsics:
        raise SceneError(f'{scene}: expected runs of photos held out as test frames, made by: '
                         f'neo import CAPTURE {scene} --test-runs 3')
    expansion = experiment.expansion(found.train.intrinsics, found.expansion)
    frames = TruthFrames(found.test, expansion)
    points = _points_in(frames, found.train, experiment.scale)
    memory_file = run / f'{found.name}.memory'
    renderer = MemoryRenderer(SceneMemory.read(memory_file, sha256_of(memory_file)))

    def remembered(index: int) -> np.ndarray:
        view = renderer.render(frames.images.poses[index], expansion.target)
        return np.where((view.depth > 0) & ~view.stretched, view.depth, np.nan)

    kept = ResultRows(results)
    ways: dict[str, Callable[[int], np.ndarray]] = {
        'field': field_depth(frames, read_field(run / 'field.npz', 'cpu')), 'memory': remembered}
    for what, depth_of in ways.items():
        scores, known = DepthScores(), 0
        for index, true in enumerate(points):
            depth = depth_of(index)
            known += int((np.isfinite(depth) & np.isfinite(true)).sum())
            pose = frames.images.poses[index]
            scores.add(depth, true, pose, pose, expansion, None)
        row = {'scene': found.name, 'what': what, 'photos': len(found.train),
               'n_frames': len(frames), 'points': int(np.isfinite(points).sum()),
               'known': known / max(int(np.isfinite(points).sum()), 1), **scores.figures()}
        print(kept.add(row), flush=True)
    return kept.rows


def _points_in(frames: TruthFrames, train: PosedImages, scale: float) -> np.ndarray:
    """Return the depth of points in the ring of test frames (N, H, W), metres; NaN = no point."""
    test, expansion = frames.images, frames.expansion
    both = replace(train, image_paths=train.image_paths + test.image_paths,
                   poses=train.poses + test.poses, path_ids=train.path_ids + test.path_ids,
                   depth_paths=(), mask_paths=())
    with tempfile.TemporaryDirectory() as work:
        made = find_points(both, scale, expansion.source, Path(work), no_stage_progress)
    if made is None:
        raise SceneError('expected photos that points can be triangulated from, and pycolmap')
    _, model = made
    camera = expansion.target
    depths = np.full((len(test), camera.height, camera.width), np.nan, np.float32)
    for depth, pose, point_of in zip(depths, test.poses, model.point_of[len(train):]):
        T = pose.T_world_cam
        seen = (model.points[point_of[point_of >= 0]] - T[:3, 3]) @ T[:3, :3]
        seen = seen[seen[:, 2] > 0]
        columns, rows = np.floor(camera.project(seen)).astype(int).T
        inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        depth[rows[inside], columns[inside]] = seen[inside, 2]
        depth[expansion.observed] = np.nan
    return depths


def main() -> None:
    """Measure the scene and the run that the command line names, and keep the figures."""
    if len(sys.argv) != 3:
        sys.exit('usage: python -m neo_ros.benchmark.point_depth DEV RUN')
    run = Path(sys.argv[2])
    measure(Path(sys.argv[1]), run,
            read_plan(run).experiment if (run / PLAN_FILE).exists() else Experiment())


if __name__ == '__main__':
    main()
