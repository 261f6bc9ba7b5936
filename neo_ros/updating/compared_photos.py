"""Photos of before and new ones, compared with what the memory shows where they were taken."""
from dataclasses import dataclass, replace
from functools import cached_property

from neo_ros.baking.keyframes import BakingRules, Photos
from neo_ros.field.grid_points import cells_apart
from neo_ros.field.rendering import world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import (
    contradicted, contradiction, ContradictionThresholds)
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.updating.kernels import ask_witnesses, pinholes, rays_meet_cells
import numpy as np


@dataclass(frozen=True)
class WitnessRules:
    """When photos of before bear out that a new one shows a change."""

    # They see a place if what the memory shows to them is as far away, within this share.
    one_surface: float = 0.05
    # So many have to see it, and no larger share of them may show what the new one shows, within
    # so many grey levels: then the memory is wrong there, and nothing has changed. Of those of an
    # earlier drive nobody asks that: an update has missed it.
    least: int = 2
    most_share: float = 0.2
    grey_levels: float = 15.0
    # Images of which more than this share contradicts are of a pose that is wrong.
    most_contradicted: float = 0.5
    # Edges lie less aside than in a drive: slats and legs would go unseen.
    contradiction: ContradictionThresholds = ContradictionThresholds(aside=1, larger=1)


@dataclass(frozen=True, eq=False)
class EarlierChanges:
    """
    What earlier updates changed in a field, and what photos (P of before, N in all) know of it.

    dates int32 (X, Y, Z): the number of the update that changed a cell last, 0 = none; updates
    int32 (P,): the update whose drive took a photo, 0 = the training's; founders bool (P,): what
    such a photo contradicts is poor in the field, see `Past`; stale bool (N, h, w): what an update
    found out of date.
    """

    field: VoxelField
    dates: np.ndarray
    updates: np.ndarray
    founders: np.ndarray
    stale: np.ndarray

    def through_changes(self, index: int, camera: Intrinsics, pose: CameraPose,
                        depth: np.ndarray) -> np.ndarray:
        """
        Tell which pixels of a photo of before look at, or through, what changed after it.

        depth float32 (h, w), metres along the ray to what is there now, 0 = unknown.
        """
        update = int(self.updates[index])
        if update >= self._last:
            return np.zeros(depth.shape, bool)
        return rays_meet_cells(self.field, self._apart[update], *world_rays(camera, pose),
                               (1 + BakingRules.one_surface) * depth)

    @cached_property
    def _last(self) -> int:
        return int(self.dates.max())

    @cached_property
    def _apart(self) -> dict[int, np.ndarray]:
        """How far cells are from those that changed after an update that took photos."""
        return {update: cells_apart(self.dates > update)
                for update in np.unique(self.updates).tolist() if update < self._last}


@dataclass(frozen=True, eq=False)
class ComparedPhotos:
    """
    Photos (N of them) of one small camera: the first `old` are those of before.

    founders bool (old,): see `EarlierChanges`. gains (N, 3) multiply a photo's colours to the
    memory's; depth float32 (N, h, w), metres along the ray, 0 = unknown, as the memory has it.
    contradicts, agrees bool (N, h, w): the photo shows something else than the memory, or the
    same; of a new photo only what photos of before bear out contradicts, and what they show, too,
    agrees. stale bool (N, h, w): what an update masked, which is not usable, and usable pixels
    that look at, or through, what changed later. Neither has a say; both may be right again.
    """

    photos: Photos
    gains: np.ndarray
    depth: np.ndarray
    contradicts: np.ndarray
    agrees: np.ndarray
    stale: np.ndarray
    old: int
    founders: np.ndarray

    def pose(self, index: int) -> CameraPose:
        """Return where a photo was taken."""
        return CameraPose(self.photos.T_world_cam[index])

    def depth_of_before(self) -> np.ndarray:
        """Return the depth of photos of before, float32 (old, h, w), 0 where they have no say."""
        return np.where(self.stale[:self.old], np.float32(0), self.depth[:self.old])

    def first(self, count: int) -> 'ComparedPhotos':
        """Return the first photos alone."""
        photos = self.photos
        assert photos.usable is not None
        return ComparedPhotos(
            Photos(photos.images[:count], photos.intrinsics, photos.T_world_cam[:count],
                   photos.usable[:count]), self.gains[:count], self.depth[:count],
            self.contradicts[:count], self.agrees[:count], self.stale[:count], self.old,
            self.founders)


def compare(photos: Photos, old: int, memory: SceneMemory, progress: Progress = no_progress,
            rules: WitnessRules = WitnessRules(), elsewhere: int = 0,
            earlier: EarlierChanges | None = None) -> ComparedPhotos:
    """
    Compare photos, of which the first `old` are those that the memory was made of.

    elsewhere: so many, the last ones, are of where it shows nothing; they have no say. earlier:
    None if nothing was ever updated.
    """
    camera, renderer = photos.intrinsics, MemoryRenderer(memory)
    assert photos.usable is not None
    stale = np.zeros_like(photos.usable) if earlier is None else earlier.stale.copy()
    usable = photos.usable & ~stale
    stretch = np.linalg.norm(camera.pixel_rays(), axis=-1).astype(np.float32)
    gains = np.ones((len(photos.images), 3), np.float32)
    depth = np.zeros(usable.shape, np.float32)
    off = np.zeros_like(usable)
    poses = list(map(CameraPose, photos.T_world_cam[:len(photos.images) - elsewhere]))
    # Those near one another one after the other: few keyframes are kept decoded.
    order = sorted(range(len(poses)), key=lambda index: int(
        renderer.nearest(poses[index].position, 1)[0]))
    for done, index in enumerate(order, 1):
        view = renderer.render(poses[index], camera)
        known = (view.depth > 0) & ~view.stretched
        depth[index] = np.where(known & photos.usable[index], view.depth * stretch, 0)
        if earlier is not None and index < old:
            stale[index] |= earlier.through_changes(index, camera, poses[index], depth[index])
        known &= usable[index] & ~stale[index]
        now = photos.images[index].astype(np.float32)
        if known.any():
            gains[index] = exposure_gain(now[known], view.image[known])
        score = contradiction(now * gains[index], view.image, known, rules.contradiction)
        off[index] = contradicted(score, rules.contradiction) & known
        if off[index].sum() > rules.most_contradicted * known.sum():
            depth[index], off[index], usable[index], stale[index] = 0, False, False, False
        progress(done, len(poses))
    compared = ComparedPhotos(replace(photos, usable=usable), gains, depth, off,
                              (depth > 0) & ~off & ~stale, stale, old,
                              np.ones(old, bool) if earlier is None else earlier.founders)
    known_depth = compared.depth_of_before()
    for index in range(old, len(poses)):
        _ask_photos_of_before(compared, index, known_depth, rules)
    return compared


def _ask_photos_of_before(compared: ComparedPhotos, index: int, depth: np.ndarray,
                          rules: WitnessRules) -> None:
    """Let what a new photo contradicts stand only where they bear it out, by their depth."""
    photos, old, camera = compared.photos, slice(compared.old), compared.photos.intrinsics
    off, pose = compared.contradicts[index], compared.pose(index)
    origin, rays = world_rays(camera, pose)
    points = origin + compared.depth[index][off][:, None] * rays[off]
    witnesses, founders, same = np.zeros((3, len(points)), np.int32)
    ask_witnesses(points.astype(np.float32), photos.images[index][off] * compared.gains[index],
                  pinholes(camera, photos.T_world_cam[old]), depth, photos.images[old],
                  compared.gains[old], compared.founders, np.float32(rules.one_surface),
                  np.float32(rules.grey_levels), witnesses, founders, same)
    known = same > rules.most_share * founders
    compared.agrees[index][off] = known
    compared.contradicts[index][off] = ~known & (witnesses >= rules.least)
