"""The built-in demo scene: a small furnished flat, cast exactly at any pose and field of view."""
from dataclasses import dataclass
from functools import lru_cache

from neo_ros.flat.light import demo_light, LightMap
from neo_ros.flat.pictures import panorama
from neo_ros.flat.raycast import camera_directions, cast_camera
from neo_ros.flat.rooms import demo_solids
from neo_ros.flat.shapes import BOX, Solids
from neo_ros.flat.surfaces import locate, SurfacePoints
from neo_ros.flat.textures import MipMap, Patch, reflectance
from neo_ros.flat.walks import free_floor, plan_walks, planar_poses
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.scenes.walkable import WalkableMap
import numpy as np

SAMPLES = 3  # rays per pixel and axis; odd, so that one goes through the centre
EXPOSURE = np.float32(1.6)
WHITE_POINT = np.float32(3.6)  # exposed radiance that becomes pure white


@dataclass(frozen=True, eq=False)
class DemoFlat:
    """
    Solids and their light; all views of it are deterministic.

    outside  how bright the world before the windows is, 1 by day
    exposure of the camera, relative to the one by day
    """

    solids: Solids
    light: LightMap
    outside: float = 1.0
    exposure: float = 1.0

    def render(self, intrinsics: Intrinsics, pose: CameraPose) -> tuple[np.ndarray, np.ndarray]:
        """
        Look at the flat through a pinhole camera.

        Returns the image, RGB uint8 (H, W, 3), and the depth, float32 (H, W): metres along the
        optical axis at the pixel centre. A crop of a view is the view of the cropped camera.
        """
        directions = camera_directions(intrinsics, pose, SAMPLES)
        hits = cast_camera(self.solids, intrinsics, pose, directions)
        rays = directions.reshape(3, -1).T
        distance, solid = hits.distance.ravel(), hits.solid.ravel()
        radiance = np.empty((len(rays), 3), np.float32)
        outside = solid < 0
        radiance[outside] = np.float32(self.outside) * outside_radiance(rays[outside])
        inside = np.flatnonzero(~outside)
        radiance[inside] = self.radiance(
            solid[inside], pose.position.astype(np.float32), rays[inside], distance[inside],
            sample_spread(intrinsics))
        return (developed(np.float32(self.exposure) * radiance, intrinsics),
                centre_samples(hits.distance))

    def depth(self, intrinsics: Intrinsics, pose: CameraPose) -> np.ndarray:
        """Return the depth along the optical axis, float32 (H, W) metres."""
        return cast_camera(self.solids, intrinsics, pose,
                           camera_directions(intrinsics, pose, 1)).distance

    def walkable(self) -> WalkableMap:
        """Return the free floor of both rooms, in cells of 0.05 m."""
        return free_floor(self.solids)

    def radiance(self, solid: np.ndarray, position: np.ndarray, rays: np.ndarray,
                 distance: np.ndarray, spread: np.float32) -> np.ndarray:
        """Return what leaves the solids (M,) towards a camera along rays (M, 3): (M, 3)."""
        points = position + rays * distance[:, None]
        places = locate(self.solids, solid, points, rays)
        footprint = distance * spread / np.sqrt(np.maximum(places.slant, np.float32(0.03)))
        colour = self._reflectance(places, footprint)
        wraps = (self.solids.kind[solid] != BOX) & (places.face == 0)
        glow = np.array([m.emission for m in self.solids.materials], np.float32)[solid]
        return colour * (self.light.look_up(places, wraps) + glow[:, None])

    def _reflectance(self, places: SurfacePoints, footprint: np.ndarray) -> np.ndarray:
        materials = self.solids.materials
        result = np.array([m.colour for m in materials], np.float32)[places.solid]
        order = np.argsort(places.solid, kind='stable')
        ends = np.flatnonzero(np.diff(places.solid[order], append=-2)) + 1
        start = 0
        for end in ends.tolist():
            chosen = order[start:end]
            start = end
            material = materials[places.solid[chosen[0]]]
            if material.kind != 'plain':
                result[chosen] = reflectance(material, Patch(
                    places.u[chosen], places.v[chosen], places.across[chosen],
                    places.up[chosen], footprint[chosen]))
        return result


@lru_cache(maxsize=1)
def build_demo_flat() -> DemoFlat:
    """Build the one demo flat; a process builds it once."""
    return DemoFlat(demo_solids(), demo_light())


def sample_training_poses(flat: DemoFlat, n: int, seed: int) -> list[CameraPose]:
    """Draw n level poses at 1.5 m, free floor and heading uniform (paper, section 4.1)."""
    return planar_poses(flat.walkable(), n, seed)


def walking_paths(flat: DemoFlat, n_paths: int, n_frames: int,
                  seed: int) -> list[list[CameraPose]]:
    """
    Plan smooth walks at 1.5 m, 0.5 m/s at about 6 Hz, looking ahead and a little around.

    The first walk goes through the doorway. Raises SceneError where no way is found.
    """
    return plan_walks(flat.walkable(), n_paths, n_frames, seed)


@lru_cache(maxsize=1)
def _panorama() -> MipMap:
    return MipMap(panorama(), wrap=False)


def sample_spread(intrinsics: Intrinsics, samples: int = SAMPLES) -> np.float32:
    """Return the angle between two samples, radians."""
    return np.float32(1 / (samples * intrinsics.fx))


def centre_samples(values: np.ndarray, samples: int = SAMPLES) -> np.ndarray:
    """Return the samples (h, w) at the centres of the pixels."""
    centres = slice(samples // 2, None, samples)
    return values[centres, centres].copy()


def developed(radiance: np.ndarray, intrinsics: Intrinsics, samples: int = SAMPLES) -> np.ndarray:
    """Average the samples (M, 3) of each pixel as a camera would: RGB uint8 (H, W, 3)."""
    shown = _tone(radiance).reshape(intrinsics.height, samples, intrinsics.width, samples, 3)
    return encoded(shown.sum(axis=(1, 3)) / np.float32(samples ** 2))


def outside_radiance(rays: np.ndarray) -> np.ndarray:
    """Return how bright the world outside is along rays (M, 3): (M, 3)."""
    across = np.arctan2(rays[:, 1], rays[:, 0]) / np.float32(2 * np.pi) % 1
    level = np.arctan2(rays[:, 2], np.hypot(rays[:, 0], rays[:, 1]))
    down = np.clip(np.float32(0.5) - level / np.float32(np.radians(120)), 0, 1)
    return _panorama().look_up(across, down, np.full(len(rays), 1 / 192, np.float32))


def _tone(radiance: np.ndarray) -> np.ndarray:
    """Roll bright light off softly: linear in, linear in [0, 1] out (Reinhard, extended)."""
    x = radiance * EXPOSURE
    return np.minimum(x * (1 + x / (WHITE_POINT * WHITE_POINT)) / (1 + x * np.float32(0.8)), 1)


def encoded(linear: np.ndarray) -> np.ndarray:
    """Return the sRGB values, uint8, of light in [0, 1], float32."""
    srgb = np.where(linear <= 0.0031308, linear * np.float32(12.92),
                    np.float32(1.055) * linear ** np.float32(1 / 2.4) - np.float32(0.055))
    return np.rint(srgb * 255).astype(np.uint8)
