"""Narrow/wide training pairs, rendered on the fly; nothing is written to disk."""
from neo_ros.errors import SceneError
from neo_ros.field.panorama import Panorama, render_panorama, view_band
from neo_ros.field.voxel_field import RadianceField
from neo_ros.geometry import Intrinsics
from neo_ros.scenes.pose_sampling import PoseSampler
import numpy as np

# Panoramas there must be before the first batch, so that its views do not repeat.
FIRST = 32
# A view of which no photo saw even half teaches little. A position with hardly any other view
# lies inside matter or outside the scene.
LEAST_COVERAGE = 0.5
LEAST_GOOD_VIEWS = 0.2
TRIES = 200


class PairStream:
    """
    An endless, seeded stream of wide views; the narrow view is their central window.

    Panoramas are rendered one at a time as training goes on and kept, up to `positions`;
    every batch draws new orientations at the positions that are there. Batch n is the same
    whether the training ran through or was broken off and resumed.
    """

    def __init__(self, field: RadianceField, sampler: PoseSampler, view: Intrinsics,
                 positions: int, seed: int) -> None:
        self.field, self.sampler, self.view = field, sampler, view
        self.positions, self.seed = positions, seed
        self.panoramas: list[Panorama] = []
        self.refused = 0
        random = np.random.default_rng([seed, 0])
        self.band = view_band(
            view, np.stack([sampler.draw_rotation(random) for _ in range(500)]),
            sampler.yaw_range)
        self.position_random = np.random.default_rng([seed, 1])
        self.glance_rotations = [sampler.draw_rotation(random) for _ in range(20)]

    def add_position(self) -> None:
        """Render one more panorama, of a place that is in the scene."""
        glance = self.view.scaled(16 / self.view.width)
        for _ in range(TRIES):
            panorama = render_panorama(
                self.field, self.sampler.draw_position(self.position_random), self.view,
                self.band)
            good = [covered(panorama.cut_view(glance, rotation))
                    for rotation in self.glance_rotations]
            if np.mean(good) >= LEAST_GOOD_VIEWS:
                self.panoramas.append(panorama)
                return
            self.refused += 1
        raise SceneError(
            f'pair stream: {TRIES} positions in a row show nothing that a photo saw; '
            'does the floor map belong to this scene?')

    def batch(self, step: int, size: int) -> np.ndarray:
        """Return batch `step`: RGBA uint8 (size, H, W, 4); A is coverage, 255 = seen."""
        ready = min(FIRST + step, self.positions)
        while len(self.panoramas) < ready:
            self.add_position()
        random = np.random.default_rng([self.seed, 2, step])
        return np.stack([self._draw_view(self.panoramas[index], random)
                         for index in random.integers(ready, size=size)])

    def _draw_view(self, panorama: Panorama, random: np.random.Generator) -> np.ndarray:
        for _ in range(TRIES):
            view = panorama.cut_view(self.view, self.sampler.draw_rotation(random))
            if covered(view):
                break
        return view


def covered(view: np.ndarray) -> bool:
    """Tell whether photos saw enough of an RGBA view (H, W, 4) to learn from it."""
    return bool(view[..., 3].mean() > 255 * LEAST_COVERAGE)
