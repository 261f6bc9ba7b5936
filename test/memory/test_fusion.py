"""Fusing camera image and guide."""
from dataclasses import replace
import os
from pathlib import Path
import subprocess
import sys

from box_room import EXPANSION, planar, view
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.memory.fusion import fuse, FusionThresholds
from neo_ros.memory.recent_images import SeenBefore
from neo_ros.memory.sight import Guide
import numpy as np
import pytest

POSE = planar(1.9, 1.7, 35)
WIDE = view(POSE, EXPANSION.target)[0]
NARROW = EXPANSION.crop(WIDE)
RING = EXPANSION.extrapolated_mask


def guide_of(image: np.ndarray, known: np.ndarray | None = None) -> Guide:
    whole = np.ones(RING.shape, bool)
    return Guide(image.astype(np.float32), whole if known is None else known,
                 np.zeros(RING.shape, bool), POSE, 1.0)


@pytest.mark.slow
def test_a_perfect_guide_stays_as_it_is() -> None:
    wide, error = fuse(NARROW, guide_of(WIDE), EXPANSION)
    assert np.abs(wide.astype(int) - WIDE).max() <= 1
    assert np.all(error[RING] >= FusionThresholds.least_error / 255) and np.all(error[~RING] == 0)
    # It is sure of all but the edges.
    steep = np.abs(np.gradient(WIDE.astype(float).mean(-1))).max(0) > 8
    assert np.median(error[RING & ~steep]) < 2 / 255 < np.median(error[RING & steep]) / 2


def test_the_camera_pixels_are_never_touched() -> None:
    noise = np.random.default_rng(0).integers(0, 256, WIDE.shape).astype(np.uint8)
    wide, _ = fuse(NARROW, guide_of(noise), EXPANSION)
    assert np.array_equal(EXPANSION.crop(wide), NARROW)


# In a process of its own: here other tests have compiled what they need.
COMPILED = """
from box_room import box_memory, EXPANSION
from neo_ros.memory import colour_kernels
from neo_ros.memory.fusion import fuse
from neo_ros.memory.scene_guide import SceneGuide
import numpy as np

def fuse_in(wide, writeable=True):
    image = EXPANSION.crop(wide)
    image.flags.writeable = writeable
    fuse(image, shown, EXPANSION)
    return {name: len(kernel.signatures) for name, kernel in vars(colour_kernels).items()
            if hasattr(kernel, 'signatures') and not name.startswith('_')}

shown = SceneGuide(box_memory(), EXPANSION).warm_up()
wide = shown.image.astype(np.uint8)
before = fuse_in(wide)
assert min(before.values()) > 0, before
shown.known[40:, :9] = False
for other in (fuse_in(wide.copy(), writeable=False), fuse_in(np.asfortranarray(wide))):
    assert other == before, (before, other)
"""


@pytest.mark.slow
def test_nothing_is_compiled_anew_for_gaps_or_images_of_another_kind() -> None:
    helpers = Path(__file__).parents[1] / 'helpers'
    subprocess.run([sys.executable, '-c', COMPILED], check=True,
                   env={**os.environ, 'PYTHONPATH': f'{helpers}:{Path(__file__).parents[2]}'})


def test_gaps_beside_the_camera_go_on_in_its_colours() -> None:
    known = np.zeros(RING.shape, bool)
    known[:8] = True  # Black, and far away.
    grey = np.where(known[..., None], 0, np.full(3, 200))
    wide, error = fuse(np.full(NARROW.shape, 100, np.uint8), guide_of(grey, known), EXPANSION)
    rows, columns = EXPANSION.observed
    beside = wide[rows, columns.start - 3:columns.start]
    assert np.all((beside > 60) & (beside <= 100))
    assert error[rows, columns.start - 1].min() >= FusionThresholds.gap_error / 255


def test_what_may_be_in_another_state_is_less_sure_until_it_is_seen() -> None:
    two_states = np.zeros(RING.shape, np.float32)
    two_states[:20, :20] = 1
    weight = np.zeros(RING.shape, np.float32)
    weight[:20, :10] = 1
    guide = replace(guide_of(WIDE), seen_before=SeenBefore(
        np.zeros((*RING.shape, 3), np.float32), weight))
    (wide, error), (wide_before, before) = (fuse(NARROW, one, EXPANSION) for one in (
        replace(guide, two_states=two_states), guide))
    assert np.array_equal(wide, wide_before)
    more = (error - before) * 255
    assert more[:20, 10:20] == pytest.approx(FusionThresholds.two_states)
    more[:20, 10:20] = 0
    assert (more == 0).all()


def test_small_gaps_are_filled_from_around_them() -> None:
    known = np.ones(RING.shape, bool)
    known[10:13, 60:64] = False
    wide, error = fuse(NARROW, guide_of(np.where(known[..., None], WIDE, 0), known),
                       EXPANSION)
    assert np.abs(wide.astype(int) - WIDE)[~known].mean() < 10
    assert error[~known].min() > error[known].max()


def test_no_gap_of_a_large_view_stays_black() -> None:
    large = ViewExpansion.to_size(Intrinsics.from_hfov(640, 360, np.pi / 2), 1280, 720)
    known = np.ones((720, 1280), bool)
    known[:134, :134] = False
    grey = Guide(np.repeat(100 * known[..., None], 3, axis=2).astype(np.float32), known,
                 np.zeros(known.shape, bool), POSE, 1.0)
    wide, _ = fuse(np.full((360, 640, 3), 100, np.uint8), grey, large)
    assert np.abs(wide.astype(int) - 100).max() <= 1


def test_a_difference_in_exposure_is_healed_at_the_seam() -> None:
    wide, _ = fuse(NARROW, guide_of(WIDE.astype(float) - 12), EXPANSION)
    seam = np.zeros(RING.shape, bool)
    seam[28:-28, 28:-28] = True
    seam &= RING
    shift = np.minimum(WIDE.astype(float), 12)  # where the guide would be below black
    assert np.abs(wide.astype(float) - WIDE)[seam].mean() < 0.5 * shift[seam].mean()


@pytest.mark.slow
def test_a_window_may_lie_across_blocks() -> None:
    odd = ViewExpansion.to_size(Intrinsics.from_hfov(61, 47, np.pi / 2), 123, 99)
    grey = Guide(np.full((99, 123, 3), 90, np.float32), np.ones((99, 123), bool),
                 np.zeros((99, 123), bool), POSE, 1.0)
    wide, _ = fuse(np.full((47, 61, 3), 100, np.uint8), grey, odd)
    rows, columns = odd.observed
    for beside in (wide[rows.start - 1, columns], wide[rows.stop, columns],
                   wide[rows, columns.start - 1], wide[rows, columns.stop]):
        assert np.all(beside >= 95) and np.all(beside <= 100)


def test_confidence_falls_where_the_image_contradicts_the_memory() -> None:
    changed = NARROW.copy()
    changed[20:44, 44:] = 255 - changed[20:44, 44:]
    _, error = fuse(changed, guide_of(WIDE), EXPANSION)
    beside, opposite = error[52:76, 98:104].mean(), error[52:76, 24:30].mean()
    assert beside > 3 * opposite


def test_what_was_just_seen_corrects_the_guide_and_its_error() -> None:
    grey = np.full(WIDE.shape, 100, np.float32)
    weight = np.zeros(RING.shape, np.float32)
    weight[8:24, 8:24], weight[100:, 100:] = 1, 0.5
    seen = SeenBefore(20 * np.repeat(weight[..., None], 3, axis=2), weight)
    wide, error = fuse(EXPANSION.crop(grey).astype(np.uint8),
                       replace(guide_of(grey), seen_before=seen), EXPANSION)
    assert np.all(wide[8:24, 8:24] == 120) and np.all(wide[101:, 101:] == 110)
    assert np.all(wide[30:60, :20] == 100)
    assert error[12:20, 12:20] * 255 == pytest.approx(
        FusionThresholds.seen_before * 20 + FusionThresholds.least_error)
    assert error[40, 10] * 255 == pytest.approx(FusionThresholds.least_error)


def steps(aside: int) -> np.ndarray:
    """Return a picture of an edge that leans, float (H, W), aside by so many pixels."""
    rows, columns = np.indices(RING.shape)
    return np.where(columns - rows / 3 > 4 + aside, 200.0, 50.0)


@pytest.mark.parametrize(('told', 'smoothed'), [
    ('leap', True), ('unknown', True), ('stretched', True), ('slant', False),
    ('nothing', False)])
def test_edges_of_depth_are_smoothed_and_nothing_else(told: str, smoothed: bool) -> None:
    picture = np.repeat(steps(0)[..., None], 3, axis=2)
    edge = picture[..., 0] > 100
    depth = {'leap': np.where(edge, 1, 1.2), 'unknown': np.where(edge, 1, 0),
             'slant': np.where(edge, 1, 1.05)}.get(told)
    guide = replace(guide_of(picture), remembered_depth=(
        None if depth is None else depth.astype(np.float32)),
        stretched=edge & (told == 'stretched'))
    wide, error = fuse(EXPANSION.crop(picture).astype(np.uint8), guide, EXPANSION)
    found = wide[..., 0].astype(float)
    beside = RING & (np.abs(steps(1) - steps(-1)) > 0)
    assert (np.abs(found - picture[..., 0])[beside].mean() > 10) == smoothed
    assert np.abs(found - picture[..., 0])[RING & ~beside].max() <= 5
    # The camera's pixels are as they were, and what is smoothed is not surer for that.
    assert np.array_equal(EXPANSION.crop(wide), EXPANSION.crop(picture).astype(np.uint8))
    plain = fuse(EXPANSION.crop(picture).astype(np.uint8), replace(
        guide, remembered_depth=None), EXPANSION)[1]
    assert np.array_equal(error, plain)
    # An edge that lies a pixel aside costs less.
    truth = steps(1)[RING]
    off, off_before = (np.mean((one[RING] - truth) ** 2) for one in (found, picture[..., 0]))
    assert (off < 0.8 * off_before) == smoothed
