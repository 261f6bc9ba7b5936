"""An index finds what looks like a descriptor, and looks at few to do so."""
from neo_ros.memory.inverted_index import InvertedIndex
from neo_ros.memory.inverted_kernels import greatest
import numpy as np

EVERYWHERE = 1 << 20  # More lists than there are.


def descriptors(count: int, seed: int = 0) -> np.ndarray:
    """Make descriptors that lie in clusters, as those of local features do; uint8 (count, 32)."""
    random = np.random.default_rng(seed)
    centres = random.normal(0, 1, (count // 50 + 1, 32))
    rows = centres[random.integers(len(centres), size=count)] + random.normal(0, 0.4, (count, 32))
    return near_to(np.rint(rows * 250 / np.linalg.norm(rows, axis=1, keepdims=True)), 0)


def near_to(codes: np.ndarray, seed: int, spread: float = 2.0) -> np.ndarray:
    random = np.random.default_rng([7, seed])
    return np.clip(np.abs(codes + random.normal(0, spread, codes.shape)), 0, 255).astype(np.uint8)


def exact(codes: np.ndarray, queries: np.ndarray) -> np.ndarray:
    return queries.astype(np.int64) @ codes.T.astype(np.int64)


def test_in_all_lists_is_what_comparing_with_all_finds() -> None:
    codes = descriptors(700)
    queries = near_to(codes[::30], 1)
    found, likeness = InvertedIndex(codes).nearest(queries, EVERYWHERE, 9)
    alike = exact(codes, queries)
    np.testing.assert_array_equal(likeness, -np.sort(-alike, axis=1)[:, :9])
    np.testing.assert_array_equal(np.take_along_axis(alike, found, 1), likeness)


def test_few_lists_hold_most_of_what_is_alike() -> None:
    codes = descriptors(20_000)
    queries = near_to(codes[::100], 2)
    index = InvertedIndex(codes)
    found, _ = index.nearest(queries, 16, 4)
    assert len(index._starts) > 150
    assert (found[:, 0] == exact(codes, queries).argmax(1)).mean() > 0.8


def test_what_is_looked_at_grows_with_the_root() -> None:
    def looked_at(count: int) -> float:
        lists = np.diff(InvertedIndex(descriptors(count))._starts)
        return float((lists ** 2).sum() / count)  # Of a list as long as that of a descriptor.
    assert looked_at(64_000) < 6 * looked_at(4_000)


def test_fewer_than_are_asked_for() -> None:
    index = InvertedIndex(descriptors(3))
    found, likeness = index.nearest(descriptors(1, seed=5), EVERYWHERE, 5)
    assert sorted(found[0, :3]) == [0, 1, 2]
    assert (found[0, 3:] == -1).all() and (likeness[0, 3:] == -1).all()


def test_of_equal_words_the_first_ones_are_looked_at() -> None:
    values = np.random.default_rng(3).integers(0, 9, (40, 30)).astype(np.float32)
    found = np.full((40, 12), -1)
    greatest(values, found)
    np.testing.assert_array_equal(found, np.argsort(-values, axis=1, kind='stable')[:, :12])
