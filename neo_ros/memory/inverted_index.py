"""
What looks like a descriptor, without looking at all that there is.

An inverted file (Sivic and Zisserman, 2003) over a vocabulary of two levels (Nister and Stewenius,
2006): words are some of the descriptors, chosen by a seed, and each one is in the list of the word
that it is most like. There are about as many lists as descriptors in one: what a search looks at
grows with the root of the scene.
"""
import math

from neo_ros.memory.inverted_kernels import greatest, nearest_in_lists
import numpy as np


class InvertedIndex:
    """Descriptors uint8 (P, D), D <= 256, of about one length, by how alike they are."""

    def __init__(self, codes: np.ndarray) -> None:
        self._codes = np.ascontiguousarray(codes)
        random, count = np.random.default_rng(0), len(codes)
        wide = max(round(math.sqrt(2 * math.sqrt(count))), 1)
        group_of = _most_alike(codes, _chosen(codes, wide, random))
        words, list_of = list[np.ndarray](), np.empty(count, np.int64)
        for group in range(wide):
            own = np.flatnonzero(group_of == group)
            if len(own):
                here = _chosen(codes[own], wide, random)
                list_of[own] = sum(map(len, words)) + _most_alike(codes[own], here)
                words.append(here)
        self._words = np.concatenate(words)
        self._numbers = np.argsort(list_of, kind='stable').astype(np.int32)
        self._starts = np.searchsorted(list_of[self._numbers], np.arange(len(self._words) + 1))

    def nearest(self, queries: np.ndarray, lists: int, most: int
                ) -> tuple[np.ndarray, np.ndarray]:
        """
        Find what queries, uint8 (N, D), are like, in so many lists each.

        Returns numbers int32 (N, most), the most alike first, -1 = none, and the dot products.
        """
        alike = queries.astype(np.float32) @ self._words.T
        chosen = np.full((len(queries), min(lists, alike.shape[1])), -1)
        greatest(alike, chosen)
        found = np.full((len(queries), most), -1, np.int32)
        likeness = np.full((len(queries), most), -1, np.int32)
        asking = np.argsort(chosen, axis=None, kind='stable')
        bounds = np.searchsorted(chosen.reshape(-1)[asking], np.arange(len(self._words) + 1))
        nearest_in_lists(queries.astype(np.int16), asking // chosen.shape[1], bounds,
                         self._starts, self._numbers, self._codes, found, likeness)
        return found, likeness


def _chosen(codes: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """Choose some descriptors, float32 (count, D), or all if there are fewer."""
    chosen = random.choice(len(codes), min(count, len(codes)), replace=False)
    return codes[np.sort(chosen)].astype(np.float32)


def _most_alike(codes: np.ndarray, words: np.ndarray) -> np.ndarray:
    """Return the word that each descriptor is most like, int64 (P,); some at a time."""
    return np.concatenate([
        (codes[start:start + 65536].astype(np.float32) @ words.T).argmax(1)
        for start in range(0, len(codes), 65536)])
