"""How much brighter one picture of a place is than another."""
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ExposureThresholds:
    """What gains are believed, and of which grey levels they are told."""

    # An image may be so many times brighter or darker than another.
    most_gain: float = 4.0
    # What has this grey level or more may have been clipped, and does not tell by how much.
    clipped: int = 248


def exposure_gain(shown: np.ndarray, observed: np.ndarray,
                  thresholds: ExposureThresholds = ExposureThresholds()) -> np.ndarray:
    """
    Return the gains float32 (C,) that take colours `shown` to `observed`, (..., C) in 0 ... 255.

    The gain is the weighted median of the ratios, which leaves the least sum of absolute
    differences: neither an occluder nor misplaced edges move it much.
    """
    channels = shown.shape[-1]
    gain = np.ones(channels, np.float32)
    for channel, (x, y) in enumerate(zip(shown.reshape(-1, channels).T,
                                         observed.reshape(-1, channels).T)):
        usable = (x > 0) & (y < thresholds.clipped)
        if usable.any():
            ratio, weight = y[usable] / x[usable], x[usable]
            order = np.argsort(ratio)
            below = np.cumsum(weight[order])
            gain[channel] = ratio[order[np.searchsorted(below, below[-1] / 2)]]
    return np.clip(gain, 1 / thresholds.most_gain, thresholds.most_gain)
