"""The faults of a depth camera are those that its model states."""
from neo_ros.flat.depth_sensor import DepthSensor
import numpy as np
import pytest

SENSOR = DepthSensor()


def read(depth: np.ndarray, seed: int = 0) -> np.ndarray:
    return SENSOR.reading(depth.astype(np.float32), np.random.default_rng(seed))


@pytest.mark.parametrize('z', [1.0, 2.0, 4.0])
def test_noise_and_steps_grow_with_the_square_of_the_distance(z: float) -> None:
    off = read(np.full((100, 100), z)) - z
    noise = 0.0012 + 0.0019 * (z - 0.4) ** 2
    step = z ** 2 / 348
    assert off.std() == pytest.approx(np.hypot(noise, step / np.sqrt(12)), rel=0.15)
    assert abs(off.mean()) < 0.2 * step


def test_there_are_holes_at_edges_and_out_of_reach() -> None:
    depth = np.full((9, 12), 2.0)
    depth[:, 6:] = 3
    depth[0, 0], depth[0, 11], depth[8, 0] = 0.2, 6, np.nan
    hole = np.isnan(read(depth))
    assert hole[:, 5:7].all() and not hole[3:6, 1:5].any() and not hole[3:6, 7:].any()
    assert hole[0, 0] and hole[0, 11] and hole[8, 0]
    np.testing.assert_array_equal(read(depth), read(depth))
