"""How sharp a picture is, and which pictures are blurred among their own kind."""
import cv2
import numpy as np

BLUR_DEVIATIONS = 3.0
SHARPNESS_FLOOR = 1e-3
# Of a blurred photo: it may be the only one that saw a place.
LEAST_WEIGHT = 0.05


def sharpness(image: np.ndarray) -> float:
    """Return the variance of the Laplacian of an RGB uint8 (H, W, 3) image's brightness."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return float(cv2.Laplacian(grey, cv2.CV_32F).var())


def relative_sharpness(image: np.ndarray) -> float:
    """Return the sharpness over the variance of the brightness: dusk is no blur."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return sharpness(image) / max(float(grey.var()), 1.0)


def sharpness_weights(values: np.ndarray, around: int = 5) -> np.ndarray:
    """
    Return how sharp photos are beside those around them in the list, (N,) in (0, 1].

    values (N,): their sharpness. Compared with the median of `around` before and after, as another
    place has other edges; those that are sharper than it count 1.
    """
    usual = np.array([np.median(values[max(index - around, 0):index + around + 1])
                      for index in range(len(values))])
    return np.clip(values / np.maximum(usual, SHARPNESS_FLOOR), LEAST_WEIGHT, 1)


def blur_threshold(values: np.ndarray) -> float:
    """
    Return the sharpness below which a photo is an outlier among its own kind.

    Three robust standard deviations (median absolute deviation) below the median of the
    logarithms: a textureless room is not blurred as a whole.
    """
    logarithms = np.log(np.maximum(values, SHARPNESS_FLOOR))
    median = np.median(logarithms)
    if median <= np.log(SHARPNESS_FLOOR):
        return 0.0  # photos of nothing
    deviation = 1.4826 * np.median(np.abs(logarithms - median))
    # Photos that are nearly alike would otherwise turn tiny differences into outliers.
    return float(np.exp(median - BLUR_DEVIATIONS * max(deviation, 0.2)))
