"""The photos of an updated scene: those of before, masked where out of date, and new ones."""
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
from neo_ros.baking.keyframes import Photos
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import share_file, write_bytes
from neo_ros.pictures.usable import read_usable, shrunk, write_usable
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import floor_file, Scene, stale_file
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.scenes.walkable import write_walkable
import numpy as np


def read_stale(photos: PosedImages, index: int) -> np.ndarray | None:
    """Return what updates found out of date in a photo, bool (H, W); None: nothing."""
    path, camera = stale_file(photos.image_paths[index]), photos.intrinsics
    return read_usable(path, camera.width, camera.height) if path.exists() else None


def write_more_photos(folder: Path, scene: Scene, chosen: Sequence[int], photos: Photos) -> None:
    """
    Write a scene folder that can be trained on, or updated again.

    chosen: which of the scene's photos are the first of `photos`, whose pixels count as far as
    they are usable; the others, whose numbers are higher, are new. What was usable once, and is
    not now, is noted as out of date.
    """
    train = scene.train
    assert photos.usable is not None
    old = sum(index < len(train) for index in chosen)
    camera = train.intrinsics
    size = (camera.width, camera.height)
    masks = dict(zip(chosen[:old], photos.usable))
    paths, mask_paths = [], list[Path | None]()

    def add(name: str, usable: np.ndarray) -> None:
        paths.append(folder / 'train' / name)
        mask_paths.append(None if usable.all() else folder / 'masks' / f'{paths[-1].stem}.png')
        if mask_paths[-1] is not None:
            write_usable(mask_paths[-1], usable)

    (folder / 'train').mkdir(parents=True)
    for index, path in enumerate(train.image_paths):
        usable, stale = train.read_usable(index), read_stale(train, index)
        usable = np.ones(size[::-1], bool) if usable is None else usable
        if index in masks:
            once = usable if stale is None else usable | stale
            usable = shrunk(masks[index], *size) & once
            stale = once & ~usable
        add(f'{index:06d}{path.suffix}', usable)
        share_file(path, paths[-1])
        if stale is not None and stale.any():
            write_usable(stale_file(paths[-1]), stale)
    for number, (image, usable) in enumerate(zip(photos.images[old:], photos.usable[old:]),
                                             len(train)):
        add(f'{number:06d}.png', shrunk(usable, *size))
        if image.shape[1::-1] != size:
            image = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC)
        write_bytes(paths[-1], cv2.imencode('.png', image[..., ::-1])[1].tobytes())
    new = len(photos.images) - old
    depth_paths = list[Path | None]()
    for index, depth in enumerate(train.depth_paths):
        depth_paths.append(None if depth is None else folder / 'depth' / (
            f'{index:06d}{depth.suffix}'))
        if depth is not None:
            (folder / 'depth').mkdir(exist_ok=True)
            share_file(depth, folder / 'depth' / f'{index:06d}{depth.suffix}')
    write_transforms(folder / 'transforms_train.json', replace(
        train, image_paths=tuple(paths), z_up=True,  # It was stood up.
        poses=(*train.poses, *map(CameraPose, photos.T_world_cam[old:])),
        path_ids=(*train.path_ids, *[1 + max(train.path_ids)] * new),
        depth_paths=(*depth_paths, *[None] * new) if depth_paths else (),
        mask_paths=tuple(mask_paths)))
    if scene.walkable is not None:
        for storey, floor in enumerate((scene.walkable, *scene.upper)):
            write_walkable(floor_file(folder, storey), floor)
