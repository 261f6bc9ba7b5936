"""Scores of a flat that changes: what changed and what did not, poses, and the rows of a file."""
from collections.abc import Iterator
from dataclasses import dataclass
import json
from pathlib import Path
from typing import Any

from neo_ros.evaluation.metrics import auroc, psnr
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import write_bytes
from neo_ros.machine.host import commit, host
from neo_ros.memory.contradiction import contradiction
from neo_ros.runtime import FovExtrapolator
import numpy as np


@dataclass(frozen=True)
class ScoreRules:
    """What counts."""

    changed: float = 25.0      # grey levels, mean of the channels: more is another thing
    least_pixels: int = 32     # of the ring that are changed, for a frame to count
    right_metres: float = 0.1  # a pose is right if it is so near
    right_cosine: float = 0.999


RULES = ScoreRules()


@dataclass(frozen=True, eq=False)
class Walks:
    """Wide images uint8 (N, H, W, 3), T (N, 4, 4), and the number (N,) of a frame's walk."""

    images: np.ndarray
    T: np.ndarray
    walk: np.ndarray


def widened(extrapolator: FovExtrapolator, walks: Walks) -> Iterator[tuple[int, Any]]:
    """Yield number and wide view of each frame; each walk begins anew."""
    for index, image in enumerate(walks.images):
        if index == 0 or walks.walk[index] != walks.walk[index - 1]:
            extrapolator.reset()
        yield index, extrapolator.expand(np.ascontiguousarray(extrapolator.expansion.crop(image)))


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


def turned_wrong(walks: Walks, before: Walks, first: list[np.ndarray], then: list[np.ndarray],
                 ring: np.ndarray) -> float:
    """Return the share of the unchanged ring that the first images show right, the others not."""
    wrong = total = 0
    for truth, old, one, other in zip(walks.images, before.images, first, then):
        same = ring & (_apart(truth, old) <= RULES.changed)
        wrong += int((same & (_apart(truth, one) <= RULES.changed)
                      & (_apart(truth, other) > RULES.changed)).sum())
        total += int(same.sum())
    return wrong / total


def rows_of(scene: str, visit: int, models: dict[str, Path], test: Walks, before: Walks,
            found: dict[str, Any], minutes: float
            ) -> tuple[list[dict[str, Any]], dict[str, list[np.ndarray]]]:
    """
    Score a model for each mode; return, and print, a row for each, and the images that it shows.

    found: light, door and people of the visit; minutes: of the update. A row's keys are a
    contract.
    """
    scored = {mode: score(model, test, before) for mode, model in models.items()}
    ring, rows = FovExtrapolator.load(models['none'], guided=False).extrapolated_mask, []
    none = scored['none'][1]
    for mode, (scores, shown) in scored.items():
        if mode != 'none':
            scores['contradiction_auroc'] = None  # What was learnt contradicts no more.
        rows.append({
            'scene': scene, 'visit': visit, 'mode': mode, **scores,
            'unchanged_before_psnr': scored['none'][0]['unchanged_ring_psnr'],
            'false_change_share': turned_wrong(test, before, none, shown, ring),
            # Edges that lie half a pixel aside turn right as often as they turn wrong.
            'mended_share': turned_wrong(test, before, shown, none, ring),
            'memory_mb': megabytes(models[mode].parent),
            'update_minutes': minutes if mode == 'update' else None, **found,
            'commit': commit(), 'host': host()})
        print(json.dumps(rows[-1]), flush=True)
    return rows, {mode: shown for mode, (_, shown) in scored.items()}


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a file; none where there is none."""
    return json.loads(path.read_text()) if path.exists() else []


def write_rows(out: Path, found: list[dict[str, Any]]) -> None:
    """Write rows into a file of rows, instead of those of the same scene, visit and mode."""
    def key(row: dict[str, Any]) -> tuple[Any, ...]:
        return row['scene'], row['visit'], row['mode']
    rows = {key(row): row for row in [*read_rows(out), *found]}
    write_bytes(out, (json.dumps(list(rows.values()), indent=1) + '\n').encode())


def megabytes(folder: Path) -> float:
    """Return the size of a memory and what was learnt beside it."""
    return sum(path.stat().st_size for path in folder.glob('*.memory*')) / 1e6


def _apart(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.abs(one.astype(np.float32) - other).mean(-1)


def _near(pose: CameraPose, T: np.ndarray) -> bool:
    return bool(np.linalg.norm(pose.position - T[:3, 3]) < RULES.right_metres
                and pose.forward @ T[:3, 2] > RULES.right_cosine)
