"""How much brighter one picture of a place is than another."""
import numpy as np

# An image may be so many times brighter or darker than another.
MOST_GAIN = 4.0
# What has this grey level or more may have been clipped, and does not tell by how much.
CLIPPED = 248


def exposure_gain(shown: np.ndarray, observed: np.ndarray) -> np.ndarray:
    """
    Return the gains float32 (C,) that take colours `shown` to `observed`, (..., C) in 0 ... 255.

    Of all gains it leaves the least sum of absolute differences, as the median of the ratios does
    when bright pixels count more: neither an occluder nor misplaced edges move it much.
    """
    channels = shown.shape[-1]
    gain = np.ones(channels, np.float32)
    for channel, (x, y) in enumerate(zip(shown.reshape(-1, channels).T,
                                         observed.reshape(-1, channels).T)):
        usable = (x > 0) & (y < CLIPPED)
        if usable.any():
            ratio, weight = y[usable] / x[usable], x[usable]
            order = np.argsort(ratio)
            below = np.cumsum(weight[order])
            gain[channel] = ratio[order[np.searchsorted(below, below[-1] / 2)]]
    return np.clip(gain, 1 / MOST_GAIN, MOST_GAIN)
