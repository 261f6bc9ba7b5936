"""What the memory shows of a new place: where the robot can be there, keyframes, landmarks."""
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from neo_ros.baking.glances import photo_glances
from neo_ros.baking.keyframes import BakingRules, Photos, spread
from neo_ros.baking.memory_baking import Finished, Recipe
from neo_ros.baking.plain_surfaces import hand_held
from neo_ros.errors import SceneError
from neo_ros.field.free_space import find_free_floor
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.landmarks import Landmarks
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.scenes.pose_sampling import SamplingConfig
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.walkable import WalkableMap
from neo_ros.updating.changed_keyframes import directions_of
from neo_ros.updating.growth import Growth
import numpy as np

# Metres off a height of the memory's keyframes by which a place of the same robot is.
NEAR_HEIGHT = 0.1


def new_floor(growth: Growth, camera: Intrinsics, config: SamplingConfig,
              walkable: WalkableMap | None) -> WalkableMap | None:
    """
    Return the free floor of the new place, around where the camera drove; None where none is.

    It keeps as far off what is not free as the scene's floor map does.
    """
    count = len(growth.T)
    photos = PosedImages(camera, (Path(),) * count, tuple(map(CameraPose, growth.T)), (0,) * count)
    radius = config.robot_radius
    if walkable is not None:
        config = replace(config, camera_height=walkable.camera_height)
        radius = walkable.clearance
    try:
        free = find_free_floor(growth.field, photos, config).kept_off(radius)
    except SceneError:
        return None
    centres = free.centres()
    cells, rows = free.cells.copy(), growth.space.holds(growth.field, np.column_stack(
        [centres, np.full(len(centres), free.camera_height)]))
    cells[cells] = rows
    return replace(free, cells=cells) if cells.any() else None


def joined_floor(old: WalkableMap, new: WalkableMap) -> WalkableMap:
    """Return a floor map with more free floor, in the cells of the old one."""
    edge, origin = old.resolution, np.array(old.origin)
    size = np.array(old.cells.shape[::-1])
    centres = new.centres()
    before = np.maximum(np.ceil((origin - centres.min(0)) / edge), 0).astype(int)
    after = np.maximum(np.ceil((centres.max(0) - origin) / edge) - size, 0).astype(int)
    cells = np.pad(old.cells, ((before[1], after[1]), (before[0], after[0])))
    start = origin - before * edge
    j, i = np.indices(cells.shape)
    at = (np.stack([i, j], -1).reshape(-1, 2) + 0.5) * edge + start
    return WalkableMap(edge, (float(start[0]), float(start[1])),
                       cells | new.contains(at).reshape(cells.shape), old.camera_height,
                       old.clearance)


def new_positions(growth: Growth, floor: WalkableMap | None, memory: SceneMemory, distance: float
                  ) -> np.ndarray:
    """
    Choose positions (K, 3) of keyframes, so that each new place has one within `distance`.

    Places are where photos were taken, and the free floor; a hand-held camera's are the first
    alone. The memory's own keyframes count.
    """
    places = growth.T[:, :3, 3].copy()
    if not hand_held(memory.positions):
        if floor is not None:
            centres = floor.centres()
            places = np.concatenate([places, np.column_stack(
                [centres, np.full(len(centres), floor.camera_height)])])
        # Poses that were found are off by some centimetres; the camera's height is not.
        heights = memory.positions[:, 2]
        nearest = heights[np.abs(heights - places[:, 2:]).argmin(1)]
        near = np.abs(nearest - places[:, 2]) < NEAR_HEIGHT
        places[near, 2] = nearest[near]
    return spread(places, memory.positions, distance)


def with_place(memory: SceneMemory, growth: Growth, recipe: Recipe, positions: np.ndarray,
               made: Sequence[Finished]) -> SceneMemory:
    """
    Return a memory with new keyframes at positions (K, 3), and glances and landmarks of a place.

    recipe: of the keyframes made, whose photos include those taken in the new place.
    """
    photos = recipe.photos
    taken = (photos.T_world_cam[:, None] == growth.T).all((2, 3)).any(1)
    glances = photo_glances(photos.images[taken], photos.intrinsics, photos.T_world_cam[taken],
                            recipe.source)
    return memory.with_more(
        positions, [(texture, depth) for texture, depth, _ in made],
        [glances, *(one for _, _, one in made)],
        _joined(memory.landmarks, growth.tied.landmarks, growth))


def recipe_of(memory: SceneMemory, photos: Photos, seen: np.ndarray, gains: np.ndarray,
              source: Intrinsics, rules: BakingRules = BakingRules()) -> Recipe:
    """Return how keyframes like those of a memory are made of photos, see `Recipe`."""
    return Recipe(photos, seen, gains, memory.band, _size(memory), rules, directions_of(memory),
                  source, _rotations(memory))


def _size(memory: SceneMemory) -> tuple[int, int, int]:
    first = memory.keyframe(0)
    rows, columns = first.depth.shape
    return rows, columns, len(first.texture) // rows


def _rotations(memory: SceneMemory) -> list[np.ndarray]:
    """Return the rotations (3, 3) of glances at a keyframe."""
    poses = memory.glances.T_world_cam
    at_first = (poses[:, :3, 3] == memory.positions[0]).all(1)
    return list(poses[at_first, :3, :3])


def _joined(old: Landmarks | None, new: Landmarks | None, growth: Growth) -> Landmarks | None:
    """Return old landmarks, and new ones in the new place."""
    return Landmarks.joined([old, new and new.subset(
        growth.space.holds(growth.field, new.points))])
