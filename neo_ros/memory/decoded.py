"""Keyframes that are kept decoded, and those that are decoded before they are needed."""
from collections import Counter
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from neo_ros.memory.keyframe import Keyframe

# What is kept of one memory: as many as fit into so many bytes, but at least all that are drawn;
# of each reduction so many.
CACHED_BYTES = 224 << 20
LEAST_CACHED = 3

Key = tuple[int, int]


class DecodedKeyframes:
    """
    Keyframes by how much they are reduced and their number; the ones used last are kept.

    Those that are reduced by as much have one size. For one thread. beside: others, which come
    first: what they take is spared here.
    """

    def __init__(self, most_bytes: int | None = None, beside: 'DecodedKeyframes | None' = None
                 ) -> None:
        self._all_bytes = CACHED_BYTES if most_bytes is None else most_bytes
        self._beside = beside
        # The last one used is the last. An lru_cache of a method would keep the memory alive, as
        # would a method that decodes.
        self._kept: dict[Key, Future[Keyframe]] = {}
        self._counts, self._sizes = Counter[int](), dict[int, int]()
        self._other: ThreadPoolExecutor | None = None

    def get(self, key: Key, decode: Callable[[], Keyframe]) -> Keyframe:
        """Return a keyframe; what is not there is decoded now. Raises what `decode` raises."""
        found = self._take(key).result() if key in self._kept else decode()
        self.put(key, found)
        return found

    @property
    def last_used(self) -> list[Key]:
        """The keys of those that are drawn now; any thread may ask, for a list is made at once."""
        return list(self._kept)[-2 * LEAST_CACHED:]

    def put(self, key: Key, keyframe: Keyframe) -> None:
        """Keep what another thread has decoded."""
        kept = Future[Keyframe]()
        kept.set_result(keyframe)
        self._sizes[key[0]] = keyframe.depth.nbytes + keyframe.texture.nbytes
        self._keep(key, kept)

    def ahead(self, key: Key, decode: Callable[[], Keyframe]) -> None:
        """Let another thread decode a keyframe, if there is room beside those that are drawn."""
        drawn = 2 * LEAST_CACHED * sum(self._sizes.values())
        if key in self._kept or key[0] not in self._sizes or (
                drawn + self._sizes[key[0]] > self._most_bytes):
            return
        self._other = self._other or ThreadPoolExecutor(1, 'keyframes')
        self._keep(key, self._other.submit(decode))

    @property
    def kept_bytes(self) -> int:
        """How many are kept."""
        return sum(count * self._sizes[reduced] for reduced, count in self._counts.items())

    @property
    def _most_bytes(self) -> int:
        return self._all_bytes - (0 if self._beside is None else self._beside.kept_bytes)

    def _take(self, key: Key) -> 'Future[Keyframe]':
        self._counts[key[0]] -= 1
        return self._kept.pop(key)

    def _keep(self, key: Key, kept: 'Future[Keyframe]') -> None:
        self._kept[key] = kept
        self._counts[key[0]] += 1
        size, most = self.kept_bytes, self._most_bytes
        for old in list(self._kept) if size > most else ():
            if size <= most:
                break
            if self._counts[old[0]] > LEAST_CACHED:
                size -= self._sizes[old[0]]
                self._take(old)
