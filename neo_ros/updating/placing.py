"""
Poses for images that the memory does not know: structure from motion that begins with known ones.

Photos of the same drive whose poses the memory gave hold the world in place: its frame, its
scale. What they show is triangulated; images that show it, too, are placed; and so on (pycolmap).
"""
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
import tempfile
from typing import Any

from neo_ros.baking.feature_database import (
    of_known_poses, pinhole_lens, points_of, write_database)
from neo_ros.baking.photo_bank import likeness_of
from neo_ros.baking.sparse_model import epipolar_distance, SparseModel
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine.colmap import load_pycolmap
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.landmarks import Landmarks, magnification, WORKED_WIDTH
from neo_ros.memory.local_features import Features, find_features, match_features
from neo_ros.updating.driven_photos import Drive, LostImage
import numpy as np


@dataclass(frozen=True)
class PlacingRules:
    """Which images are compared, and when a pose counts; pixels of an image of WORKED_WIDTH."""

    # Each is compared with so many that follow it in the bag, and with so many that look like it.
    neighbours: int = 10
    alike: int = 10
    # Of the photos with poses those count that come so near in the bag, or look like a lost one.
    around: int = 40
    ratio: float = 0.85
    most_pixels: float = 1.0
    least_matches: int = 15
    # An image is placed where it shows so many points; those that known photos show, too, are
    # what holds all of it: so many.
    least_points: int = 25
    least_ties: int = 25


@dataclass(frozen=True, eq=False)
class Placed:
    """
    Images that were placed in the scene, in its frame and scale, and their poses.

    Those of which the memory told the pose come first. beside: which photos of the drive show what
    they show. landmarks: the points that three or more show; points: that the photos beside and
    the images show, in this order; None where there are none.
    """

    images: list[LostImage]
    poses: list[CameraPose]
    beside: list[int]
    landmarks: Landmarks | None
    points: SparseModel | None

    @property
    def elsewhere(self) -> int:
        """How many of them, the last ones, the memory does not know."""
        return sum(one.pose is None for one in self.images)


NOTHING = Placed([], [], [], None, None)


def place_lost(drive: Drive, source: Intrinsics, progress: Progress = no_progress,
               rules: PlacingRules = PlacingRules()) -> Placed:
    """Place what can be tied in well of a drive's lost images; source: their camera."""
    lost = sorted(drive.lost, key=lambda one: one.pose is None)
    if all(one.pose for one in lost) or find_spec('pycolmap') is None:
        return NOTHING
    near = _near_lost(drive, rules)
    shots = [*(LostImage(drive.images[index], drive.numbers[index], drive.poses[index])
               for index in near), *lost]
    camera = source.scaled(WORKED_WIDTH / source.width)
    features = [_features(one.image, source, camera) for one in shots]
    if max(len(one.points) for one in features) < rules.least_matches:
        return NOTHING
    poses = [one.pose for one in shots if one.pose is not None]
    pairs = _pairs(features, [one.number for one in shots], rules)
    with tempfile.TemporaryDirectory() as folder:
        model = _map(features, poses, pairs, camera, Path(folder), progress, rules)
    progress(len(pairs) + 1, len(pairs) + 1)
    return NOTHING if model is None else _well_tied(near, shots, model, features, rules)


def _features(image: np.ndarray, source: Intrinsics, camera: Intrinsics) -> Features:
    found = find_features(image, magnification(source))
    return Features(found.points * (camera.width / source.width), found.descriptors)


def _near_lost(drive: Drive, rules: PlacingRules) -> list[int]:
    """Return the photos of a drive that come near a lost image, in the order of the bag."""
    lost = np.array([one.number for one in drive.lost if one.pose is None])
    order = np.sort(np.concatenate([lost, np.array(drive.numbers, int)]))
    place = {int(number): at for at, number in enumerate(order)}
    at_lost = np.array([place[int(number)] for number in lost])
    return [index for index, number in enumerate(drive.numbers)
            if np.abs(at_lost - place[number]).min() <= rules.around]


def _pairs(features: Sequence[Features], numbers: Sequence[int], rules: PlacingRules
           ) -> list[tuple[int, int]]:
    """Return which images to compare: neighbours in the bag, and those that look alike."""
    order = np.argsort(numbers, kind='stable')
    pairs = {(int(order[at]), int(order[at + step])) for step in range(1, rules.neighbours + 1)
             for at in range(len(order) - step)}
    likeness = likeness_of(features)
    np.fill_diagonal(likeness, -1)
    for index, row in enumerate(np.argsort(-likeness, axis=1, kind='stable')):
        pairs.update((index, int(other)) for other in row[:rules.alike] if other != index)
    return sorted({(min(pair), max(pair)) for pair in pairs})


def _map(features: Sequence[Features], poses: Sequence[CameraPose],
         pairs: Sequence[tuple[int, int]], camera: Intrinsics, folder: Path, progress: Progress,
         rules: PlacingRules) -> Any | None:
    """Return a model of all that can be placed; the first have these poses, and keep them."""
    pycolmap = load_pycolmap()
    pycolmap.logging.minloglevel = int(pycolmap.logging.FATAL)
    known = write_database(
        folder / 'database.db', camera, features,
        np.array([pose.inverse() for pose in poses]).reshape(-1, 4, 4),
        _verified(features, poses, pairs, camera, progress, rules))
    options = pycolmap.IncrementalPipelineOptions()
    options.random_seed, options.num_threads = 0, 1  # Threads would add in another order.
    options.fix_existing_frames, options.multiple_models = True, False
    options.extract_colors = False
    options.load_all_images = True  # A known one that matches no other is looked up, too.
    options.structure_less_registration_fallback = False
    options.ba_refine_focal_length = options.ba_refine_extra_params = False
    options.constant_cameras = {1}
    options.min_model_size = 2
    options.mapper.abs_pose_max_error = 2 * rules.most_pixels
    options.mapper.abs_pose_min_num_inliers = rules.least_matches
    options.mapper.abs_pose_refine_focal_length = False
    options.mapper.abs_pose_refine_extra_params = False
    options.mapper.filter_max_reproj_error = rules.most_pixels
    options.triangulation.merge_max_reproj_error = rules.most_pixels
    options.triangulation.complete_max_reproj_error = rules.most_pixels
    known = pycolmap.triangulate_points(known, folder / 'database.db', folder, folder,
                                        options=options)
    if not known.num_points3D():
        return None
    (folder / 'known').mkdir()
    (folder / 'all').mkdir()
    known.write(folder / 'known')
    models = pycolmap.incremental_mapping(folder / 'database.db', folder, folder / 'all', options,
                                          folder / 'known')
    return max(models.values(), key=lambda found: found.num_reg_images(), default=None)


def _verified(features: Sequence[Features], poses: Sequence[CameraPose],
              pairs: Sequence[tuple[int, int]], camera: Intrinsics, progress: Progress,
              rules: PlacingRules) -> Iterator[tuple[int, int, Any]]:
    """Yield pairs of images, and the matches that two views allow: by their poses, if known."""
    pycolmap = load_pycolmap()
    lens, options = pinhole_lens(camera), pycolmap.TwoViewGeometryOptions()
    options.ransac.max_error, options.ransac.random_seed = rules.most_pixels, 0
    options.min_num_inliers = rules.least_matches
    for done, (i, j) in enumerate(pairs, 1):
        a, b = features[i], features[j]
        matches = match_features(a.descriptors, b.descriptors, rules.ratio)
        if len(matches) >= rules.least_matches:
            if max(i, j) < len(poses):
                geometry = of_known_poses(_allowed(matches, a, b, poses[i], poses[j], camera,
                                                   rules))
            else:
                geometry = pycolmap.estimate_calibrated_two_view_geometry(
                    lens, a.points.astype(float), lens, b.points.astype(float),
                    matches.astype(np.uint32), options)
            if len(geometry.inlier_matches) >= rules.least_matches:
                yield i, j, geometry
        progress(done, len(pairs) + 1)


def _allowed(matches: np.ndarray, a: Features, b: Features, pose_a: CameraPose,
             pose_b: CameraPose, camera: Intrinsics, rules: PlacingRules) -> np.ndarray:
    """Return the matches (M, 2) that known poses allow."""
    if np.linalg.norm(pose_a.position - pose_b.position) <= 1e-3:
        return matches[:0]  # Two from one place have no epipolar line.
    off = epipolar_distance(camera, pose_b.inverse() @ pose_a.T_world_cam,
                            a.points[matches[:, 0]], b.points[matches[:, 1]])
    return matches[off < rules.most_pixels]


def _well_tied(near: Sequence[int], shots: Sequence[LostImage], model: Any,
               features: Sequence[Features], rules: PlacingRules) -> Placed:
    """
    Leave out images that show too few points, and all where too few points tie them in.

    The first shots are the photos `near` of the drive, then come lost images, those of which the
    memory told the pose first.
    """
    shown = [np.zeros(0, np.int64)] * len(shots)
    poses = [one.pose for one in shots]
    for number, image in model.images.items():
        if image.has_pose:
            index = number - 1
            shown[index] = np.array([point.point3D_id for point in image.points2D
                                     if point.has_point3D()], np.int64)
            poses[index] = poses[index] or CameraPose.nearest(np.linalg.inv(
                np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])))
    many = [len(one) >= rules.least_points for one in shown]
    before, after = (np.unique(np.concatenate([np.zeros(0, np.int64), *(
        points for points, shot, enough in zip(shown, shots, many)
        if enough and (shot.pose is None) == lost)])) for lost in (False, True))
    if len(np.intersect1d(before, after)) < rules.least_ties:
        return NOTHING
    beside = [index for index, points in enumerate(shown[:len(near)])
              if len(np.intersect1d(points, after)) >= rules.least_points]
    tied = {index: pose for index, pose in enumerate(poses)
            if index >= len(near) and many[index] and pose is not None}
    points, point_of = points_of(model, features)
    per_shot = np.split(point_of, np.cumsum([len(one.points) for one in features])[:-1])
    return Placed([shots[index] for index in tied], list(tied.values()),
                  [near[index] for index in beside],
                  Landmarks.from_observations(points, point_of, np.concatenate(
                      [one.descriptors for one in features])),
                  SparseModel(points, [per_shot[index] for index in (*beside, *tied)]))
