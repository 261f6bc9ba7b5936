"""What contradicts a memory, and what only looks so."""
from box_room import planar, SOURCE, view
from neo_ros.geometry import CameraPose
from neo_ros.memory.contradiction import contradicted, contradiction, ContradictionThresholds
from neo_ros.memory.patch_finding import _as_before, PatchThresholds
from neo_ros.memory.stereo import confirm, Shot, StereoThresholds
from neo_ros.memory.stereo_kernels import choose
import numpy as np
import pytest

LIMITS = ContradictionThresholds()


def test_a_thin_thing_that_left_contradicts_as_one_that_came() -> None:
    wall = np.full((40, 40, 3), 200, np.float32)
    bar, aside = wall.copy(), wall.copy()
    bar[:, 20:23], aside[:, 18:21] = 40, 40
    known = np.ones((40, 40), bool)
    for image, shown, found in ((bar, wall, True), (wall, bar, True), (bar, aside, False)):
        off = contradicted(contradiction(image, shown, known))
        assert off[:, 20:23].all() == found and off.any() == found


@pytest.mark.parametrize('behind, stands', [(90, True), (200, False)])
def test_what_came_in_the_colour_of_what_is_behind_it_is_not_seen_through(
        behind: int, stands: bool) -> None:
    shape = (SOURCE.height, SOURCE.width)
    depths, shots = [], []
    for number in range(6):  # Three see something two metres away, three the wall at four.
        came = number < 3
        image = np.full((*shape, 3), 90 if came else behind, np.float32)
        depths.append(np.full(shape, 2.0 if came else 0, np.float32))
        shots.append(Shot(planar(1.9, 1.5 + 0.1 * number, 0), image, image,
                          np.full(shape, 4, np.float32), np.full(shape, came),
                          np.zeros(shape, np.float32), 0))
    found = confirm(shots, 0, np.stack(depths), SOURCE, SOURCE.pixel_rays(), StereoThresholds())
    middle = found[20:40, 28:36]
    assert (middle > 0).all() == stands and middle.any() == stands


@pytest.mark.parametrize('best, known', [(0, False), (1, True), (6, True), (7, False)])
def test_a_least_cost_at_an_end_of_the_range_is_no_depth(best: int, known: bool) -> None:
    # The sky, or the dark below a table, is alike at all depths, and a little more so far away.
    total = np.abs(np.arange(8, dtype=np.float32) - best)[None, None]
    inverse = np.linspace(1 / 14, 1 / 0.6, 8, dtype=np.float32)
    depth, off = np.empty((1, 1), np.float32), np.empty((1, 1), np.float32)
    choose(total, total, inverse, depth, off)
    assert depth[0, 0] == pytest.approx(1 / inverse[best] if known else 0) and off[0, 0] == 0


@pytest.mark.parametrize('made, same_depth, stays', [
    ('brighter', True, True), ('brighter', False, False), ('repainted', True, False),
    ('of another hue', True, False)], ids=str)
def test_a_surface_in_the_sun_is_no_change(made: str, same_depth: bool, stays: bool) -> None:
    pose = planar(1.9, 1.7, 35)
    shown, depth = (one.astype(np.float32) for one in view(pose, SOURCE))
    part = (slice(20, 44), slice(16, 48))
    image = shown.copy()
    image[part] = {'brighter': 1.5 * shown[part],
                   'of another hue': shown[part] * np.array([0.4, 1, 1.5], np.float32),
                   'repainted': np.random.default_rng(0).uniform(0, 255, shown[part].shape)}[made]
    seen = np.zeros_like(depth)
    seen[part] = depth[part] if same_depth else 0.7 * depth[part]
    # Where the window ends neighbours differ.
    found = _as_before(compared(pose, image, shown, depth), seen, PatchThresholds())[24:40, 20:44]
    assert (found.mean() > 0.95) if stays else (found.mean() < 0.3)


@pytest.mark.parametrize('repainted', [False, True])
def test_a_shelf_beside_somebody_is_no_change_if_it_is_only_blurred(repainted: bool) -> None:
    # Colours of the shelf are a little off, as where a memory is blurred.
    pose, random = planar(1.9, 1.7, 35), np.random.default_rng(0)
    depth = np.full((SOURCE.height, SOURCE.width), 3, np.float32)
    shown, seen = np.repeat(128 + 0 * depth[..., None], 3, -1), depth.copy()
    image = shown + random.choice([-14, 14], depth.shape)[..., None].astype(np.float32)
    image[:, 30:40], seen[:, 30:40] = 250, 1.5
    if repainted:
        image[20:40, 50:] = random.choice([0, 255], image[20:40, 50:].shape)
    shot = compared(pose, image, shown, depth)
    assert shot.contradicted.all()  # It goes together with who stands before it.
    found = _as_before(shot, seen, PatchThresholds())
    assert found[:, :30].all() and not found[:, 30:40].any()
    assert found[22:38, 52:62].mean() == (0 if repainted else 1)


def compared(pose: CameraPose, image: np.ndarray, shown: np.ndarray, depth: np.ndarray) -> Shot:
    score = contradiction(image, shown, depth > 0, LIMITS)
    return Shot(pose, image, shown, depth, contradicted(score, LIMITS), score, 0)
