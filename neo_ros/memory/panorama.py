"""The whole sphere around a camera as far as the memory knows it, with the live image in it."""
from functools import lru_cache
import math
from typing import NamedTuple

import cv2
from neo_ros.geometry import Band, CameraPose, Intrinsics, ViewExpansion
from neo_ros.memory.rendering import MemoryRenderer
import numpy as np

SEEN, REMEMBERED, UNKNOWN = 255, 128, 0
SPHERE = Band(math.pi / 2, -math.pi / 2)
# Right, down and forward of the cube's faces in the scene's axes; z is up.
_FACES = tuple(np.stack(axes, axis=1) for axes in (
    *(((math.sin(yaw), -math.cos(yaw), 0.0), (0.0, 0.0, -1.0),
       (math.cos(yaw), math.sin(yaw), 0.0)) for yaw in np.arange(4) * math.pi / 2),
    ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ((0.0, -1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, -1.0))))
# Faces are a little wider than 90 degrees, pixels at each side, so that no seam shows.
_RIM = 2


class Panorama(NamedTuple):
    """
    The sphere, equirectangular, in the axes of the scene: the middle column looks along its +x.

    image uint8 RGB (W / 2, W, 3); rows go down from straight up, columns clockwise. kinds uint8
    (W / 2, W): SEEN by the camera now, REMEMBERED, or UNKNOWN, where the image is black.
    """

    image: np.ndarray
    kinds: np.ndarray


def draw_panorama(renderer: MemoryRenderer, pose: CameraPose, gain: np.ndarray,
                  wide_image: np.ndarray, expansion: ViewExpansion, width: int) -> Panorama:
    """
    Draw the memory around a camera, times gain (3,); what the camera sees is `wide_image`'s.

    width: even, in pixels. Not thread-safe with other drawing.
    """
    view, columns, rows = _faces(width)
    drawn = np.empty((len(_FACES), view.height, view.width, 3), np.uint8)
    known = np.empty(drawn.shape[:3], np.uint8)
    for number, rotation in enumerate(_FACES):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation, pose.position
        shown = renderer.render(CameraPose(T), view)
        np.clip(shown.image * gain + 0.5, 0, 255, out=drawn[number], casting='unsafe')
        known[number] = np.where(shown.depth > 0, REMEMBERED, UNKNOWN)
    image = cv2.remap(drawn.reshape(-1, view.width, 3), columns, rows, cv2.INTER_LINEAR)
    kinds = cv2.remap(known.reshape(-1, view.width), columns, rows, cv2.INTER_NEAREST)
    image[kinds == UNKNOWN] = 0
    _paste(image, kinds, pose, wide_image, expansion)
    return Panorama(image, kinds)


def _paste(image: np.ndarray, kinds: np.ndarray, pose: CameraPose, wide_image: np.ndarray,
           expansion: ViewExpansion) -> None:
    """Put the camera's own pixels in their place."""
    local = SPHERE.rays(*kinds.shape) @ pose.T_world_cam[:3, :3].astype(np.float32)
    camera = expansion.source
    ahead = np.maximum(local[..., 2], 1e-6)
    columns = camera.fx * local[..., 0] / ahead + camera.cx - 0.5
    rows = camera.fy * local[..., 1] / ahead + camera.cy - 0.5
    seen = ((local[..., 2] > 0) & (columns >= 0) & (columns <= camera.width - 1)
            & (rows >= 0) & (rows <= camera.height - 1))
    picture = np.ascontiguousarray(expansion.crop(wide_image))
    image[seen] = cv2.remap(picture, columns, rows, cv2.INTER_LINEAR)[seen]
    kinds[seen] = SEEN


@lru_cache(maxsize=2)
def _faces(width: int) -> tuple[Intrinsics, np.ndarray, np.ndarray]:
    """Return the camera of a cube's faces, and columns and rows in them, one below the other."""
    # A panorama's pixel at the horizon is as large as one in the middle of a face.
    focal = width / (2 * math.pi)
    side = 2 * math.ceil(focal + _RIM)
    rays = SPHERE.rays(width // 2, width)
    nearest = np.argmax(np.stack([rays @ rotation[:, 2] for rotation in _FACES]), axis=0)
    local = np.einsum('hwi,hwij->hwj', rays, np.stack(_FACES)[nearest])
    pixels = focal * local[..., :2] / local[..., 2:] + side / 2 - 0.5
    return (Intrinsics(side, side, focal, focal, side / 2, side / 2),
            pixels[..., 0].astype(np.float32),
            (pixels[..., 1] + nearest * side).astype(np.float32))
