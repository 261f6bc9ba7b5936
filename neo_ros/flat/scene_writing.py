"""Write the flat or a building as a scene folder: photos, wide test walks, the floor map."""
from collections.abc import Mapping, Sequence
import hashlib
import itertools
import json
import os
from pathlib import Path
from typing import NamedTuple

import cv2
from neo_ros.errors import SceneError
from neo_ros.flat.building import build_building, Building, open_building
from neo_ros.flat.building_plan import BuildingPlan
from neo_ros.flat.building_routes import door_walks, mapping_poses
from neo_ros.flat.demo_flat import build_demo_flat, DemoFlat, sample_training_poses, walking_paths
from neo_ros.flat.depth_sensor import DepthSensor
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.evenly import evenly
from neo_ros.machine.files import write_bytes
from neo_ros.machine.processes import map_in_processes
from neo_ros.machine.progress import no_progress, of_stage, Progress, StageProgress
from neo_ros.pictures.depth import to_millimetres, write_depth
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import DEMO_NOTE, floor_file
from neo_ros.scenes.transforms_json import write_transforms
from neo_ros.scenes.walkable import write_walkable
import numpy as np

# A building by its plan and the file with its light, or the flat.
Site = tuple[BuildingPlan, Path] | None
BUILDING_LIGHT = 'building_light.npz'


class View(NamedTuple):
    """A view to render, and where what a depth camera reads there goes, if anywhere."""

    path: Path
    camera: Intrinsics
    T_world_cam: np.ndarray
    site: Site
    depth_path: Path | None = None
    noise_seed: tuple[int, ...] = ()  # of the depth camera

    @property
    def is_there(self) -> bool:
        """Whether a run before has written it."""
        return self.path.exists() and (self.depth_path is None or self.depth_path.exists())


def write_demo_scene(folder: Path, *, image_size: int = 128, camera: Intrinsics | None = None,
                     n_train: int = 1000, n_paths: int = 8, frames_per_path: int = 25,
                     seed: int = 0, depth: bool = False, progress: Progress = no_progress,
                     workers: int | None = None) -> None:
    """
    Write the demo flat in the layout of the paper's 3-DoF protocol (section 4.1).

    train/*.png        image_size square, 90 degrees, or as `camera` sees; poses uniform over the
                       free floor
    test/pPATH_FRAME.png  twice that size at the same focal length (126.87 degrees), along walks
    and transforms_train.json, transforms_test.json (with `input_crop`), walkable.json; with
    `depth` depth/*.png beside the photos, as a depth camera reads it (`depth_sensor.py`).
    progress(done, total) counts images; workers are processes, all cores by default.
    A run that was broken off goes on where it stopped. Raises SceneError where the folder
    holds a demo scene of other settings or cannot be written.
    """
    flat = build_demo_flat()
    train = sample_training_poses(flat, n_train, seed)
    walks = walking_paths(flat, n_paths, frames_per_path, seed)
    poses = [pose.T_world_cam for pose in (*train, *itertools.chain(*walks))]
    _claim(folder, {**_of_camera(image_size, camera), 'n_train': n_train, 'n_paths': n_paths,
                    'frames_per_path': frames_per_path, 'seed': seed,
                    'fingerprint': fingerprint(flat, poses)})
    _write_views(folder, None, camera or square_camera(image_size), train, walks, seed, depth,
                 progress, workers)
    write_walkable(folder / 'walkable.json', flat.walkable())


def write_building_scene(folder: Path, plan: BuildingPlan, *, image_size: int = 128,
                         camera: Intrinsics | None = None, n_train: int | None = None,
                         frames_per_path: int = 25, depth: bool = False, progress: StageProgress,
                         workers: int | None = None) -> Building:
    """
    Write a building as `write_demo_scene` writes the flat; photos as a mapping robot takes them.

    Test walks cross the doors of rooms all over the building. There is a walkable map for each
    floor: walkable.json and, where there are more floors, walkable_1.json and so on.
    n_train: photos, evenly chosen of all that the robot takes, which is the default.
    """
    workers = workers or len(os.sched_getaffinity(0))
    _claim(folder, {**_of_camera(image_size, camera), 'n_train': n_train or 0,
                    'frames_per_path': frames_per_path, 'building': repr(plan)})
    light = folder / BUILDING_LIGHT
    building = build_building(plan, light, of_stage(progress, 'light'), workers)
    floors = range(plan.floors)
    train = [pose for floor in floors for pose in mapping_poses(building, floor)]
    if n_train is not None:
        if n_train > len(train):
            raise SceneError(f'photos: expected at most {len(train)}, which a mapping robot takes '
                             f'of this building, got {n_train}')
        train = [train[index] for index in evenly(len(train), n_train)]
    walks = [walk for floor in floors
             for walk in door_walks(building, floor, frames_per_path, plan.seed)]
    _write_views(folder, (plan, light), camera or square_camera(image_size), train, walks,
                 plan.seed, depth, of_stage(progress, 'images'), workers)
    for floor in floors:
        write_walkable(floor_file(folder, floor), building.walkable(floor))
    return building


def square_camera(size: int) -> Intrinsics:
    """Return the paper's camera (section 4.1): square, 90 degrees."""
    return Intrinsics.from_hfov(size, size, np.pi / 2)


def _of_camera(image_size: int, camera: Intrinsics | None) -> dict[str, int | str]:
    return {'image_size': image_size} if camera is None else {'camera': repr(camera)}


def _write_views(folder: Path, site: Site, narrow: Intrinsics, train: Sequence[CameraPose],
                 walks: Sequence[Sequence[CameraPose]], seed: int, depth: bool,
                 progress: Progress, workers: int | None) -> None:
    """Render photos and test walks that are not there yet, and list them."""
    expansion = ViewExpansion.to_size(narrow, 2 * narrow.width, 2 * narrow.height)
    test = [(f'test/p{path_id}_{index:02d}.png', pose, path_id)
            for path_id, walk in enumerate(walks) for index, pose in enumerate(walk)]
    names = [f'train/{index:04d}.png' for index in range(len(train))]
    depths = tuple(folder / 'depth' / Path(name).name for name in names) if depth else ()
    views = [View(folder / name, narrow, pose.T_world_cam, site,
                  depths[index] if depth else None, (seed, 7, index))
             for index, (name, pose) in enumerate(zip(names, train))]
    views += [View(folder / name, expansion.target, pose.T_world_cam, site)
              for name, pose, _ in test]
    missing = [view for view in views if not view.is_there]
    progress(len(views) - len(missing), len(views))
    written = map_in_processes(_render_to_file, missing,
                               workers or len(os.sched_getaffinity(0)))
    for done, _ in enumerate(written, start=1):
        progress(len(views) - len(missing) + done, len(views))
    if train:
        write_transforms(folder / 'transforms_train.json', PosedImages(
            narrow, tuple(folder / name for name in names), tuple(train), (0,) * len(train),
            depth_paths=depths))
    if test:
        paths, poses, path_ids = zip(*test)
        write_transforms(folder / 'transforms_test.json', PosedImages(
            expansion.target, tuple(folder / path for path in paths), poses, path_ids), expansion)


def open_site(site: Site) -> DemoFlat | Building:
    """Return what is looked at; a process builds it once."""
    return build_demo_flat() if site is None else open_building(*site)


def _claim(folder: Path, settings: Mapping[str, int | str]) -> None:
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
    for image in map_in_processes(_render, jobs, workers or len(os.sched_getaffinity(0))):
        images.append(image)
        progress(len(images), len(jobs))
    return images


def _render(job: tuple[Intrinsics, np.ndarray]) -> np.ndarray:
    intrinsics, T_world_cam = job
    return build_demo_flat().render(intrinsics, CameraPose(T_world_cam))[0]


def _render_to_file(view: View) -> None:
    image, depth = open_site(view.site).render(view.camera, CameraPose(view.T_world_cam))
    encoded, data = cv2.imencode('.png', image[..., ::-1])
    if not encoded:
        raise SceneError(f'{view.path}: OpenCV could not encode the image as PNG')
    write_bytes(view.path, data.tobytes())
    if view.depth_path is not None:
        read = DepthSensor().reading(depth, np.random.default_rng(view.noise_seed))
        write_depth(view.depth_path, to_millimetres(read))
