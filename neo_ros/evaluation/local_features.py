"""
Local features of a scene's photos, and which photos look like an image: what B2 and B3 stand on.

RootSIFT (Arandjelovic and Zisserman, 2012) on images enlarged twice, and VLAD (Jegou et al.,
2010) over the scene's own photos. VLAD stands in for the paper's NetVLAD, whose weights are not
to be had from a package index.
"""
from pathlib import Path
from typing import Callable, NamedTuple, Sequence
from zipfile import BadZipFile

import cv2
from neo_ros.paths import whole_file
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

MAGNIFY = 2       # small images have few features: twice as large they have five times as many
CONTRAST = 0.01   # SIFT's threshold; walls of rooms are faint
MOST_FEATURES = 1024
WORDS = 32        # of VLAD
_SAMPLE = 60_000  # descriptors that the words are learnt from


class Features(NamedTuple):
    """
    Where the features of an image are and what they look like.

    points       float32 (N, 2), pixels of the image, top-left corner (0, 0)
    descriptors  float32 (N, 128), RootSIFT of length 1
    """

    points: np.ndarray
    descriptors: np.ndarray


def find_features(image: np.ndarray, most: int = MOST_FEATURES) -> Features:
    """Find the `most` strongest features of an RGB uint8 image (H, W, 3)."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    large = cv2.resize(grey, None, fx=MAGNIFY, fy=MAGNIFY, interpolation=cv2.INTER_CUBIC)
    found, descriptors = cv2.SIFT.create(
        most, contrastThreshold=CONTRAST, edgeThreshold=15).detectAndCompute(large, None)
    if descriptors is None:
        return Features(np.zeros((0, 2), np.float32), np.zeros((0, 128), np.float32))
    # OpenCV counts from the centre of the first pixel.
    points = (np.array([one.pt for one in found], np.float32) + 0.5) / MAGNIFY
    # SIFT keeps ties beyond `most`.
    points, descriptors = points[:most], descriptors[:most]
    share = descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-6)
    return Features(points, np.sqrt(share).astype(np.float32))


def match_features(first: np.ndarray, second: np.ndarray, ratio: float) -> np.ndarray:
    """
    Pair descriptors (N, 128) and (M, 128) that are each other's nearest: int64 (K, 2).

    The nearest must be closer than `ratio` times the second nearest (Lowe, 2004).
    """
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), np.int64)
    likeness = first @ second.T
    rows = np.arange(len(first))
    best = likeness.argmax(1)
    nearest = likeness[rows, best]
    likeness[rows, best] = -1
    runner_up = likeness.max(1)
    likeness[rows, best] = nearest
    # The squared distance of unit vectors is 2 - 2 * likeness.
    distance, further = np.maximum(2 - 2 * nearest, 0), np.maximum(2 - 2 * runner_up, 0)
    # Two that are the same but for rounding are not told apart.
    kept = np.flatnonzero(distance < ratio ** 2 * further - 1e-6)
    # Few are left whose own nearest is to be found, down the columns, which is slow.
    kept = kept[likeness[:, best[kept]].argmax(0) == kept]
    return np.stack([kept, best[kept]], 1)


class PhotoBank:
    """
    The features of all photos of a scene, with one VLAD vector each.

    photos    as they were given; scale is the resolution the features were found at
    features  one Features per photo, in pixels at that resolution
    """

    def __init__(self, photos: PosedImages, scale: float, features: Sequence[Features]) -> None:
        self.photos, self.scale, self.features = photos, scale, features
        self.words = _learn_words(np.concatenate([one.descriptors for one in features]))
        self.vectors = np.stack([self._vlad(one) for one in features])

    @property
    def megabytes(self) -> float:
        """Size of what retrieval and matching need at run time, as it lies on the disk."""
        return sum(one.points.nbytes + one.descriptors.nbytes / 2 for one in self.features) / 1e6

    def nearest(self, image_features: Features, count: int) -> np.ndarray:
        """Return the indices of the photos that look most like an image, best first."""
        likeness = self.vectors @ self._vlad(image_features)
        return np.argsort(-likeness, kind='stable')[:count]

    def _vlad(self, features: Features) -> np.ndarray:
        """Sum the residuals to the nearest words, each word's sum brought to length 1."""
        vector = np.zeros_like(self.words)
        if len(features.descriptors):
            word = _nearest_word(features.descriptors, self.words)
            np.add.at(vector, word, features.descriptors - self.words[word])
        vector /= np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-6)
        return (vector / max(float(np.linalg.norm(vector)), 1e-6)).ravel()


def read_photo_bank(photos: PosedImages, scale: float, cache: Path,
                    progress: Callable[[int, int], None] = lambda done, total: None) -> PhotoBank:
    """Find the features of all photos at `scale`, or read them from the file `cache`."""
    try:
        with np.load(cache) as stored:
            counts, points = stored['counts'], stored['points']
            descriptors = stored['descriptors'].astype(np.float32)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        found = []
        for index in range(len(photos)):
            found.append(find_features(photos.read_image(index, scale)))
            progress(index + 1, len(photos))
        counts = np.array([len(one.points) for one in found])
        points = np.concatenate([one.points for one in found])
        descriptors = np.concatenate([one.descriptors for one in found])
        cache.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(cache) as partial, partial.open('wb') as file:
            np.savez(file, counts=counts, points=points,
                     descriptors=descriptors.astype(np.float16))
        descriptors = descriptors.astype(np.float16).astype(np.float32)
    ends = np.cumsum(counts)[:-1]
    return PhotoBank(photos, scale, [
        Features(*pair) for pair in zip(np.split(points, ends), np.split(descriptors, ends))])


def _learn_words(descriptors: np.ndarray) -> np.ndarray:
    """Cluster descriptors (k-means, seeded): float32 (WORDS, 128)."""
    random = np.random.default_rng(0)
    if len(descriptors) > _SAMPLE:
        descriptors = descriptors[random.choice(len(descriptors), _SAMPLE, replace=False)]
    words = descriptors[random.choice(len(descriptors), min(WORDS, len(descriptors)),
                                      replace=False)].copy()
    for _ in range(15):
        word = _nearest_word(descriptors, words)
        for index in range(len(words)):
            own = descriptors[word == index]
            if len(own):
                words[index] = own.mean(0)
    return words


def _nearest_word(descriptors: np.ndarray, words: np.ndarray) -> np.ndarray:
    return (descriptors @ words.T - 0.5 * (words ** 2).sum(1)).argmax(1)
