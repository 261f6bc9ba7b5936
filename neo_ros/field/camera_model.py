"""What a camera makes of the field's colours: exposure of each photo, falloff of the lens."""
from typing import Any

from neo_ros.field.config import FieldConfig
from neo_ros.geometry import Intrinsics
from neo_ros.pictures.sharpness import relative_sharpness, sharpness_weights
import numpy as np

# Of descent on the logarithms of the photos' gains, and on the falloff of the lens.
GAIN_RATE, FALLOFF_RATE = 0.05, 0.2
# Gains that fall to less than this share while the field gets finer stood for its errors.
STAY = 0.9


class CameraModel:
    """
    Gains of N photos, which are fitted with the field; which parts are is in the settings.

    log_gain  float32 (N, 3), their mean is 0
    learns    whether gains are learnt: if the settings leave it open, until they prove to be none
    falloff   float32 (2,): logarithm of what is left in a corner, by distance squared and to the
              fourth
    away      float32 (H, W): squared distance of pixels from the optical axis, 1 in the corner
    """

    def __init__(self, photos: int, intrinsics: Intrinsics, config: FieldConfig) -> None:
        self.config, self.learns = config, config.exposure is not False
        self._spread = 0.0
        self.log_gain = np.zeros((photos, 3), np.float32)
        self.falloff = np.zeros(2, np.float32)
        away = (intrinsics.pixel_rays()[..., :2] ** 2).sum(-1)
        self.away = (away / away.max()).astype(np.float32)

    def gains(self, photo: np.ndarray, away: np.ndarray) -> np.ndarray:
        """Return what takes the field's colours to those of pixels, float32 (P, 3)."""
        falloff = self.falloff[0] * away + self.falloff[1] * away ** 2
        return np.exp(self.log_gain[photo] + falloff[:, None])

    def learn(self, photo: np.ndarray, away: np.ndarray, d_log_gain: np.ndarray) -> None:
        """Descend, where the loss of pixels (P,) has the slope d_log_gain (P, 3)."""
        if self.config.vignetting:
            slope = d_log_gain.sum(1)
            self.falloff -= FALLOFF_RATE * np.array(
                [(slope * away).mean(), (slope * away ** 2).mean()], np.float32)
        if self.learns:
            total = np.zeros_like(self.log_gain)
            np.add.at(total, photo, d_log_gain)
            seen = np.bincount(photo, minlength=len(self.log_gain))[:, None]
            self.log_gain -= GAIN_RATE * total / np.maximum(seen, 1)
            # The field keeps its colour.
            self.log_gain -= self.log_gain.mean(0)

    def refined(self, last: bool) -> None:
        """
        Judge gains when the field gets finer; the last time those that fell are given up.

        A coarse field is wrong otherwise in each photo, and gains make up for a part of that: the
        finer it gets, the less. A camera's own gains stay, or come to light.
        """
        spread = float(np.sqrt(np.mean(self.log_gain ** 2)))
        if self.config.exposure is None and last and spread < STAY * self._spread:
            self.learns, self.log_gain = False, np.zeros_like(self.log_gain)
        self._spread = spread

    def state(self) -> dict[str, Any]:
        """Return what `restore` needs."""
        return {'log_gain': self.log_gain, 'falloff': self.falloff,
                'learns': np.array(self.learns), 'spread': np.array(self._spread)}

    def restore(self, arrays: dict[str, np.ndarray]) -> None:
        """Go on from `state`; one of before there was a falloff, or a choice, has none."""
        self.log_gain = arrays['log_gain']
        self.falloff = arrays.get('falloff', self.falloff)
        self.learns = bool(arrays.get('learns', self.config.exposure))
        self._spread = float(arrays.get('spread', 0.0))


def photo_shares(images: np.ndarray, sharpness: float) -> np.ndarray | None:
    """Return how often pixels of photos (N, H, W, 3) are drawn, (N,); None: all alike."""
    if not sharpness:
        return None
    weights = sharpness_weights(np.array([
        relative_sharpness(image) for image in images])) ** sharpness
    return weights / weights.sum()
