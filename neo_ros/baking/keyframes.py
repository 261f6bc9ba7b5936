"""
The keyframes of a scene memory: depth out of the field, colours out of the photos.

The field knows where things are better than how they look: each point of a panorama takes its
colour from the photos that saw it from nearly the same direction, and from the field where no
photo agrees.
"""
from dataclasses import dataclass
import math

import cv2
from neo_ros.baking.band_rendering import mesh_depth, render_band
from neo_ros.baking.kernels import colour_from_photos, FAR, PanoramaPixels, PhotoArrays
from neo_ros.baking.plain_surfaces import (
    dominant_directions, move_to_planes, NO_DIRECTIONS, with_planes)
from neo_ros.errors import ConfigError
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_rays, to_uint8, world_rays
from neo_ros.geometry import Band, CameraPose, Intrinsics
from neo_ros.machine.evenly import evenly
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.keyframe import FINER, Keyframe
from neo_ros.scenes.pose_sampling import PoseSampler
import numpy as np


@dataclass(frozen=True)
class BakingRules:
    """What was chosen by measuring, and holds for all scenes."""

    mesh_focal: float = 96.0       # the mesh's vertices a radian are at most so many
    # Pixels of a texture a radian, at most, or as many as the view has: there poses and depth tell
    # what is sharp. 640x480 at 69 degrees: 27.98 dB, three times as fine as the view 27.89.
    texture_focal: float = 768.0
    dense: int = 3                 # rays into the field for a vertex, along each side, at most
    photo_focal: float = 64.0      # rays into the field a radian, at most, to see what photos see
    photos: int = 400              # nearest to a keyframe, that may colour it
    one_surface: float = 0.1       # depths that differ by less than this share are of one surface
    least_coverage: float = 0.5    # of a pixel by what photos saw, for its depth to be known
    least_keyframes: int = 8       # however short the time
    direction_photos: int = 100    # that tell which way the walls face
    # Of a texture: OpenCV's remap takes fewer than 2^15 - 1 rows and columns, and a robot decodes
    # it: fewer pixels than a memory file may ask for.
    most_side: int = (1 << 15) - 2
    most_bytes: int = 512 << 20


@dataclass(frozen=True)
class MemoryConfig:
    """What the robot keeps of the scene beside the network."""

    __pydantic_config__ = {'extra': 'forbid'}
    # metres from any place of a robot, or any photo of a hand-held camera, to the nearest keyframe
    distance: float = 0.3
    # Of making it: with fewer than it takes keyframes stand farther apart, evenly. None: all.
    minutes: float | None = None

    def __post_init__(self) -> None:
        if self.minutes is not None and not 0 < self.minutes < math.inf:
            raise ConfigError(f'memory.minutes: expected a number > 0, got {self.minutes}')
        if not self.distance > 0:
            raise ConfigError(f'memory.distance: expected metres > 0, got {self.distance}')


@dataclass(frozen=True, eq=False)
class Photos:
    """
    Photos uint8 (N, H, W, 3), their camera and T_world_cam (N, 4, 4).

    usable: bool (N, H, W), False where a photo does not show the scene; None: it does.
    """

    images: np.ndarray
    intrinsics: Intrinsics
    T_world_cam: np.ndarray
    usable: np.ndarray | None = None

    def part(self, first: int, last: int) -> 'Photos':
        """Return the photos from the first to before the last."""
        return Photos(self.images[first:last], self.intrinsics, self.T_world_cam[first:last],
                      None if self.usable is None else self.usable[first:last])


def seen_by_photos(field: RadianceField, photos: Photos, rules: BakingRules = BakingRules(),
                   progress: Progress = no_progress) -> tuple[np.ndarray, np.ndarray]:
    """Return how far photos see, float32 (N, h, w) metres along the ray, and gains (N, 3)."""
    camera = seeing_camera(photos.intrinsics, rules)
    seen = np.empty((len(photos.images), camera.height, camera.width), np.float32)
    gains = []
    for index, (image, T) in enumerate(zip(photos.images, photos.T_world_cam)):
        rendering = render_rays(field, *world_rays(camera, CameraPose(T)))
        seen[index] = np.where(rendering.coverage > rules.least_coverage, rendering.depth, 0)
        usable = np.ones(image.shape[:2], bool) if photos.usable is None else photos.usable[index]
        clear = clear_pixels(usable, camera)
        seen[index][~clear] = 0
        gains.append(_gain(rendering.image[clear], image[usable]))
        progress(index + 1, len(photos.images))
    return seen, np.stack(gains)


def seeing_camera(camera: Intrinsics, rules: BakingRules) -> Intrinsics:
    """Return the camera by which the depth of photos is kept, no finer than the field is."""
    if camera.fx < rules.photo_focal + 0.5:  # It was made small before, to whole pixels.
        return camera
    return camera.scaled(min(rules.photo_focal / camera.fx, 1.0))


def directions_of_photos(photos: Photos, seen: np.ndarray, rules: BakingRules) -> np.ndarray:
    """Return the directions that the surfaces of the scene face, see `dominant_directions`."""
    chosen = evenly(len(seen), rules.direction_photos)
    return dominant_directions(seen[chosen], (
        _seeing_rays(photos, rules, index) for index in chosen))


def put_on_planes(photos: Photos, seen: np.ndarray, directions: np.ndarray, rules: BakingRules,
                  progress: Progress = no_progress) -> None:
    """Put what is plain in `seen` on planes that face `directions`, in place: `with_planes`."""
    camera = seeing_camera(photos.intrinsics, rules)
    for index, image in enumerate(photos.images):
        seen[index] = with_planes(seen[index], cv2.resize(
            image, (camera.width, camera.height), interpolation=cv2.INTER_AREA),
            _seeing_rays(photos, rules, index), directions)
        progress(index + 1, len(photos.images))


def _seeing_rays(photos: Photos, rules: BakingRules, index: int) -> np.ndarray:
    camera = seeing_camera(photos.intrinsics, rules)
    return world_rays(camera, CameraPose(photos.T_world_cam[index]))[1]


def clear_pixels(usable: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """
    Return bool (h, w) of the camera's size: no pixel that a mask leaves out is near.

    A colour is made of pixels up to two away.
    """
    near = cv2.dilate((~usable).astype(np.float32), np.ones((5, 5), np.uint8))
    return cv2.resize(near, (camera.width, camera.height), interpolation=cv2.INTER_AREA) == 0


def keyframe_positions(sampler: PoseSampler, photos: Photos, distance: float) -> np.ndarray:
    """
    Choose positions (K, 3) so that each place of the camera has one within `distance`.

    On a floor these are the places where the robot can be. A hand-held camera's are those of the
    photos; poses are sampled a little farther around them, and some may have none so near.
    """
    if sampler.height[1] == 0:
        places = sampler.places()
    else:
        places = photos.T_world_cam[:, :3, 3]
    first = int(np.linalg.norm(places - places.mean(0), axis=1).argmin())
    return np.concatenate([places[[first]], spread(places, places[[first]], distance)])


def spread(places: np.ndarray, there: np.ndarray, distance: float) -> np.ndarray:
    """Choose of places (N, 3), so that each has one, or one of those there, within `distance`."""
    away = np.full(len(places), np.inf)
    for one in there:
        away = np.minimum(away, np.linalg.norm(places - one, axis=1))
    chosen = []
    while away.max() > distance:
        chosen.append(int(away.argmax()))
        away = np.minimum(away, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return places[chosen]


def _gain(rendered: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """
    Return what multiplies a photo's pixels (P, 3) to the exposure of the field, (3,).

    By their means: the field was fitted to this photo, so its errors have no sign.
    """
    if not (len(photo) and len(rendered)):
        return np.ones(3, np.float32)
    ratio = 255 * rendered.mean(0, np.float64) / np.maximum(photo.mean(0), 1)
    return np.clip(ratio, 0.5, 2).astype(np.float32)


def keyframe_size(band: Band, focal: float, rules: BakingRules = BakingRules()
                  ) -> tuple[int, int, int]:
    """
    Return rows and columns of a keyframe's mesh, and how many times finer its texture is.

    That is FINER times as fine as the view, or as fine as a texture need and can be.
    """
    mesh = min(focal, rules.mesh_focal)
    wanted = min(FINER * focal, max(rules.texture_focal, focal))
    rows, columns = max(int((band.top - band.bottom) * mesh), 2), int(band.width * mesh)
    most = min(rules.most_side // max(rows, columns),
               math.isqrt(rules.most_bytes // (3 * rows * columns)))
    return rows, columns, max(min(round(wanted / mesh), most), 1)


def bake_keyframe(field: RadianceField, photos: Photos, seen: np.ndarray, gains: np.ndarray,
                  position: np.ndarray, band: Band, size: tuple[int, int, int],
                  rules: BakingRules, directions: np.ndarray = NO_DIRECTIONS,
                  wanted: np.ndarray | None = None) -> Keyframe:
    """
    Render and colour a keyframe of a size as `keyframe_size` tells.

    seen, gains: of the photos, see `seen_by_photos`; directions: that planes face, see
    `with_planes`; wanted bool (h, w): pixels of the mesh that are made, None: all. Then the
    keyframe is the `box_of` them, in which the others stay unknown.
    """
    height, width, finer = size
    dense = min(finer, rules.dense)
    rays, wraps = band.rays(height * dense, width * dense), band.wraps and wanted is None
    if wanted is not None:
        part = box_of(wanted)
        wanted = wanted[part]
        rays = np.ascontiguousarray(rays[finer_slices(part, dense)])
    height, width = rays.shape[0] // dense, rays.shape[1] // dense
    depth, colours, own = render_band(field, position, rays, dense, wraps,
                                      rules.one_surface, FAR, rules.least_coverage, wanted)
    shown = to_uint8(colours)
    move_to_planes(depth, shown, rays, dense, directions, rules.one_surface)
    texture = np.empty((height * finer, width * finer, 3), np.uint8)
    centres = photos.T_world_cam[:, :3, 3]
    near = np.sort(np.argsort(np.linalg.norm(centres - position, axis=1),
                              kind='stable')[:rules.photos])
    camera = photos.intrinsics
    colour_from_photos(
        PanoramaPixels(position.astype(np.float32), rays, depth, shown),
        PhotoArrays(photos.images, seen[near],
                    np.ascontiguousarray(photos.T_world_cam[near, :3, :3], np.float32),
                    centres[near].astype(np.float32), gains[near],
                    camera.fx, camera.fy, camera.cx, camera.cy, near),
        wraps, rules.one_surface, texture, own, dense)
    return Keyframe(position, mesh_depth(depth, dense, rules.one_surface), texture)


def box_of(pixels: np.ndarray) -> tuple[slice, slice]:
    """Return rows and columns (slices) of the pixels that are marked, bool (h, w)."""
    rows, columns = (np.flatnonzero(pixels.any(axis)) for axis in (1, 0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def finer_slices(part: tuple[slice, slice], finer: int) -> tuple[slice, slice]:
    """Return the rows and columns of pixels that are so many times finer."""
    rows, columns = (slice(finer * one.start, finer * one.stop) for one in part)
    return rows, columns
