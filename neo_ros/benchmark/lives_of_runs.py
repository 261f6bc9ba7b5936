"""
What a memory learns, or an update finds, on real runs that are visits of one another.

    python -m neo_ros.benchmark.lives_of_runs RUN SCENE [--config CONFIG] [--out FILE]

RUN is the folder of `neo train` (with CONFIG), SCENE has test frames in several runs, each wider
than the camera's view. On each visit the camera goes through one run and learns, and `neo update`
takes its bag; all other runs are scored. Nobody knows what has changed between them, so all of the
ring is scored, and false changes are what was shown right before and is not any more. The rows are
added to those in FILE.
"""
import argparse
from pathlib import Path
import shutil
import tempfile
from typing import Any

from neo_ros.benchmark.killing import end, neo
from neo_ros.benchmark.lives import as_bag, drive
from neo_ros.benchmark.lives_scores import rows_of, Walks, write_rows
from neo_ros.errors import SceneError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.runtime import FovExtrapolator
from neo_ros.scenes.upright import read_upright_scene
import numpy as np


def measure(run: Path, scene: Path, config: Path | None) -> list[dict[str, Any]]:
    """Return a row for each run of the test frames and each mode; see the module."""
    trained, = run.glob('*.onnx')
    expansion = FovExtrapolator.load(trained, guided=False).expansion
    test = read_upright_scene(scene).test
    truth = TruthFrames(test, expansion)
    walks = Walks(np.stack([wide for _, wide in truth]), truth.images.T_world_cam,
                  np.array(truth.images.path_ids))
    runs = np.unique(walks.walk)
    if len(runs) < 2:
        raise SceneError(f'{scene}: expected test frames of two runs or more (path_id), got one')
    rows: list[dict[str, Any]] = []
    for visit in runs:
        path, others = (Walks(walks.images[chosen], walks.T[chosen], walks.walk[chosen])
                        for chosen in (walks.walk == visit, walks.walk != visit))
        with tempfile.TemporaryDirectory() as work:
            models = {'none': trained, 'learn': Path(work) / trained.name}
            for file in (trained, trained.with_suffix('.memory')):
                shutil.copy(file, work)
            drive(models['learn'], path)
            bag, after = Path(work) / 'bag', Path(work) / 'update'
            as_bag(bag, path, trained)
            minutes = end(neo('update', run, bag, '--out', after, '--scene', scene,
                              *(() if config is None else ('--config', config)))) / 60
            # Where nothing has changed nothing is written.
            models['update'] = after / trained.name if after.exists() else trained
            rows += rows_of(scene.name, int(visit), models, others, others, {
                'light': None, 'door': None, 'people': None}, minutes)[0]
    return rows


def main() -> None:
    """Measure, and add the rows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('run', type=Path)
    parser.add_argument('scene', type=Path)
    parser.add_argument('--config', type=Path)
    parser.add_argument('--out', type=Path, default=Path('results/lives.json'))
    given = parser.parse_args()
    write_rows(given.out, measure(given.run, given.scene, given.config))


if __name__ == '__main__':
    main()
