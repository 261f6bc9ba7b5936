"""Keyframes that are kept decoded, and those that are decoded before they are needed."""
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from neo_ros.memory.keyframe import Keyframe

# What is kept: as many as fit into so many bytes, but at least all that are drawn.
CACHED_BYTES = 256 << 20
LEAST_CACHED = 3


class DecodedKeyframes:
    """Keyframes of one size by their number; the ones used last are kept. For one thread."""

    def __init__(self, most_bytes: int | None = None) -> None:
        self._most_bytes = CACHED_BYTES if most_bytes is None else most_bytes
        # The last one used is the last. An lru_cache of a method would keep the memory alive, as
        # would a method that decodes.
        self._kept: dict[int, Future[Keyframe]] = {}
        self._most = LEAST_CACHED
        self._other: ThreadPoolExecutor | None = None

    def get(self, index: int, decode: Callable[[], Keyframe]) -> Keyframe:
        """Return a keyframe; what is not there is decoded now. Raises what `decode` raises."""
        kept = self._kept.pop(index, None)
        if kept is None:
            kept = Future()
            kept.set_result(decode())
        found = kept.result()
        self._most = max(
            LEAST_CACHED, self._most_bytes // (found.depth.nbytes + found.texture.nbytes))
        self._keep(index, kept)
        return found

    def ahead(self, index: int, decode: Callable[[], Keyframe]) -> None:
        """Let another thread decode a keyframe, if there is room beside those that are drawn."""
        if index in self._kept or self._most <= 2 * LEAST_CACHED:
            return
        self._other = self._other or ThreadPoolExecutor(1, 'keyframes')
        self._keep(index, self._other.submit(decode))

    def _keep(self, index: int, kept: 'Future[Keyframe]') -> None:
        self._kept[index] = kept
        if len(self._kept) > self._most:
            del self._kept[next(iter(self._kept))]
