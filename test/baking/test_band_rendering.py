"""A panorama with few rays shows what one with a ray a pixel shows."""
from typing import Any

import cv2
from neo_ros.baking.band_rendering import block_centres, render_band
from neo_ros.geometry import Band
import numpy as np
import pytest

BAND = Band(top=0.6, bottom=-0.6, low=0.0, width=2 * np.pi)
POSITION = np.array([0.3, -0.2, 0.1], np.float32)


class Room:
    """A box room with a thin pole in it; counts the rays."""

    def __init__(self, has_sky: bool = False) -> None:
        self.has_sky, self.rays = has_sky, 0

    def render(self, origins: np.ndarray, directions: np.ndarray, background: Any) -> np.ndarray:
        self.rays += len(directions)
        with np.errstate(divide='ignore'):
            away = np.where(directions > 0, (2 - origins) / directions,
                            (-2 - origins) / directions)
        depth = away.min(1)
        across = origins[:, :2] - [1.0, 0.5]
        along = directions[:, :2]
        a, b = (along ** 2).sum(1), (across * along).sum(1)
        root = b ** 2 - a * ((across ** 2).sum(1) - 0.03 ** 2)
        pole = (-b - np.sqrt(np.maximum(root, 0))) / a
        hit = (root > 0) & (pole > 0) & (pole < depth)
        out = np.empty((len(depth), 6), np.float32)
        out[:, 3], out[:, 4] = np.where(hit, pole, depth), 1.0
        out[:, :3] = np.where(hit[:, None], 0.0, np.abs(directions))
        out[:, 5] = 1.0
        sky = self.has_sky & (directions[:, 2] > 0.3)
        out[sky, 4:] = 0.0
        return out


class Terrace:
    """Tiles 1.5 m below the camera, hills and clouds: beyond 100 m depth is chance."""

    def __init__(self) -> None:
        self.rays = 0

    def render(self, origins: np.ndarray, directions: np.ndarray, background: Any) -> np.ndarray:
        self.rays += len(directions)
        down = -directions[:, 2]
        chance = np.abs(np.sin(1e4 * directions @ [1.0, 0.7, 0.4]))
        depth = np.where(down > 0.3, 1.5 / np.maximum(down, 1e-3), 100 / (1 - 0.999 * chance))
        out = np.ones((len(depth), 6), np.float32)
        out[:, :3], out[:, 3] = np.abs(directions), depth
        return out


def drawn(room: Any, block: int, wanted: np.ndarray | None = None
          ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rays = BAND.rays(240, 1260)
    return render_band(room, POSITION, rays, block, BAND.wraps, 0.1, 0.01, 0.5, wanted)


@pytest.mark.slow
@pytest.mark.parametrize('block', [2, 3])
@pytest.mark.parametrize('has_sky', [False, True])
def test_few_rays_show_what_all_show(block: int, has_sky: bool) -> None:
    few, every = Room(has_sky), Room(has_sky)
    depth, colours, own = drawn(few, block)
    true_depth, true_colours, _ = drawn(every, 1)
    assert few.rays < 0.55 * every.rays
    assert own.sum() <= few.rays and block_centres(own, block).all()
    known = true_depth > 0
    assert np.array_equal(depth > 0, known)
    assert np.abs(depth / np.where(known, true_depth, 1) - 1)[known].max() < 0.011  # In corners.
    assert np.abs(colours - true_colours)[known].max() < 0.01
    assert has_sky == (not known.all())


def test_the_sky_needs_few_rays() -> None:
    terrace = Terrace()
    depth, colours, _ = drawn(terrace, 3)
    true, true_colours, _ = drawn(Terrace(), 1)
    assert terrace.rays < 0.25 * true.size
    sky = true >= 100
    assert 0.3 < sky.mean() < 0.8 and np.median(true[sky]) < 1000 < true.max()
    # No farther from there than a fraction of a pixel.
    assert np.abs(1 / depth - 1 / true)[sky & np.roll(sky, 3, 0)].max() < 0.01
    assert np.abs(colours - true_colours).max() < 0.01


def test_the_pole_is_as_sharp_as_with_all_rays() -> None:
    depth, _, _ = drawn(Room(), 3)
    true, _, _ = drawn(Room(), 1)
    pole = true < 1.1
    assert pole.sum() > 2000
    assert np.abs(depth - true)[pole].max() < 0.002


@pytest.mark.parametrize('block', [1, 2, 3])
def test_what_nobody_wants_is_not_cast(block: int) -> None:
    whole, part = Room(), Room()
    wanted = np.zeros((240 // block, 1260 // block), bool)
    wanted[20:40, 30:70] = wanted[50:70, 300:400] = True
    depth, colours, _ = drawn(part, block, wanted)
    all_depth, all_colours, _ = drawn(whole, block)
    assert part.rays < 0.3 * whole.rays
    pixels = wanted.repeat(block, 0).repeat(block, 1)
    assert (depth[~pixels] == 0).all() and (colours[~pixels] == 0).all()
    # At the rim every pixel has a ray of its own.
    rim = cv2.erode(wanted.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0
    inner = pixels & ~rim.repeat(block, 0).repeat(block, 1)
    np.testing.assert_array_equal(depth[inner], all_depth[inner])
    np.testing.assert_array_equal(colours[inner], all_colours[inner])
