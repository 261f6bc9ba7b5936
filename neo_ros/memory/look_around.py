"""A look in any direction: the live image in its place, around it the memory."""
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
import math
from typing import NamedTuple

import cv2
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.compiled import ALL_THREADS
from neo_ros.memory.kernels import Pinhole
from neo_ros.memory.look_kernels import bring_newest, Brought
from neo_ros.memory.panorama import REMEMBERED, SEEN, UNKNOWN
from neo_ros.memory.parallel import parallel_loops
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.pictures.exposure import exposure_gain
import numpy as np

# Seen by the camera in the last seconds, see `panorama`'s kinds.
RECENT = 192


@dataclass(frozen=True)
class LookThresholds:
    """How a look is drawn, and how far a distance is trusted."""

    keyframes: int = 3
    # Images are compared with the memory in a view at most so wide, pixels.
    widest: int = 320
    # Points along each side of the camera's frame.
    frame_points: int = 12
    # What was just seen is marked in patches, not in single pixels: of squares of this side most.
    smoothed: int = 15
    # Keyframes that are asked for a distance, and the radius in pixels of the patch that is.
    asked: int = 4
    patch: int = 3
    # Of the remembered distance: two thirds of all points of the demo flat are nearer to the
    # truth than this share and what the keyframes differ by.
    least_share: float = 0.04
    # Grey levels by which the camera's image and the memory differ where something else stands.
    contradiction: float = 24.0


@dataclass(frozen=True)
class Direction:
    """
    Where somebody looks: level, in the axes of the scene, radians.

    yaw counter-clockwise from above, 0 = along +x; pitch up; hfov of the view of `width` by
    `height` pixels.
    """

    yaw: float
    pitch: float
    hfov: float
    width: int
    height: int

    @property
    def view(self) -> Intrinsics:
        """The pinhole camera."""
        return Intrinsics.from_hfov(self.width, self.height, self.hfov)

    def pose(self, position: np.ndarray) -> CameraPose:
        """Return the pose of a camera at this position, (3,) metres, that looks there."""
        x, y, z = position.tolist()
        T = CameraPose.from_planar(x, y, z, self.yaw).T_world_cam.copy()
        c, s = math.cos(self.pitch), math.sin(self.pitch)
        T[:3, :3] = T[:3, :3] @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        return CameraPose(T)


class SeenImage:
    """
    One image of the camera, uint8 RGB (h, w, 3), and its pose.

    What is known of it once it was drawn: gain (3,) from the memory's exposure to its own, and
    `off`, what it differs by from the memory and the depth of that, see `look_kernels.Brought`.
    """

    def __init__(self, image: np.ndarray, pose: CameraPose) -> None:
        self.image, self.pose = image, pose
        self.gain = np.ones(3, np.float32)
        self.off: tuple[np.ndarray, np.ndarray] | None = None


class LookPicture(NamedTuple):
    """
    What is seen in a direction.

    image uint8 RGB (H, W, 3), black where unknown; kinds uint8 (H, W): SEEN, RECENT, REMEMBERED or
    UNKNOWN. frame: lines around the camera's image, each (N, 2), x and y in shares of the view.
    """

    image: np.ndarray
    kinds: np.ndarray
    frame: list[np.ndarray]


class Distance(NamedTuple):
    """
    How far away a point is, metres from the camera's optical centre.

    Two of three are within `plus_minus` of the truth. contradicted: the camera's image shows
    other colours there than the memory.
    """

    metres: float
    plus_minus: float
    contradicted: bool


class LookAround:
    """
    Draws looks into one memory for any number of viewers; any thread may ask, one is served.

    On one core by default: several draw a little sooner, but wait for one another in vain.
    """

    def __init__(self, memory: SceneMemory, expansion: ViewExpansion, threads: int = 1,
                 thresholds: LookThresholds = LookThresholds()) -> None:
        self.expansion, self.thresholds = expansion, thresholds
        self._renderer = MemoryRenderer(memory)
        self._threads = min(threads, ALL_THREADS)

    @cached_property
    def _small(self) -> Intrinsics:
        source = self.expansion.source
        scale = min(1.0, self.thresholds.widest / source.width)
        width, height = max(round(source.width * scale), 2), max(round(source.height * scale), 2)
        x, y = width / source.width, height / source.height
        return Intrinsics(width, height, source.fx * x, source.fy * y, source.cx * x,
                          source.cy * y)

    def draw(self, position: np.ndarray, direction: Direction, now: SeenImage | None,
             before: Sequence[SeenImage] = ()) -> LookPicture:
        """
        Look from a position, (3,) metres.

        now: the image that the camera takes there, which is shown in its place; before: images
        of the last seconds, the newest first, which are shown where the memory says that they
        saw the same surface.
        """
        pose, view = direction.pose(position), direction.view
        with parallel_loops(self._threads):
            shown = self._renderer.render(pose, view, self.thresholds.keyframes)
            for seen in (*before, *([now] if now is not None else [])):
                self._compare(seen)
            newest = now or (before[0] if before else None)
            kinds = np.where(shown.depth > 0, REMEMBERED, UNKNOWN).astype(np.uint8)
            if before:
                self._bring(before, pose, view, np.where(shown.stretched, 0, shown.depth),
                            shown.image, kinds)
                _smooth(kinds, self.thresholds.smoothed)
        gain = newest.gain if newest is not None else np.float32(1)
        image = np.clip(shown.image * gain + 0.5, 0, 255).astype(np.uint8)
        image[kinds == UNKNOWN] = 0
        frame: list[np.ndarray] = []
        if now is not None:
            _paste(image, kinds, pose, view, now, self.expansion.source)
            frame = outline(now.pose, self.expansion.source, pose, view,
                            self.thresholds.frame_points)
        return LookPicture(image, kinds, frame)

    def distance(self, position: np.ndarray, direction: Direction, x: float, y: float,
                 now: SeenImage | None = None) -> Distance | None:
        """
        Say how far away a point of a view is, as remembered; None where that is not known.

        x, y in shares of the view; now: the image that the camera takes from this position.
        """
        pose, view = direction.pose(position), direction.view
        return self.distance_in(pose, view, x * view.width, y * view.height, now)

    def distance_in(self, pose: CameraPose, view: Intrinsics, u: float, v: float,
                    now: SeenImage | None = None) -> Distance | None:
        """Say the same of pixel (u, v) of any view from a pose."""
        limits, reach = self.thresholds, self.thresholds.patch
        side = 2 * reach + 1
        # The camera of a patch whose middle is the point.
        patch = Intrinsics(side, side, view.fx, view.fy, view.cx - u + side / 2,
                           view.cy - v + side / 2)
        with parallel_loops(self._threads):
            if now is not None:
                self._compare(now)
            whole = self._renderer.render(pose, patch, limits.keyframes)
            each = [self._renderer.render_from([keyframe], pose, patch) for keyframe in
                    self._renderer.nearest(pose.position, limits.asked)]
        solid = (whole.depth > 0) & ~whole.stretched
        if not solid.any():
            return None
        # Between two surfaces nothing is known: the nearest pixel that lies on one counts.
        rows, columns = np.nonzero(solid)
        nearest = np.argmin((rows - reach) ** 2 + (columns - reach) ** 2)
        place = (rows[nearest], columns[nearest])
        z = float(whole.depth[place])
        others = np.array([other.depth[place] for other in each
                           if other.depth[place] > 0 and not other.stretched[place]])
        # Keyframes that see another surface there say nothing of how exact this one is, but that
        # it may be that one.
        spread = float(np.median(np.abs(others - z))) if len(others) else 0.0
        near = whole.depth[solid]
        slope = float(np.percentile(near, 84) - np.percentile(near, 16)) / 2
        ray = math.sqrt(1 + ((u - view.cx) / view.fx) ** 2 + ((v - view.cy) / view.fy) ** 2)
        plus_minus = math.hypot(limits.least_share * z, spread, slope)
        return Distance(z * ray, plus_minus * ray,
                        now is not None and self._contradicts(now, whole.image, pose, patch))

    def _contradicts(self, now: SeenImage, remembered: np.ndarray, pose: CameraPose,
                     patch: Intrinsics) -> bool:
        """Tell whether a patch of the live image differs from the memory."""
        columns, rows, seen = _in_image(now.pose, self.expansion.source, pose, patch)
        if not seen.all():
            return False
        live = cv2.remap(now.image, columns, rows, cv2.INTER_LINEAR)
        off = np.abs(remembered * now.gain - live).mean()
        return bool(off > self.thresholds.contradiction)

    def _compare(self, seen: SeenImage) -> None:
        """Draw what the memory shows where an image was taken, once."""
        if seen.off is not None:
            return
        small = self._small
        shown = self._renderer.render(seen.pose, small, self.thresholds.keyframes)
        known = shown.depth > 0
        image = cv2.resize(seen.image, (small.width, small.height), interpolation=cv2.INTER_AREA)
        seen.gain = exposure_gain(shown.image[known], image[known])
        seen.off = (image / seen.gain - shown.image,
                    np.where(shown.stretched, 0, shown.depth).astype(np.float32))

    def _bring(self, before: Sequence[SeenImage], pose: CameraPose, view: Intrinsics,
               depth: np.ndarray, picture: np.ndarray, kinds: np.ndarray) -> None:
        T = np.stack([seen.pose.inverse() @ pose.T_world_cam for seen in before])
        differences, depths = zip(*(seen.off for seen in before if seen.off is not None))
        camera = self._small
        bring_newest(
            view.pixel_rays(), depth,
            Brought(np.stack(differences), np.stack(depths), T[:, :3, :3].astype(np.float32),
                    T[:, :3, 3].astype(np.float32)),
            Pinhole(*map(np.float32, (camera.fx, camera.fy, camera.cx, camera.cy))),
            RECENT, picture, kinds)


def outline(camera_pose: CameraPose, camera: Intrinsics, pose: CameraPose, view: Intrinsics,
            points: int) -> list[np.ndarray]:
    """
    Return where the frame of a camera's image lies in another view from the same position.

    Lines (N, 2), x and y in shares of the view, in pieces that lie before it.
    """
    along = np.linspace(0, 1, points)
    corners = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0, 0)], np.float64)
    sides = np.concatenate([start + (end - start) * along[:, None]
                            for start, end in zip(corners[:-1], corners[1:])])
    u, v = sides[:, 0] * camera.width, sides[:, 1] * camera.height
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy,
                     np.ones(len(u))], 1)
    local = rays @ camera_pose.T_world_cam[:3, :3].T @ pose.T_world_cam[:3, :3]
    ahead = local[:, 2] > 0.05
    z = np.where(ahead, local[:, 2], 1)
    places = np.stack([(view.fx * local[:, 0] / z + view.cx) / view.width,
                       (view.fy * local[:, 1] / z + view.cy) / view.height], 1)
    starts = np.flatnonzero(np.diff(ahead.astype(int), prepend=0) == 1)
    ends = np.flatnonzero(np.diff(ahead.astype(int), append=0) == -1) + 1
    return [places[start:end] for start, end in zip(starts, ends) if end - start > 1]


def _in_image(camera_pose: CameraPose, camera: Intrinsics, pose: CameraPose, view: Intrinsics
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return columns and rows of a view's pixels in a camera's image, and where it has them."""
    turn = (pose.T_world_cam[:3, :3].T @ camera_pose.T_world_cam[:3, :3]).astype(np.float32)
    local = view.pixel_rays() @ turn
    ahead = np.maximum(local[..., 2], np.float32(1e-6))
    columns = camera.fx * local[..., 0] / ahead + np.float32(camera.cx - 0.5)
    rows = camera.fy * local[..., 1] / ahead + np.float32(camera.cy - 0.5)
    seen = ((local[..., 2] > 0) & (columns >= 0) & (columns <= camera.width - 1)
            & (rows >= 0) & (rows <= camera.height - 1))
    return columns.astype(np.float32), rows.astype(np.float32), seen


def _smooth(kinds: np.ndarray, side: int) -> None:
    """Mark what was just seen in whole patches."""
    known = kinds != UNKNOWN
    recent = cv2.medianBlur((kinds == RECENT).astype(np.uint8), side) > 0
    kinds[known] = np.where(recent[known], RECENT, REMEMBERED)


def _paste(image: np.ndarray, kinds: np.ndarray, pose: CameraPose, view: Intrinsics,
           now: SeenImage, camera: Intrinsics) -> None:
    """Put the camera's own pixels in their place."""
    columns, rows, seen = _in_image(now.pose, camera, pose, view)
    image[seen] = cv2.remap(now.image, columns, rows, cv2.INTER_LINEAR)[seen]
    kinds[seen] = SEEN
