"""
LPIPS for the whole image, the ring and the seam; the measure lies in `outpaint/perceptual.py`.

This is the one file of `evaluation/` that needs torch: import it lazily.
"""
from neo_ros.evaluation.metrics import check_pair, left_out_alike, PARTS, scored_parts
from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.perceptual import (
    cache_folder, fetch_weights, PerceptualDistance, read_weights)
import numpy as np
import torch
from torch.nn.functional import interpolate

__all__ = ['Lpips', 'cache_folder', 'fetch_weights', 'read_weights']


class Lpips(PerceptualDistance):
    """
    Learned perceptual distance of two images; 0 for equal ones, larger is worse.

    backbone  'vgg' (as in the paper's tables) or 'alex'
    folder    where the weight files lie; None means the cache, filled on first use

    Calling it with (truth, prediction, expansion) scores a frame, as `score_frame` does.
    """

    def forward(self, truth: np.ndarray, prediction: np.ndarray, expansion: ViewExpansion,
                usable: np.ndarray | None = None) -> dict[str, float]:
        """
        Score a wide image (H, W, 3) RGB uint8 against the truth, where that is usable.

        Returns whole_lpips_<backbone>, the published measure, and ring_lpips_<backbone> and
        seam_lpips_<backbone>: the layers' maps brought to full size (bilinear), summed, averaged
        over the ring and the seam of `score_frame`. With `usable`, bool (H, W), the whole one is
        averaged likewise over what is usable.
        """
        check_pair(truth, prediction, expansion)
        if usable is not None:
            prediction = left_out_alike(truth, prediction, usable)
        with torch.inference_mode():
            maps = self.distances_BCHW(self._as_input(truth), self._as_input(prediction))
            whole = sum(float(layer.mean()) for layer in maps)
            full = torch.cat([interpolate(layer, truth.shape[:2], mode='bilinear')
                              for layer in maps]).sum(0)
        distance = full[0].cpu().numpy()
        scores = {f'{name}_lpips_{self.backbone}': float(distance[part].mean())
                  for name, part in zip(PARTS, scored_parts(expansion, usable)) if part.any()}
        return scores if usable is not None else {
            **scores, f'whole_lpips_{self.backbone}': whole}

    def _as_input(self, image: np.ndarray) -> torch.Tensor:
        pixels = torch.from_numpy(np.ascontiguousarray(image)).to(self.shift.device)
        return pixels.permute(2, 0, 1)[None].float() / 127.5 - 1
