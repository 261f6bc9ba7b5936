"""
Speed of guided extrapolation, with a memory of the demo flat that is exact instead of trained.

So any size can be measured without a training: what counts for the time is how many keyframes of
how many pixels are drawn and aligned, not where their colours came from.
"""
from collections.abc import Iterator, Sequence
from dataclasses import replace
import math
from pathlib import Path
import tempfile
import time

import cv2
from neo_ros.baking.band_rendering import mesh_depth
from neo_ros.baking.glances import keyframe_glances
from neo_ros.baking.keyframes import BakingRules, keyframe_size
from neo_ros.field.panorama import view_band
from neo_ros.flat.demo_flat import build_demo_flat, DemoFlat
from neo_ros.geometry import Band, CameraPose, Intrinsics, ViewExpansion
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.landmarks import Landmarks, LandmarkThresholds, magnification
from neo_ros.memory.local_features import find_features
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.runtime import FovExtrapolator, read_model_card
from neo_ros.runtime.model_card import MemoryFile, write_model_card
from neo_ros.speed.images import CAST, cast_view, PAPER_VIEW, walk_at_30_hz
from neo_ros.speed.model import write_stand_in_model
from neo_ros.speed.record import Effort, Record, time_calls
from neo_ros.speed.runtime import size_name
import numpy as np

SMALL_VIEW = ViewExpansion.to_size(Intrinsics.from_hfov(128, 128, np.pi / 2), 256, 256)
KEYFRAME_EVERY = 0.5  # metres: no place of the walk is farther than 0.3 from a keyframe
SIDES = 8             # pinhole views that a panorama is put together from


def measure_guided(effort: Effort, views: Sequence[ViewExpansion] = (SMALL_VIEW, PAPER_VIEW),
                   ) -> Iterator[Record]:
    """Time `expand` with a memory: for a camera that is followed, and one that is found anew."""
    poses = walk_at_30_hz(effort.frames)
    for view in views:
        name = size_name(view)
        with tempfile.TemporaryDirectory() as folder:
            extrapolator = FovExtrapolator.load(write_guided_stand_in(Path(folder), view, poses))
        images = [cast_view(view.source, pose)[0] for pose in poses]
        yield Record.of('guided', f'{name}, followed', *_follow(extrapolator, images))

        def find() -> None:
            extrapolator.reset()
            extrapolator.expand(images[-1])

        yield Record.of('guided', f'{name}, found anew', time_calls(find, effort.seconds))


def write_guided_stand_in(folder: Path, view: ViewExpansion, poses: Sequence[CameraPose]) -> Path:
    """
    Write a model with random weights and an exact memory of the demo flat around level poses.

    Returns the model's path. Needs the onnx package.
    """
    flat = build_demo_flat()
    band = view_band(view.target, poses[0].T_world_cam[None, :3, :3], (-np.pi, 2 * np.pi))
    keyframes: list[Keyframe] = []
    for pose in poses:
        if all(np.linalg.norm(keyframe.position - pose.position) > KEYFRAME_EVERY
               for keyframe in keyframes):
            keyframes.append(exact_keyframe(flat, pose.position, band, view.target.fx))
    headings = [level_pose(np.zeros(3), yaw).T_world_cam[:3, :3]
                for yaw in np.arange(24) * np.pi / 12]
    looks = [level_pose(keyframe.position, 2 * math.pi * number / SIDES)
             for keyframe in keyframes for number in range(SIDES)]
    memory = SceneMemory.from_keyframes(
        keyframes, band, keyframe_glances(keyframes, band, view.source, headings))
    memory.landmarks = exact_landmarks(view.source, looks)
    model = write_stand_in_model(folder / 'stand_in.onnx', view)
    file = MemoryFile(file='stand_in.memory', sha256=memory.write(folder / 'stand_in.memory'))
    write_model_card(model, replace(
        read_model_card(model), memory=file, scene_id='demo_flat'))
    return model


def exact_keyframe(flat: DemoFlat, position: np.ndarray, band: Band, focal: float) -> Keyframe:
    """Cast the panorama that a perfect field would give, of the size that `neo train` takes."""
    height, width, finer = keyframe_size(band, focal)
    rays = band.rays(height * finer, width * finer)
    texture = np.zeros(rays.shape, np.uint8)
    depth = np.zeros(rays.shape[:2], np.float32)
    # A little wider than its share of the circle, and as high as the band.
    half = math.tan(math.pi / SIDES) * 1.02
    rise = math.tan(max(abs(band.top), abs(band.bottom))) * 1.02
    scale = min(finer * height / (band.top - band.bottom), CAST)
    side = Intrinsics(math.ceil(2 * half * scale), math.ceil(2 * rise * scale), scale, scale,
                      half * scale, rise * scale)
    for number in range(SIDES):
        pose = level_pose(position, 2 * math.pi * number / SIDES)
        image, z = flat.render(side, pose)
        local = rays @ pose.T_world_cam[:3, :3].astype(np.float32)
        ahead = np.maximum(local[..., 2], 1e-6)
        mine = np.abs(local[..., 0]) <= half * local[..., 2]
        columns = (local[..., 0] / ahead + half) * scale - 0.5
        rows = (local[..., 1] / ahead + rise) * scale - 0.5
        texture[mine] = cv2.remap(image, columns, rows, cv2.INTER_LINEAR)[mine]
        depth[mine] = (cv2.remap(z, columns, rows, cv2.INTER_NEAREST) / ahead)[mine]
    return Keyframe(position, mesh_depth(depth, finer, BakingRules.one_surface), texture)


def exact_landmarks(camera: Intrinsics, poses: Sequence[CameraPose]) -> Landmarks | None:
    """Take the features of views for landmarks, as if several photos had shown each."""
    points, descriptors = [], []
    to_rays = np.linalg.inv(camera.matrix)
    for pose in poses:
        image, z = cast_view(camera, pose)
        features = find_features(image, magnification(camera))
        columns, rows = features.points.astype(int).T
        rays = np.column_stack([features.points, np.ones(len(rows))]) @ to_rays.T
        points.append(z[rows, columns, None] * rays @ pose.T_world_cam[:3, :3].T + pose.position)
        descriptors.append(features.descriptors)
    every = np.arange(sum(map(len, points)))
    return Landmarks.from_observations(
        np.concatenate(points), np.tile(every, LandmarkThresholds.least_photos),
        np.tile(np.concatenate(descriptors), (LandmarkThresholds.least_photos, 1)))


def _follow(extrapolator: FovExtrapolator, images: Sequence[np.ndarray]
            ) -> tuple[list[float], dict[str, float]]:
    """Return the milliseconds of every image but the first, and the share that was guided."""
    extrapolator.expand(images[0])
    durations, guided = [], []
    for image in images[1:]:
        started = time.perf_counter()
        guided.append(extrapolator.expand(image).guided)
        durations.append(1e3 * (time.perf_counter() - started))
    return durations, {'guided': float(np.mean(guided))}


def level_pose(position: np.ndarray, yaw: float) -> CameraPose:
    """Return the pose of a level camera at (3,) metres, yaw in radians."""
    x, y, z = position.tolist()
    return CameraPose.from_planar(x, y, z, yaw)
