"""A room whose every view is known exactly: a box with painted walls, cast by numpy."""
import functools
from pathlib import Path
from typing import Any

from neo_ros.benchmark.small_room import cast, HEIGHT, HIGH, SOURCE
from neo_ros.geometry import Band, CameraPose, Intrinsics, ViewExpansion
from neo_ros.geometry.camera_pose import rotation_angle
from neo_ros.memory.keyframe import Keyframe
from neo_ros.memory.scene_memory import Glances, SceneMemory
from neo_ros.runtime.model_card import MemoryFile
import numpy as np
from tiny_model import write_tiny_model

AWAY = 20.0  # metres from the room to its twin
ABOVE = 3.0  # or to the one on the floor above
BAND = Band(1.1, -1.1)
EXPANSION = ViewExpansion.to_size(SOURCE, 128, 128)


def view(pose: CameraPose, camera: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Return the image, uint8 (H, W, 3), and z in metres (H, W)."""
    rays = camera.pixel_rays() @ pose.T_world_cam[:3, :3].T
    length = np.linalg.norm(rays, axis=-1)
    colour, depth = cast(pose.position, rays / length[..., None])
    return np.rint(colour).astype(np.uint8), depth / length


def keyframe(position: np.ndarray) -> Keyframe:
    """Return what a perfect field would give: mesh 80 pixels a radian, texture twice as fine."""
    height, width = int((BAND.top - BAND.bottom) * 40), int(BAND.width * 40)
    _, depth = cast(position, BAND.rays(height, width))
    colour, _ = cast(position, BAND.rays(2 * height, 2 * width))
    return Keyframe(position, depth.astype(np.float32), np.rint(colour).astype(np.uint8))


def box_memory() -> SceneMemory:
    """Remember the room by keyframes a metre apart."""
    positions = [np.array([x, y, HEIGHT]) for x in (1.2, 2.2, 3.2) for y in (1.2, 2.2)]
    small = SOURCE.scaled(16 / SOURCE.width)
    poses = [CameraPose.from_planar(x, y, z, yaw)
             for x, y, z in positions for yaw in np.arange(16) * np.pi / 8]
    glances = Glances(
        np.stack([view(pose, small)[0].mean(-1).astype(np.uint8) for pose in poses]),
        np.stack([pose.T_world_cam for pose in poses]))
    return SceneMemory.from_keyframes([keyframe(position) for position in positions], BAND,
                                      glances)


def planar(x: float, y: float, yaw_deg: float) -> CameraPose:
    """Return a level pose at the room's camera height."""
    return CameraPose.from_planar(x, y, HEIGHT, np.radians(yaw_deg))


def apart(one: CameraPose, other: CameraPose) -> tuple[float, float]:
    """Return how far two poses are apart: metres and degrees."""
    turn = one.T_world_cam[:3, :3].T @ other.T_world_cam[:3, :3]
    return (float(np.linalg.norm(one.position - other.position)),
            float(np.degrees(rotation_angle(turn))))


def twin_memory(own_picture: bool, way: tuple[float, float, float] = (AWAY, 0, 0)
                ) -> SceneMemory:
    """
    Remember the room twice, the second one so far away, metres (x, y, z).

    own_picture: the second one has a dark picture on the wall that the first one's x ends at.
    """
    first, positions = box_memory(), box_memory().positions
    keyframes = [keyframe(position) for position in positions]
    second = [Keyframe(one.position + way, one.depth,
                       _with_picture(one) if own_picture else one.texture) for one in keyframes]
    moved = first.glances.T_world_cam.copy()
    moved[:, :3, 3] += way
    glances = Glances(np.concatenate([first.glances.pictures] * 2),
                      np.concatenate([first.glances.T_world_cam, moved]))
    return SceneMemory.from_keyframes([*keyframes, *second], BAND, glances)


def _with_picture(one: Keyframe) -> np.ndarray:
    rays = BAND.rays(*one.texture.shape[:2])
    _, depth = cast(one.position, rays)
    return paint_picture(one.texture, one.position + rays * depth[..., None])


def paint_picture(colour: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    """Hang the picture: return colours (..., 3) of points (..., 3) of the room with it."""
    there = (np.abs(xyz[..., 0] - HIGH[0]) < 1e-3) & (np.abs(xyz[..., 1] - 2) < 0.5) & (
        np.abs(xyz[..., 2] - 1.4) < 0.4)
    return np.where(there[..., None], 255 - colour, colour)


def view_with_picture(pose: CameraPose) -> np.ndarray:
    """Return the image, uint8 (h, w, 3), that the camera takes of the room with the picture."""
    rays = SOURCE.pixel_rays() @ pose.T_world_cam[:3, :3].T
    image, z = view(pose, SOURCE)
    return paint_picture(image, pose.position + rays * z[..., None])


def box_walk(count: int) -> list[CameraPose]:
    """Return poses of a walk through the room."""
    return [planar(1.4 + 0.1 * step, 1.5, 20 + 3 * step) for step in range(count)]


@functools.cache
def _written_memory() -> SceneMemory:
    """Return the memory that models have beside them: nobody else has it, nobody changes it."""
    return box_memory()


def write_box_model(folder: Path, **card_overrides: Any) -> Path:
    """Write a small model that has the box room's memory beside it."""
    sha256 = _written_memory().write(folder / 'box.memory')
    return write_tiny_model(folder / 'box.onnx', EXPANSION, **card_overrides,
                            memory=MemoryFile(file='box.memory', sha256=sha256))


def write_model_without_floor(folder: Path) -> Path:
    """Write a small model whose memory shows the upper half of the box room, from one place."""
    frame = keyframe(np.array([2.2, 1.2, HEIGHT]))
    above = frame.depth.copy()
    above[len(above) // 2:] = 0
    sha256 = SceneMemory.from_keyframes(
        [Keyframe(frame.position, above, frame.texture)], BAND, _written_memory().glances
        ).write(folder / 'above.memory')
    return write_tiny_model(folder / 'above.onnx', EXPANSION,
                            memory=MemoryFile(file='above.memory', sha256=sha256))
