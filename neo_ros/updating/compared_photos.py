"""Photos of before and new ones, compared with what the memory shows where they were taken."""
from dataclasses import dataclass, replace

from neo_ros.baking.keyframes import Photos
from neo_ros.field.rendering import world_rays
from neo_ros.geometry import CameraPose
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.contradiction import (
    contradicted, contradiction, ContradictionThresholds)
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.pictures.exposure import exposure_gain
from neo_ros.updating.kernels import ask_witnesses, pinholes
import numpy as np


@dataclass(frozen=True)
class WitnessRules:
    """When photos of before bear out that a new one shows a change."""

    # They see a place if what the memory shows to them is as far away, within this share.
    one_surface: float = 0.05
    # So many have to see it, and no larger share of them may show what the new one shows, within
    # so many grey levels: then the memory is wrong there, and nothing has changed.
    least: int = 2
    most_share: float = 0.2
    grey_levels: float = 15.0
    # Images of which more than this share contradicts are of a pose that is wrong.
    most_contradicted: float = 0.5
    # Edges lie less aside than in a drive: slats and legs would go unseen.
    contradiction: ContradictionThresholds = ContradictionThresholds(aside=1, larger=1)


@dataclass(frozen=True, eq=False)
class ComparedPhotos:
    """
    Photos (N of them) of one small camera: the first `old` are those of before.

    gains (N, 3) multiply a photo's colours to the memory's; depth float32 (N, h, w), metres along
    the ray, 0 = unknown, as the memory has it. contradicts, agrees bool (N, h, w): the photo shows
    something else than the memory, or the same; of a new photo only what photos of before bear
    out contradicts, and what they show, too, agrees.
    """

    photos: Photos
    gains: np.ndarray
    depth: np.ndarray
    contradicts: np.ndarray
    agrees: np.ndarray
    old: int

    def pose(self, index: int) -> CameraPose:
        """Return where a photo was taken."""
        return CameraPose(self.photos.T_world_cam[index])

    def first(self, count: int) -> 'ComparedPhotos':
        """Return the first photos alone."""
        photos = self.photos
        assert photos.usable is not None
        return ComparedPhotos(
            Photos(photos.images[:count], photos.intrinsics, photos.T_world_cam[:count],
                   photos.usable[:count]), self.gains[:count], self.depth[:count],
            self.contradicts[:count], self.agrees[:count], self.old)


def compare(photos: Photos, old: int, memory: SceneMemory, progress: Progress = no_progress,
            rules: WitnessRules = WitnessRules(), elsewhere: int = 0) -> ComparedPhotos:
    """
    Compare photos, of which the first `old` are those that the memory was made of.

    elsewhere: so many, the last ones, are of where it shows nothing; they have no say.
    """
    camera, renderer = photos.intrinsics, MemoryRenderer(memory)
    assert photos.usable is not None
    usable = photos.usable.copy()
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
        known = (view.depth > 0) & ~view.stretched & usable[index]
        depth[index] = np.where(known, view.depth * stretch, 0)
        now = photos.images[index].astype(np.float32)
        if known.any():
            gains[index] = exposure_gain(now[known], view.image[known])
        score = contradiction(now * gains[index], view.image, known, rules.contradiction)
        off[index] = contradicted(score, rules.contradiction) & known
        if off[index].sum() > rules.most_contradicted * known.sum():
            depth[index], off[index], usable[index] = 0, False, False
        progress(done, len(poses))
    compared = ComparedPhotos(replace(photos, usable=usable), gains, depth, off,
                              (depth > 0) & ~off, old)
    for index in range(old, len(poses)):
        _ask_photos_of_before(compared, index, rules)
    return compared


def _ask_photos_of_before(compared: ComparedPhotos, index: int, rules: WitnessRules) -> None:
    """Let what a new photo contradicts stand only where they bear it out."""
    photos, old, camera = compared.photos, slice(compared.old), compared.photos.intrinsics
    off, pose = compared.contradicts[index], compared.pose(index)
    origin, rays = world_rays(camera, pose)
    points = origin + compared.depth[index][off][:, None] * rays[off]
    witnesses, same = np.zeros((2, len(points)), np.int32)
    ask_witnesses(points.astype(np.float32), photos.images[index][off] * compared.gains[index],
                  pinholes(camera, photos.T_world_cam[old]), compared.depth[old],
                  photos.images[old], compared.gains[old], np.float32(rules.one_surface),
                  np.float32(rules.grey_levels), witnesses, same)
    known = same > rules.most_share * witnesses
    compared.agrees[index][off] = known
    compared.contradicts[index][off] = ~known & (witnesses >= rules.least)
