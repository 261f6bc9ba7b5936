"""
The features of a scene's photos, and which photos look like an image: what B2 and B3 stand on.

VLAD (Jegou et al., 2010) over the scene's own photos stands in for the paper's NetVLAD, whose
weights are not to be had from a package index.
"""
from collections.abc import Sequence
import io
from pathlib import Path
from zipfile import BadZipFile

from neo_ros.errors import SceneError
from neo_ros.machine.files import write_bytes
from neo_ros.machine.progress import no_progress, Progress
from neo_ros.memory.local_features import Features, find_features, MAGNIFY
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

WORDS = 32        # of VLAD
_SAMPLE = 60_000  # descriptors that the words are learnt from


class PhotoBank:
    """
    The features of all photos of a scene, with one VLAD vector each.

    photos    as they were given; scale is the resolution the features were found at
    features  one Features per photo, in pixels at that resolution
    magnify   how many times photos were enlarged, or shrunk, before features were looked for
    """

    def __init__(self, photos: PosedImages, scale: float, features: Sequence[Features],
                 magnify: float = MAGNIFY) -> None:
        self.photos, self.scale, self.features = photos, scale, features
        self.magnify = magnify
        self.words = _learn_words(np.concatenate([one.descriptors for one in features]))
        self.vectors = np.stack([_vlad(one, self.words) for one in features])

    @property
    def megabytes(self) -> float:
        """Size of what retrieval and matching need at run time, as it lies on the disk."""
        return sum(one.points.nbytes + one.descriptors.nbytes / 2 for one in self.features) / 1e6

    def nearest(self, image_features: Features, count: int) -> np.ndarray:
        """Return the indices of the photos that look most like an image, best first."""
        likeness = self.vectors @ _vlad(image_features, self.words)
        return np.argsort(-likeness, kind='stable')[:count]


def read_photo_bank(photos: PosedImages, scale: float, cache: Path,
                    progress: Progress = no_progress,
                    magnify: float = MAGNIFY) -> PhotoBank:
    """
    Find the features of all photos at `scale`, or read them from the file `cache`.

    What a mask leaves out has none.
    """
    try:
        with np.load(cache) as stored:
            counts, points = stored['counts'], stored['points']
            descriptors = stored['descriptors'].astype(np.float32)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        found = []
        for index in range(len(photos)):
            features = find_features(photos.read_image(index, scale), magnify)
            found.append(_of_scene(features, photos.read_usable(index, scale)))
            progress(index + 1, len(photos))
        counts = np.array([len(one.points) for one in found])
        points = np.concatenate([one.points for one in found])
        descriptors = np.concatenate([one.descriptors for one in found])
        content = io.BytesIO()
        np.savez(content, counts=counts, points=points, descriptors=descriptors.astype(np.float16))
        write_bytes(cache, content.getvalue())
        descriptors = descriptors.astype(np.float16).astype(np.float32)
    if not len(points):
        raise SceneError('photos: expected some with texture, none has a SIFT feature')
    ends = np.cumsum(counts)[:-1]
    return PhotoBank(photos, scale, [
        Features(*pair) for pair in zip(np.split(points, ends), np.split(descriptors, ends))],
        magnify)


def likeness_of(features: Sequence[Features]) -> np.ndarray:
    """Return how much images (N) with these features look like one another, float32 (N, N)."""
    words = _learn_words(np.concatenate([one.descriptors for one in features]))
    vectors = np.stack([_vlad(one, words) for one in features])
    return vectors @ vectors.T


def _vlad(features: Features, words: np.ndarray) -> np.ndarray:
    """Sum the residuals to the nearest words, each word's sum brought to length 1."""
    vector = np.zeros_like(words)
    if len(features.descriptors):
        word = _nearest_word(features.descriptors, words)
        np.add.at(vector, word, features.descriptors - words[word])
    vector /= np.maximum(np.linalg.norm(vector, axis=1, keepdims=True), 1e-6)
    return (vector / max(float(np.linalg.norm(vector)), 1e-6)).ravel()


def _of_scene(features: Features, usable: np.ndarray | None) -> Features:
    """Keep the features on pixels that show the scene."""
    if usable is None:
        return features
    column, row = features.points.astype(int).T
    kept = usable[np.minimum(row, usable.shape[0] - 1), np.minimum(column, usable.shape[1] - 1)]
    return Features(features.points[kept], features.descriptors[kept])


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
