"""Hold photos of a capture back, so that a model of it can be scored."""
from dataclasses import replace
from pathlib import Path

from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.names import natural_key
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import read_transforms, write_transforms

# Share of the photos that is held back, and how many are left out at both ends of a run: the
# neighbours of a video's frame show nearly the same. A few photos lie farther apart: of 25 one.
SHARE = 0.1
GAP = 4
GAP_SHARE = 1 / 25
# The margins of the narrow view are multiples of so many pixels, as networks want it.
CELL = 16


def hold_out_runs(scene: Path, count: int) -> tuple[PosedImages, PosedImages]:
    """
    Make `count` runs of a scene folder's photos its test frames; returns photos and test frames.

    Photos are as wide as the truth can be, so the view that is widened is the middle half of
    their columns (the paper's protocol for ScanNet). Rewrites transforms_train.json and
    transforms_test.json. Raises SceneError for captures that are too short.
    """
    photos = read_transforms(scene / 'transforms_train.json')
    # Files list photos in any order; their names count them as they were taken.
    order = sorted(range(len(photos)), key=lambda i: natural_key(str(photos.image_paths[i])))
    train, test = split_runs(photos.subset(order), count)
    # In this order: photos must never be in both.
    write_transforms(scene / 'transforms_train.json', train)
    write_transforms(scene / 'transforms_test.json', test, middle_columns(test.intrinsics))
    return train, test


def split_runs(photos: PosedImages, count: int) -> tuple[PosedImages, PosedImages]:
    """Split photos, in the order they were taken, into those that are kept and runs for tests."""
    total = len(photos)
    length = max(int(SHARE * total / count), 2)
    gap = min(max(int(GAP_SHARE * total), 1), GAP)
    if total < 2 * count * (length + 2 * gap):
        raise SceneError(
            f'--test-runs: {count} runs of {length} photos, with {gap} left out at both ends, '
            f'take more than half of the {total} photos; ask for fewer runs or record more')
    starts = [int((run + 0.5) * total / count - length / 2) for run in range(count)]
    held = {start + step: run for run, start in enumerate(starts) for step in range(length)}
    apart = {index for start in starts for index in range(start - gap, start + length + gap)}
    test = photos.subset(sorted(held))
    return (photos.subset([index for index in range(total) if index not in apart]),
            replace(test, path_ids=tuple(held[index] for index in sorted(held))))


def middle_columns(photo: Intrinsics) -> ViewExpansion:
    """Return the widening of about the middle half of a photo's columns to the photo."""
    margin = max(photo.width // 4 // CELL * CELL, 1)
    return ViewExpansion.inside(photo, margin, 0, photo.width - 2 * margin, photo.height)
