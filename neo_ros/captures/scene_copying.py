"""Bring a capture into the scene format: read everything once, copy what is good."""
from dataclasses import replace
import filecmp
from pathlib import Path
import shutil

from neo_ros.captures.capture import scene_name
from neo_ros.captures.scene_writing import check_near_origin, check_own, NOTE_FILE
from neo_ros.errors import SceneError
from neo_ros.machine.files import whole_file
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.depth import read_depth
from neo_ros.pictures.usable import read_usable
from neo_ros.scenes.posed_images import PosedImages, read_rgb_image
from neo_ros.scenes.scene import (
    clear_earlier_import, floor_file, stale_file, upper_floors)
from neo_ros.scenes.transforms_json import read_input_crop, read_transforms, write_transforms

# The transforms files of a folder, and what they are called in a scene.
SCENE_NAMES = {'transforms_train.json': 'transforms_train.json',
               'transforms.json': 'transforms_train.json',
               'transforms_test.json': 'transforms_test.json'}


def import_transforms(source: Path, scene: Path,
                      progress: Progress = no_progress) -> None:
    """
    Copy a folder of transforms files (nerfstudio, instant-ngp) into a scene folder.

    transforms_train.json (or transforms.json) and transforms_test.json with their images, their
    depth and masks, what updates found out of date in them, and walkable.json. Files that are
    there already are not copied again, so that a broken-off import goes on; files from beside the
    folder ('../photos/1.png') come to 'beside/'. Test frames and floor map of an earlier import
    are taken away. Raises SceneError for images that cannot be read or have another size, for
    depth and masks that cannot be read, and for cameras far from the origin.
    """
    if not source.is_dir():
        raise SceneError(f'{source}: expected a folder with transforms_train.json or '
                         'transforms.json, or the word "demo"')
    if source.resolve() == scene.resolve():
        raise SceneError(f'{scene}: expected another folder than the source')
    found = _read_present(source)
    for images in found.values():
        check_near_origin(images.image_paths, images.poses)
    every = [path for images in found.values() for path in images.image_paths]
    check_own(scene, (scene_name(path, source) for path in every
                      if not _same(path, scene / scene_name(path, source))))
    total = len(every)
    done = 0
    copied: dict[str, PosedImages] = {}
    for name, images in found.items():
        paths = []
        for path in images.image_paths:
            paths.append(_copy_image(path, source, scene, images))
            done += 1
            progress(done, total)
        copied[name] = replace(images, image_paths=tuple(paths), depth_paths=tuple(
            None if path is None else _copy_depth(path, source, scene, images)
            for path in images.depth_paths), mask_paths=tuple(
            None if path is None else _copy_mask(path, source, scene, images)
            for path in images.mask_paths))
    floor = floor_file(source, 0)
    clear_earlier_import(scene, has_floor=floor.is_file())
    if floor.is_file():
        for one in (floor, *upper_floors(source)):
            shutil.copyfile(one, scene / one.name)
    for name, images in found.items():
        for photo, copy in zip(images.image_paths, copied[name].image_paths):
            if stale_file(photo).is_file() and source in stale_file(photo).parents:
                stale_file(copy).parent.mkdir(exist_ok=True)
                shutil.copyfile(stale_file(photo), stale_file(copy))
    for name, images in copied.items():
        write_transforms(scene / SCENE_NAMES[name], images, read_input_crop(source / name))
    (scene / NOTE_FILE).unlink(missing_ok=True)


def _read_present(source: Path) -> dict[str, PosedImages]:
    """Read the transforms files of a folder that count, by their names."""
    present = [name for name in SCENE_NAMES if (source / name).is_file()]
    if present[:2] == ['transforms_train.json', 'transforms.json']:
        present.remove('transforms.json')  # It lists all images, those of the test too.
    if not {'transforms_train.json', 'transforms.json'} & set(present):
        raise SceneError(f'{source}: expected transforms_train.json or transforms.json')
    return {name: read_transforms(source / name) for name in present}


def _same(path: Path, target: Path) -> bool:
    return target.exists() and filecmp.cmp(path, target, shallow=False)


def _copy_image(path: Path, source: Path, scene: Path, images: PosedImages) -> Path:
    read_rgb_image(path, images.intrinsics)
    return _copy(path, source, scene)


def _copy_depth(path: Path, source: Path, scene: Path, images: PosedImages) -> Path:
    read_depth(path, images.intrinsics.width, images.intrinsics.height)
    return _copy(path, source, scene)


def _copy_mask(path: Path, source: Path, scene: Path, images: PosedImages) -> Path:
    read_usable(path, images.intrinsics.width, images.intrinsics.height)
    return _copy(path, source, scene)


def _copy(path: Path, source: Path, scene: Path) -> Path:
    target = scene / scene_name(path, source)
    try:
        if _same(path, target):
            return target
        target.parent.mkdir(parents=True, exist_ok=True)
        # The poses and the note of an earlier import must never meet other pictures.
        clear_earlier_import(scene, has_floor=floor_file(source, 0).is_file())
        (scene / 'transforms_train.json').unlink(missing_ok=True)
        (scene / NOTE_FILE).write_text('{}')
        with whole_file(target) as partial:
            shutil.copyfile(path, partial)
    except OSError as error:
        raise SceneError(f'{target}: cannot write: {error.strerror}; '
                         'choose another scene folder') from error
    return target
