"""How alike two images are does not depend on what grows evenly across them."""
from neo_ros.memory.alignment_kernels import detail_correlation
import numpy as np
import pytest

KEPT = {
    'all': np.ones((9, 11), bool), 'some': np.random.default_rng(0).random((9, 11)) < 0.4,
    'a row': np.indices((9, 11))[0] == 4, 'a column': np.indices((9, 11))[1] == 7,
    'a diagonal': np.eye(9, 11, dtype=bool)}


def images() -> tuple[np.ndarray, np.ndarray]:
    """Return images that are alike, with planes of their own, float32 (9, 11)."""
    random = np.random.default_rng(1)
    a = random.random((9, 11), np.float32)
    b = a + 0.7 * random.random((9, 11), np.float32)
    rows, columns = np.mgrid[:9, :11].astype(np.float32)
    return a + 3 * rows, b - rows + 2 * columns


def without_plane(image: np.ndarray, kept: np.ndarray) -> np.ndarray:
    places = np.column_stack([np.ones(kept.sum()), *np.nonzero(kept)])
    plane, *_ = np.linalg.lstsq(places, image[kept], rcond=None)
    left: np.ndarray = image[kept] - places @ plane
    return left


@pytest.mark.parametrize('kept', KEPT.values(), ids=KEPT)
def test_it_is_of_what_no_plane_explains(kept: np.ndarray) -> None:
    a, b = images()
    one, other = without_plane(a, kept), without_plane(b, kept)
    expected = one @ other / np.sqrt((one @ one) * (other @ other))
    assert detail_correlation(a, b, kept) == pytest.approx(expected, abs=1e-4)


def test_of_what_is_flat_it_is_nothing() -> None:
    a, b = images()
    kept = KEPT['all']
    assert detail_correlation(a, np.full_like(b, 0.5), kept) == 0
    assert detail_correlation(np.mgrid[:9, :11][0].astype(np.float32), b, kept) == 0
    assert detail_correlation(a, b, np.zeros_like(kept)) == 0
