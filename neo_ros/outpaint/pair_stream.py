"""Narrow/wide training pairs, rendered on the fly."""
from dataclasses import dataclass

from neo_ros.field.panorama import panorama_size
from neo_ros.field.radiance_field import RadianceField
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.panorama_cache import PanoramaCache
from neo_ros.outpaint.panorama_pool import PanoramaPool
from neo_ros.outpaint.real_centres import RealCentres
from neo_ros.scenes.pose_sampling import PoseSampler
import numpy as np
import torch


@dataclass(frozen=True)
class StreamRules:
    """How fast the stream grows; chosen by measuring."""

    first: int = 32                    # panoramas of the first batch: its views do not repeat
    first_photos: int = 16
    # Steps until there is one more: rendering at every step would take as long as learning.
    steps_per_photo: int = 4
    least_steps_per_panorama: int = 4


class PairStream:
    """
    An endless, seeded stream of wide views; the narrow view is their central window.

    Panoramas are rendered one at a time as training goes on and kept, up to `positions`;
    every batch draws new orientations at the positions that are there. Batch n is the same
    whether the training ran through or was broken off and resumed. A share of the views,
    `real_share`, has a real photo in its middle. Nothing is written to disk but the panoramas,
    where there is a cache for them.
    """

    def __init__(self, field: RadianceField, sampler: PoseSampler, view: Intrinsics,
                 positions: int, seed: int, real: RealCentres | None = None,
                 real_share: float = 0.0, cache: PanoramaCache | None = None,
                 rules: StreamRules = StreamRules()) -> None:
        self.seed, self.rules = seed, rules
        self.pool = PanoramaPool(field, sampler, view, positions, seed, cache)
        self.real, self.real_share = real, real_share
        # As many as wide views have a panorama's rays: 3 on a level floor, 30 for a narrow camera
        # that is held in the hand.
        height, width = panorama_size(view, self.pool.band)
        self.steps_per_panorama = max(round(height * width / (view.width * view.height)),
                                      rules.least_steps_per_panorama)
        self.real_order = np.random.default_rng([seed, 5]).permutation(len(real) if real else 0)

    def batch(self, step: int, size: int) -> torch.Tensor:
        """
        Return batch `step`: RGBA uint8 (size, H, W, 4); A is coverage, 255 = seen.

        It is on the field's device.
        """
        ready = self.render_for(step)
        random = np.random.default_rng([self.seed, 2, step])
        rules = self.rules
        photos = self.real_order[:rules.first_photos + step // rules.steps_per_photo]
        views = []
        for shows_photo in random.random(size) < self.real_share:
            if shows_photo and self.real is not None:
                view = torch.from_numpy(self.real.view(int(random.choice(photos))))
                views.append(view.to(self.pool.device))
            else:
                views.append(self.pool.draw_view(int(random.integers(ready)), random))
        return torch.stack(views)

    def render_for(self, step: int) -> int:
        """Render the panoramas that batch `step` draws from; returns how many they are."""
        return self.pool.fill(self.rules.first + step // self.steps_per_panorama)


def source_view_enlarged(expansion: ViewExpansion) -> Intrinsics:
    """
    Return the source view's largest window of the target's shape, at the target's size.

    What a network can be trained on where nothing wider than the photos is rendered: the
    paper's ablation of the extended field of view.
    """
    source, target = expansion.source, expansion.target
    shrink = min(source.width / target.width, source.height / target.height)
    left = (source.width - shrink * target.width) / 2
    top = (source.height - shrink * target.height) / 2
    return Intrinsics(target.width, target.height, source.fx / shrink, source.fy / shrink,
                      (source.cx - left) / shrink, (source.cy - top) / shrink)
