"""Write the demo flat as a scene folder: training photos, wide test walks, the floor map."""
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
import hashlib
import json
import multiprocessing
import os
from pathlib import Path
from typing import Any, TypeVar

import cv2
from neo_ros.errors import SceneError
from neo_ros.flat.demo_flat import build_demo_flat, DemoFlat, sample_training_poses, walking_paths
from neo_ros.flat.depth_sensor import DepthSensor
from neo_ros.flat.raycast import camera_directions, cast_camera
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.pictures.depth import to_millimetres, write_depth
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import DEMO_NOTE
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.scenes.walkable import write_walkable
import numpy as np

Job = tuple[str, Intrinsics, np.ndarray]
Result = TypeVar('Result')


def write_demo_scene(folder: Path, *, image_size: int = 128, n_train: int = 1000,
                     n_paths: int = 8, frames_per_path: int = 25, seed: int = 0,
                     depth: bool = False, progress: Progress = no_progress,
                     workers: int | None = None) -> None:
    """
    Write the demo flat in the layout of the paper's 3-DoF protocol (section 4.1).

    train/*.png        image_size square, 90 degrees, poses uniform over the free floor
    test/pPATH_FRAME.png  twice that size at the same focal length, 126.87 degrees, along walks
    and transforms_train.json, transforms_test.json (with `input_crop`), walkable.json; with
    `depth` depth/*.png beside the photos, as a depth camera reads it (`depth_sensor.py`).
    progress(done, total) counts images; workers are processes, all cores by default.
    A run that was broken off goes on where it stopped. Raises SceneError where the folder
    holds a demo scene of other settings or cannot be written.
    """
    folder = Path(folder)
    narrow = Intrinsics.from_hfov(image_size, image_size, np.pi / 2)
    expansion = ViewExpansion.to_size(narrow, 2 * image_size, 2 * image_size)
    flat = build_demo_flat()
    train = sample_training_poses(flat, n_train, seed)
    walks = walking_paths(flat, n_paths, frames_per_path, seed)
    test = [(f'test/p{path_id}_{index:02d}.png', pose, path_id)
            for path_id, walk in enumerate(walks) for index, pose in enumerate(walk)]
    names = [f'train/{index:04d}.png' for index in range(n_train)]
    jobs: list[Job] = [(str(folder / name), narrow, pose.T_world_cam)
                       for name, pose in zip(names, train)]
    jobs += [(str(folder / name), expansion.target, pose.T_world_cam) for name, pose, _ in test]
    _claim(folder, {'image_size': image_size, 'n_train': n_train, 'n_paths': n_paths,
                    'frames_per_path': frames_per_path, 'seed': seed,
                    'fingerprint': fingerprint(flat, [pose for _, _, pose in jobs])})
    missing = [job for job in jobs if not os.path.exists(job[0])]
    progress(len(jobs) - len(missing), len(jobs))
    written = _map(_render_to_file, missing, workers or len(os.sched_getaffinity(0)))
    for done, _ in enumerate(written, start=1):
        progress(len(jobs) - len(missing) + done, len(jobs))
    depths = _write_depths(folder, names, narrow, train, seed) if depth else ()
    write_walkable(folder / 'walkable.json', flat.walkable())
    if train:
        write_transforms(folder / 'transforms_train.json', PosedImages(
            narrow, tuple(folder / name for name in names), tuple(train), (0,) * n_train,
            depth_paths=depths))
    if test:
        paths, poses, path_ids = zip(*test)
        write_transforms(folder / 'transforms_test.json', PosedImages(
            expansion.target, tuple(folder / path for path in paths), poses, path_ids), expansion)


def _write_depths(folder: Path, names: Sequence[str], camera: Intrinsics,
                  poses: Sequence[CameraPose], seed: int) -> tuple[Path, ...]:
    """Write what a depth camera reads at each pose, where it is not there yet."""
    sensor, solids = DepthSensor(), build_demo_flat().solids
    paths: list[Path] = []
    for index, (name, pose) in enumerate(zip(names, poses)):
        path = folder / 'depth' / Path(name).name
        if not path.exists():
            true = cast_camera(solids, camera, pose, camera_directions(camera, pose, 1)).distance
            read = sensor.reading(true, np.random.default_rng([seed, 7, index]))
            write_depth(path, to_millimetres(read))
        paths.append(path)
    return tuple(paths)


def _claim(folder: Path, settings: dict[str, int | str]) -> None:
    """Make the folders and note what they are for, so that two scenes are never mixed."""
    note = folder / DEMO_NOTE
    if not note.exists() and (folder / 'transforms_train.json').exists():
        raise SceneError(f'{folder}: expected an empty folder or a demo scene, it holds another '
                         'scene; choose another folder')
    try:
        for part in ('train', 'test'):
            (folder / part).mkdir(parents=True, exist_ok=True)
        if not note.exists():
            note.write_text(json.dumps(settings))
        found = json.loads(note.read_text())
    except (OSError, ValueError) as error:
        raise SceneError(f'{folder}: cannot write a demo scene here: {error}') from error
    if found != settings:
        raise SceneError(f'{folder}: expected an empty folder or a demo scene of {settings}, '
                         f'got one of {found}; choose another folder, or delete this one: an '
                         'older neo_ros may have rendered it')


def fingerprint(flat: DemoFlat, poses: Sequence[np.ndarray]) -> str:
    """
    Hash what images at poses (4, 4) show, so that those of an older flat are not taken for done.

    To a micrometre: sines of another processor may differ in the last bit.
    """
    solids = flat.solids
    sha = hashlib.sha256(repr(solids.materials).encode())
    for array in (solids.kind, solids.centre, solids.half, solids.yaw, flat.light.values, *poses):
        sha.update((np.round(np.asarray(array, np.float64), 6) + 0.0).tobytes())
    return sha.hexdigest()[:16]


def render_demo_views(intrinsics: Intrinsics, poses: Sequence[CameraPose],
                      progress: Progress = no_progress,
                      workers: int | None = None) -> list[np.ndarray]:
    """Render RGB uint8 (H, W, 3) views of the demo flat, one per pose."""
    jobs = [(intrinsics, pose.T_world_cam) for pose in poses]
    images = []
    for image in _map(_render, jobs, workers or len(os.sched_getaffinity(0))):
        images.append(image)
        progress(len(images), len(jobs))
    return images


def _map(function: Callable[[Any], Result], jobs: Sequence[Any],
         workers: int) -> Iterator[Result]:
    """Yield the results in order, from several processes if that pays."""
    if workers == 1 or len(jobs) < 8:
        yield from map(function, jobs)
        return
    # spawn: forking a process that has threads (torch, ROS) may hang the child.
    with ProcessPoolExecutor(workers, multiprocessing.get_context('spawn')) as pool:
        yield from pool.map(function, jobs, chunksize=4)


def _render(job: tuple[Intrinsics, np.ndarray]) -> np.ndarray:
    intrinsics, T_world_cam = job
    return build_demo_flat().render(intrinsics, CameraPose(T_world_cam))[0]


def _render_to_file(job: Job) -> None:
    path, intrinsics, T_world_cam = job
    image = _render((intrinsics, T_world_cam))
    encoded, data = cv2.imencode('.png', image[..., ::-1])
    if not encoded:
        raise SceneError(f'{path}: OpenCV could not encode the image as PNG')
    partial = f'{path}.{os.getpid()}.partial'
    try:
        Path(partial).write_bytes(data.tobytes())
        os.replace(partial, path)
    except OSError as error:
        raise SceneError(f'{path}: cannot write: {error}') from error
