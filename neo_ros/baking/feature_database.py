"""Features and verified matches as pycolmap reads them, and the points that it makes of them."""
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from neo_ros.errors import NeoError
from neo_ros.geometry import Intrinsics
from neo_ros.machine.colmap import load_pycolmap
from neo_ros.memory.local_features import Features
import numpy as np


def pinhole_lens(camera: Intrinsics) -> Any:
    """Return pycolmap's camera number 1."""
    pycolmap = load_pycolmap()
    return pycolmap.Camera(model='PINHOLE', width=camera.width, height=camera.height,
                           params=[camera.fx, camera.fy, camera.cx, camera.cy], camera_id=1,
                           has_prior_focal_length=True)


def write_database(path: Path, camera: Intrinsics, features: Sequence[Features],
                   T_cam_world: np.ndarray, verified: Iterable[tuple[int, int, Any]]) -> Any:
    """
    Write the features of images, and the matches that two views allow; image i has number i + 1.

    T_cam_world (K, 4, 4): poses of the first images; verified: pairs of images, and their
    geometry. Returns a reconstruction of the images with poses. Raises NeoError where there is no
    room.
    """
    pycolmap = load_pycolmap()
    lens = pinhole_lens(camera)
    known, everything = pycolmap.Reconstruction(), pycolmap.Reconstruction()
    for one in (known, everything):
        one.add_camera_with_trivial_rig(lens)
    with _room_for(path), pycolmap.Database.open(path) as database:
        database.write_camera(lens, use_camera_id=True)
        for rig in known.rigs.values():
            database.write_rig(rig, use_rig_id=True)
        for index, found in enumerate(features):
            def image() -> Any:
                return pycolmap.Image(name=f'{index:06d}', keypoints=found.points.astype(float),
                                      camera_id=1, image_id=index + 1)

            if index < len(T_cam_world):
                known.add_image_with_trivial_frame(
                    image(), pycolmap.Rigid3d(T_cam_world[index, :3]))
            everything.add_image_with_trivial_frame(image())
            written = everything.image(index + 1)
            assert written.frame is not None
            database.write_frame(written.frame, use_frame_id=True)
            database.write_image(written, use_image_id=True)
            database.write_keypoints(index + 1, found.points)
        for i, j, geometry in verified:
            database.write_matches(i + 1, j + 1, geometry.inlier_matches)
            database.write_two_view_geometry(i + 1, j + 1, geometry)
    return known


@contextmanager
def _room_for(database: Path) -> Iterator[None]:
    """Raise NeoError where pycolmap cannot write its database: it does not say why."""
    try:
        yield
    except RuntimeError as error:
        raise NeoError(f'{database}: cannot write features and matches: {error}; make room, and '
                       'give the same command again') from error


def of_known_poses(matches: np.ndarray) -> Any:
    """Return the geometry of two views whose poses are known, and allow these matches (M, 2)."""
    pycolmap = load_pycolmap()
    geometry = pycolmap.TwoViewGeometry()
    geometry.config = pycolmap.TwoViewGeometryConfiguration.CALIBRATED
    geometry.inlier_matches = matches.astype(np.uint32)
    return geometry


def points_of(model: Any, features: Sequence[Features]) -> tuple[np.ndarray, np.ndarray]:
    """Return the points (P, 3) of a model, and which of them each feature shows, -1 = none."""
    starts = np.cumsum([0, *(len(one.points) for one in features)])
    point_of = np.full(starts[-1], -1, np.int64)
    points = np.zeros((len(model.points3D), 3))
    for index, point in enumerate(model.points3D.values()):
        points[index] = point.xyz
        for element in point.track.elements:
            point_of[starts[element.image_id - 1] + element.point2D_idx] = index
    return points, point_of
