"""
A sparse model of the scene: points that several photos see, triangulated from their known poses.

This is B3's map (the paper uses hloc's): pycolmap triangulates the matches of RootSIFT features.
"""
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
import shutil
from typing import Any, NamedTuple
from zipfile import BadZipFile

from neo_ros.baking.feature_database import of_known_poses, points_of, write_database
from neo_ros.baking.photo_bank import PhotoBank
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.machine.colmap import load_pycolmap
from neo_ros.machine.files import whole_file
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.local_features import match_features
import numpy as np

_AT_ONCE = 500  # Photos that are compared with all others: a building has thousands.


@dataclass(frozen=True)
class MatchRules:
    """Which photos are matched, and which matches count."""

    partners: int = 15             # photos that each photo is matched with
    most_angle_deg: float = 60.0   # between the viewing directions of two photos
    epipolar_pixels: float = 1.5   # how far off its epipolar line a match may lie
    # Photos that are shrunk more than this to find features (from 640 pixels across to 192) show
    # them less exactly: the limit is 0.45 pixels of the shrunk one.
    most_shrunk: float = 0.3
    ratio: float = 0.85            # of the best to the second distance of descriptors

    def coarser(self, magnify: float) -> float:
        """Return how many times larger limits in pixels are in photos that were magnified so."""
        return max(1.0, self.most_shrunk / magnify)


class SparseModel(NamedTuple):
    """
    Points of the scene and which features show them.

    points        float64 (P, 3), world metres
    point_of      per photo int64 (features,): index into `points`, -1 = none
    """

    points: np.ndarray
    point_of: list[np.ndarray]

    @property
    def megabytes(self) -> float:
        """Size of what finding a pose needs beside the features, as it lies on the disk."""
        return (self.points.nbytes + sum(one.nbytes for one in self.point_of)) / 1e6


def read_sparse_model(bank: PhotoBank, folder: Path,
                      progress: Progress = no_progress,
                      rules: MatchRules = MatchRules()) -> SparseModel:
    """
    Triangulate the features of a bank, or read the result from `folder`.

    Raises SceneError where that gives no point, NeoError where there is no room.
    """
    if len(bank.features) < 2:
        raise SceneError('photos: expected two or more to triangulate points from, got one; '
                         'landmarks need photos that overlap')
    cache = folder / 'points.npz'
    counts = [len(one.points) for one in bank.features]
    try:
        with np.load(cache) as stored:
            points, flat = stored['points'], stored['point_of']
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        points, flat = _triangulate(bank, folder, progress, rules)
        with whole_file(cache) as partial, partial.open('wb') as file:
            np.savez(file, points=points, point_of=flat)
    if not len(points):
        raise SceneError(f'{folder}: no point could be triangulated from the photos; landmarks '
                         'need textured photos that overlap, with poses that fit them')
    if len(flat) != sum(counts):
        raise SceneError(f'{cache}: expected the points of {sum(counts)} features, got '
                         f'{len(flat)}; delete the folder to triangulate again')
    return SparseModel(points, np.split(flat, np.cumsum(counts)[:-1]))


def choose_pairs(bank: PhotoBank, rules: MatchRules = MatchRules()) -> list[tuple[int, int]]:
    """Return the pairs of photos to match: alike, looking the same way, from two places."""
    T_world_cam = bank.photos.T_world_cam
    forward, position = T_world_cam[:, :3, 2], T_world_cam[:, :3, 3]
    pairs = set[tuple[int, int]]()
    for first in range(0, len(position), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        likeness = bank.vectors[some] @ bank.vectors.T
        likeness[forward[some] @ forward.T < np.cos(np.radians(rules.most_angle_deg))] = -1
        apart = np.linalg.norm(position[some, None] - position[None], axis=2)
        likeness[apart < 1e-3] = -1  # nothing can be triangulated
        order = np.argsort(-likeness, axis=1, kind='stable')[:, :rules.partners]
        pairs.update((min(first + i, int(j)), max(first + i, int(j)))
                     for i in range(len(order)) for j in order[i] if likeness[i, j] > -1)
    return sorted(pairs)


def epipolar_distance(camera: Intrinsics, T_b_a: np.ndarray, points_a: np.ndarray,
                      points_b: np.ndarray) -> np.ndarray:
    """
    Return how far matched pixels (N, 2) of two views are off their epipolar lines (Sampson).

    T_b_a takes camera coordinates of a to those of b; the result is in pixels, (N,).
    """
    R, t = T_b_a[:3, :3], T_b_a[:3, 3]
    across = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    inverse = np.linalg.inv(camera.matrix)
    fundamental = inverse.T @ across @ R @ inverse
    a = np.c_[points_a, np.ones(len(points_a))]
    b = np.c_[points_b, np.ones(len(points_b))]
    line_b, line_a = a @ fundamental.T, b @ fundamental
    slope = (line_b[:, :2] ** 2).sum(1) + (line_a[:, :2] ** 2).sum(1)
    return np.abs((b * line_b).sum(1)) / np.sqrt(np.maximum(slope, 1e-12))


def _triangulate(bank: PhotoBank, folder: Path,
                 progress: Progress, rules: MatchRules) -> tuple[np.ndarray, np.ndarray]:
    pycolmap = load_pycolmap()
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    camera = bank.photos.intrinsics.scaled(bank.scale)
    database = folder / 'database.db'
    known = write_database(database, camera, bank.features,
                           np.linalg.inv(bank.photos.T_world_cam),
                           _verified(bank, camera, progress, rules))
    options = _options(rules.coarser(bank.magnify))
    model = pycolmap.triangulate_points(known, database, folder, folder, options=options)
    points, flat = points_of(model, bank.features)
    database.unlink()
    return points, flat


def _options(coarser: float) -> Any:
    """Return pycolmap's options; its limits in pixels are made so many times as large."""
    options = load_pycolmap().IncrementalPipelineOptions()
    options.random_seed = 0
    options.mapper.filter_max_reproj_error *= coarser
    options.triangulation.merge_max_reproj_error *= coarser
    options.triangulation.complete_max_reproj_error *= coarser
    return options


def _verified(bank: PhotoBank, camera: Intrinsics, progress: Progress, rules: MatchRules
              ) -> Iterator[tuple[int, int, Any]]:
    """Yield pairs of photos, and the matches that their poses allow."""
    T_world_cam = bank.photos.T_world_cam
    T_cam_world = np.linalg.inv(T_world_cam)
    pairs = choose_pairs(bank, rules)
    limit = rules.epipolar_pixels * rules.coarser(bank.magnify)
    for done, (i, j) in enumerate(pairs, 1):
        a, b = bank.features[i], bank.features[j]
        matches = match_features(a.descriptors, b.descriptors, rules.ratio)
        off = epipolar_distance(camera, T_cam_world[j] @ T_world_cam[i],
                                a.points[matches[:, 0]], b.points[matches[:, 1]])
        kept = matches[off < limit]
        if len(kept) >= 5:
            yield i, j, of_known_poses(kept)
        progress(done, len(pairs))
