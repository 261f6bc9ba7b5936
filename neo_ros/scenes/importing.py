"""Bring a capture into the scene format: read everything once, copy what is good."""
from pathlib import Path
import shutil
from typing import Callable

from neo_ros.errors import SceneError
from neo_ros.scenes.posed_images import PosedImages, read_rgb_image
from neo_ros.scenes.transforms_json import read_input_crop, read_transforms, write_transforms

IMAGE_FOLDER = 'images'


def import_transforms(source: Path, scene: Path,
                      progress: Callable[[int, int], None] = lambda done, total: None) -> None:
    """
    Copy a folder of transforms files (nerfstudio, instant-ngp) into a scene folder.

    transforms_train.json (or transforms.json) and transforms_test.json with their images, and
    walkable.json. Images that are there already are not copied again, so that a broken-off
    import goes on. Raises SceneError for images that cannot be read or have another size.
    """
    if not source.is_dir():
        raise SceneError(f'{source}: expected a folder with transforms_train.json or '
                         'transforms.json, or the word "demo"')
    if source.resolve() == scene.resolve():
        raise SceneError(f'{scene}: expected another folder than the source')
    names = {'transforms_train.json': 'transforms_train.json',
             'transforms.json': 'transforms_train.json',
             'transforms_test.json': 'transforms_test.json'}
    found = {name: read_transforms(source / name) for name in names if (source / name).is_file()}
    if not found.keys() & {'transforms_train.json', 'transforms.json'}:
        raise SceneError(f'{source}: expected transforms_train.json or transforms.json')
    total = sum(len(images) for images in found.values())
    done = 0
    for name, images in found.items():
        copied = []
        for path in images.image_paths:
            copied.append(_copy_image(path, source, scene, images))
            done += 1
            progress(done, total)
        kept = PosedImages(images.intrinsics, tuple(copied), images.poses, images.path_ids)
        write_transforms(scene / names[name], kept, read_input_crop(source / name))
    if (source / 'walkable.json').is_file():
        shutil.copyfile(source / 'walkable.json', scene / 'walkable.json')


def _copy_image(path: Path, source: Path, scene: Path, images: PosedImages) -> Path:
    read_rgb_image(path, images.intrinsics)
    inside = path.resolve().is_relative_to(source.resolve())
    relative = path.resolve().relative_to(source.resolve()) if inside else (
        Path(IMAGE_FOLDER) / path.name)
    target = scene / relative
    if target.exists() and target.stat().st_size == path.stat().st_size:
        return target
    partial = target.with_suffix('.partial')
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, partial)
        partial.replace(target)
    except OSError as error:
        raise SceneError(f'{target}: cannot write: {error.strerror}; '
                         'choose another scene folder') from error
    return target
