"""
What the memory learns of a flat that changes from visit to visit.

    python -m neo_ros.benchmark.lives [--frames DIR] [--drive 130] [--visits 4] [--out FILE]

On each visit to the demo flat (see `flat/visits.py`) the shipped model drives through it and
learns; then other walks are widened by the memory as it was trained, and as it has become. Scores
are of the ring in the frames that show something changed, with exact truth. Frames are kept in
DIR: casting them takes longer than all the rest.
"""
import argparse
from collections.abc import Iterator
from dataclasses import dataclass
import json
from pathlib import Path
import shutil
import tempfile
from typing import Any

from neo_ros.evaluation.metrics import auroc, psnr
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.flat.visits import CHAIRS, changed_flat, PLANT, VISITS
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import share_dir, write_bytes
from neo_ros.machine.host import commit, host
from neo_ros.memory.contradiction import contradiction
from neo_ros.runtime import FovExtrapolator
import numpy as np


@dataclass(frozen=True)
class LivesRules:
    """Where the camera drives, and what counts."""

    changed: float = 25.0      # grey levels, mean of the channels: more is another thing
    least_pixels: int = 32     # of the ring that are changed, for a frame to count
    nearest: float = 0.8       # metres that the camera keeps off what was moved
    test_seed: int = 1         # of 8 walks, as in `changed_scene`
    drive_seed: int = 21       # of 20 walks on visit 0, the next number on the next visit
    right_metres: float = 0.1  # a pose is right if it is so near
    right_cosine: float = 0.999


RULES = LivesRules()


@dataclass(frozen=True, eq=False)
class Walks:
    """Wide images uint8 (N, H, W, 3), T (N, 4, 4), and the number (N,) of a frame's walk."""

    images: np.ndarray
    T: np.ndarray
    walk: np.ndarray


def walks_of(visit: int, seed: int, count: int, camera: Any, folder: Path) -> Walks:
    """Cast the frames of some walks on a visit, or read them where they are kept."""
    path = folder / f'frames_{visit}_{seed}.npz'
    if not path.exists():
        flat, paths = build_demo_flat(), []
        off = np.array([one.goal for one in (*CHAIRS, PLANT)])
        for number, walk in enumerate(walking_paths(flat, count, 25, seed)):
            paths += [(number, pose) for pose in walk if np.linalg.norm(
                off - pose.position[:2], axis=1).min() >= RULES.nearest]
        there = changed_flat(flat, VISITS[visit])
        folder.mkdir(parents=True, exist_ok=True)
        np.savez(path, images=np.stack([there.render(camera, pose)[0] for _, pose in paths]),
                 T=np.stack([pose.T_world_cam for _, pose in paths]),
                 walk=np.array([number for number, _ in paths]))
    with np.load(path) as data:
        return Walks(data['images'], data['T'], data['walk'])


def widened(extrapolator: FovExtrapolator, walks: Walks) -> Iterator[tuple[int, Any]]:
    """Yield number and wide view of each frame; each walk begins anew."""
    for index, image in enumerate(walks.images):
        if index == 0 or walks.walk[index] != walks.walk[index - 1]:
            extrapolator.reset()
        yield index, extrapolator.expand(np.ascontiguousarray(extrapolator.expansion.crop(image)))


def drive(model: Path, walks: Walks) -> None:
    """Learn from walks."""
    extrapolator = FovExtrapolator.load(model, learn='at once')
    for _ in widened(extrapolator, walks):
        pass
    extrapolator.finish_learning()


def score(model: Path, walks: Walks, before: Walks
          ) -> tuple[dict[str, float | None], list[np.ndarray]]:
    """Widen walks, whose frames `before` shows as they were trained; return scores and images."""
    extrapolator = FovExtrapolator.load(model)
    expansion, ring = extrapolator.expansion, extrapolator.extrapolated_mask
    rows, images, right, told, same = [], [], [], [], []
    for index, view in widened(extrapolator, walks):
        truth, wide = walks.images[index], view.wide_image
        changed = _apart(truth, before.images[index]) > RULES.changed
        images.append(wide)
        right.append(view.guide is not None and _near(view.guide.pose, walks.T[index]))
        if (changed & ring).sum() >= RULES.least_pixels:
            rows.append((psnr(truth[changed & ring], wide[changed & ring]),
                         psnr(truth[~changed & ring], wide[~changed & ring])))
        elif not changed.any():
            rows.append((np.nan, psnr(truth[ring], wide[ring])))
        if view.guide is not None:
            off = contradiction(
                expansion.crop(truth).astype(np.float32),
                np.ascontiguousarray(expansion.crop(view.guide.image)),
                expansion.crop(view.guide.known))
            seen = expansion.crop(changed)
            told.append(off[seen])
            same.append(off[~seen][::16])
    changed_psnr, unchanged_psnr = (
        [row[side] for row in rows if np.isfinite(row[side])] for side in (0, 1))
    scores: dict[str, float | None] = {
        'changed_ring_psnr': float(np.mean(changed_psnr)) if changed_psnr else None,
        'unchanged_ring_psnr': float(np.mean(unchanged_psnr)),
        'pose_share': float(np.mean(right)), 'contradiction_auroc': None}
    if sum(map(len, told)):
        scores['contradiction_auroc'] = auroc(np.concatenate(told), np.concatenate(same))
    return scores, images


def false_changes(walks: Walks, before: Walks, none: list[np.ndarray], learnt: list[np.ndarray],
                  ring: np.ndarray) -> float:
    """Return the share of the unchanged ring that was shown right before it was learnt."""
    wrong = total = 0
    for truth, old, untaught, taught in zip(walks.images, before.images, none, learnt):
        same = ring & (_apart(truth, old) <= RULES.changed)
        wrong += int((same & (_apart(truth, untaught) <= RULES.changed)
                      & (_apart(truth, taught) > RULES.changed)).sum())
        total += int(same.sum())
    return wrong / total


def measure(frames: Path, visits: int, driven: int) -> list[dict[str, Any]]:
    """Go through the visits; return a row for each and each mode."""
    rows: list[dict[str, Any]] = []
    about = {'scene': 'demo_flat', 'update_minutes': None, 'commit': commit(), 'host': host()}
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder) / 'demo_flat.onnx'
        for name in ('demo_flat.onnx', 'demo_flat.memory'):
            shutil.copy(share_dir() / 'models' / name, folder)
        journal = Path(folder) / 'demo_flat.memory.journal'
        memory_bytes = (Path(folder) / 'demo_flat.memory').stat().st_size
        untaught = share_dir() / 'models' / 'demo_flat.onnx'
        expansion = FovExtrapolator.load(untaught, guided=False).expansion
        ring, camera = expansion.extrapolated_mask, expansion.target
        before = walks_of(0, RULES.test_seed, 8, camera, frames)
        for visit in range(visits):
            test = walks_of(visit, RULES.test_seed, 8, camera, frames)
            path = walks_of(visit, RULES.drive_seed + visit, 20, camera, frames)
            drive(model, Walks(path.images[:driven], path.T[:driven], path.walk[:driven]))
            none, as_trained = score(untaught, test, before)
            learnt, taught = score(model, test, before)
            learnt['contradiction_auroc'] = None  # What was learnt contradicts no more.
            for mode, scores in (('none', none), ('learn', learnt)):
                kept = journal.stat().st_size if mode == 'learn' and journal.exists() else 0
                rows.append({
                    'visit': visit, 'mode': mode, **scores,
                    'unchanged_before_psnr': none['unchanged_ring_psnr'],
                    'false_change_share': false_changes(test, before, as_trained, taught, ring)
                    if mode == 'learn' else 0.0,
                    'memory_mb': (memory_bytes + kept) / 1e6, **about})
                print(json.dumps(rows[-1]), flush=True)
            np.savez(frames / f'shown_{visit}.npz', none=as_trained, learnt=taught)
    return rows


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.abs(one.astype(np.float32) - other).mean(-1)


def _near(pose: CameraPose, T: np.ndarray) -> bool:
    return bool(np.linalg.norm(pose.position - T[:3, 3]) < RULES.right_metres
                and pose.forward @ T[:3, 2] > RULES.right_cosine)


def main() -> None:
    """Measure, and write the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--frames', type=Path, default=Path('frames'))
    parser.add_argument('--drive', type=int, default=130, help='frames of each drive')
    parser.add_argument('--visits', type=int, default=len(VISITS))
    parser.add_argument('--out', type=Path, default=Path('results/lives.json'))
    given = parser.parse_args()
    rows = measure(given.frames, given.visits, given.drive)
    write_bytes(given.out, (json.dumps(rows, indent=1) + '\n').encode())


if __name__ == '__main__':
    main()
