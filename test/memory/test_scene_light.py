"""Other light than the photos': it is learnt, kept, found again, and never shown for a change."""
import functools
import logging
from pathlib import Path

from box_room import apart, box_memory, box_walk, EXPANSION, SOURCE, view, write_box_model
import cv2
from neo_ros.evaluation.metrics import psnr
from neo_ros.geometry import CameraPose
from neo_ros.memory.light_file import lights_path, MAGIC, read_lights, write_lights
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.scene_light import SceneLight
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest

pytestmark = pytest.mark.slow

MEMORY = box_memory()
WALK = box_walk(24)
RING = EXPANSION.extrapolated_mask
SHA256 = 64 * 'a'


@functools.cache
def wide_view(pose: CameraPose) -> tuple[np.ndarray, np.ndarray]:
    """Return what is there, uint8 RGB (H, W, 3) and metres float32 (H, W), to be read only."""
    image, depth = view(pose, EXPANSION.target)
    return image, depth.astype(np.float32)


def lit(pose: CameraPose, slope: float) -> np.ndarray:
    """Return the wide view as light shows it that falls off along x: uint8 RGB (H, W, 3)."""
    image, depth = wide_view(pose)
    points = (EXPANSION.target.pixel_rays() * depth[..., None]) @ pose.T_world_cam[:3, :3].T
    factor = np.exp(slope * (points[..., 0] + pose.position[0] - 2))
    return np.rint(np.clip(0.7 * factor[..., None] * image, 0, 255)).astype(np.uint8)


def ring_psnr(guide: SceneGuide, slope: float, poses: list[CameraPose]) -> list[float]:
    scores = []
    for pose in poses:
        truth = lit(pose, slope)
        shown = guide.guide(np.ascontiguousarray(EXPANSION.crop(truth)), prior=pose)
        assert shown is not None
        scores.append(psnr(truth[RING], np.clip(shown.image, 0, 255).astype(np.uint8)[RING]))
    return scores


def test_another_light_is_learnt_while_driving() -> None:
    scores = ring_psnr(SceneGuide(MEMORY, EXPANSION, 1), 0.1, WALK)
    assert np.mean(scores[-8:]) > scores[0] + 5


def test_no_image_of_the_light_before_corrects_a_view() -> None:
    guide, changes = SceneGuide(MEMORY, EXPANSION, 1), 0
    for slope in (0.1, -0.1, 0.1):
        for pose in WALK[::2]:
            before = guide.light.shown
            guide.guide(np.ascontiguousarray(EXPANSION.crop(lit(pose, slope))), prior=pose)
            if guide.light.shown is not before:
                changes += 1
                assert not guide._recent._order
    assert changes > 1


def test_the_photos_light_changes_no_bit() -> None:
    guide = SceneGuide(MEMORY, EXPANSION, 1)
    ring_psnr(guide, 0.0, WALK)
    assert not guide.light.other and not guide.light.known()
    image = np.full((*RING.shape, 3), 100, np.float32)
    depth = np.ones(RING.shape, np.float32)
    assert guide.light.relight(image, depth, WALK[0], EXPANSION.target) is None
    assert (image == 100).all()


def by_a_lamp(pose: CameraPose, brighter: float) -> np.ndarray:
    """Return the image of a camera that a lamp shines before: uint8 RGB (h, w, 3)."""
    x, y = (SOURCE.pixel_rays()[..., axis] for axis in (0, 1))
    lamp = 0.25 * (1 + brighter * np.exp(-5 * ((x + 0.4) ** 2 + (y + 0.2) ** 2)))
    return np.clip(lamp[..., None] * view(pose, SOURCE)[0], 0, 255).astype(np.uint8)


def test_a_camera_is_found_in_a_light_that_the_memory_does_not_know() -> None:
    off = []
    for pose in WALK[::3]:
        found = SceneGuide(MEMORY, EXPANSION, 1).guide(by_a_lamp(pose, 1.0))
        off.append(np.inf if found is None else apart(found.pose, pose)[0])
    assert np.median(off) < 0.15 and np.mean(np.less(off, 0.3)) > 0.8


def test_no_light_makes_another_place_right() -> None:
    guide = SceneGuide(MEMORY, EXPANSION, 1)
    for pose in WALK[::6]:
        image = guide._camera_image(by_a_lamp(pose, 1.0))
        for other in WALK[::3]:
            if apart(other, pose)[0] > 1 or apart(other, pose)[1] > 40:
                looker = guide._looker
                assert not looker.look_in_any_light(image, looker.look(image, other)).believed


def test_a_light_of_before_is_found_again_and_the_others_stay() -> None:
    guide = SceneGuide(MEMORY, EXPANSION, 1)
    ring_psnr(guide, 0.1, WALK)
    kept = [[cells.copy() for cells in light] for light in guide.light.known()]
    assert len(kept) == 1
    later = SceneGuide(MEMORY, EXPANSION, 1)
    later.light.begin(kept)
    first, second = ring_psnr(later, 0.1, WALK[:2])
    assert second > ring_psnr(SceneGuide(MEMORY, EXPANSION, 1), 0.1, WALK[:2])[1] + 2
    # By day again: the evening is put aside as it was, and comes back.
    by_day = ring_psnr(later, 0.0, WALK)
    fresh = ring_psnr(SceneGuide(MEMORY, EXPANSION, 1), 0.0, WALK)
    assert np.mean(by_day[-8:]) > np.mean(fresh[-8:]) - 1.2
    assert ring_psnr(later, 0.1, WALK[:2])[1] > second - 2


def test_what_is_something_else_is_no_light() -> None:
    light = SceneLight(MEMORY.positions, EXPANSION)
    pose = WALK[0]
    shown, depth = wide_view(pose)
    image = np.array(EXPANSION.crop(shown))
    noise = np.random.default_rng(0).integers(0, 256, (32, 24, 3), np.uint8)
    image[16:48, 20:44] = cv2.resize(noise, (24, 32))
    for _ in range(36):
        light.see(image, shown.astype(np.float32), depth, pose)
    assert not light.other


def some_lights(count: int) -> tuple[SceneLight, list[list[np.ndarray]]]:
    """Return lights that can be: sums of logarithms, and their trust."""
    light, random = SceneLight(MEMORY.positions, EXPANSION), np.random.default_rng(1)
    lights = []
    for _ in range(count):
        lights.append([cells.copy() for cells in light.empty])
        for cells in lights[-1]:
            cells[..., 3] = random.integers(0, 9, cells.shape[:3])
            cells[..., :3] = cells[..., 3:] * random.integers(-1, 2, (*cells.shape[:3], 3))
    return light, lights


def test_lights_survive_in_their_file_the_newest_of_them(tmp_path: Path) -> None:
    light, lights = some_lights(5)
    path = lights_path(tmp_path / 'room.memory')
    write_lights(path, SHA256, lights)
    found = read_lights(path, SHA256, light.empty)
    assert len(found) == 4
    for one, other in zip(found, lights[1:]):
        assert all((a == b).all() for a, b in zip(one, other))
    assert read_lights(tmp_path / 'none', SHA256, light.empty) == []


def test_a_file_that_is_wrong_is_left_aside(
        tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    light, lights = some_lights(1)
    path = tmp_path / 'room.memory.lights'
    write_lights(path, SHA256, lights)
    whole, random = path.read_bytes(), np.random.default_rng(0)
    assert read_lights(path, 64 * 'b', light.empty) == []
    assert read_lights(path, SHA256, light.empty[:1]) == []
    wrong = [whole[:20], b'', MAGIC, whole[:-1], whole + b'x', b'something else']
    for _ in range(30):
        place = int(random.integers(len(whole)))
        wrong.append(whole[:place] + bytes([whole[place] ^ 1 << int(random.integers(8))])
                     + whole[place + 1:])
    with caplog.at_level(logging.WARNING):
        for content in wrong:
            path.write_bytes(content)
            assert read_lights(path, SHA256, light.empty) == []
    assert len(caplog.records) == len(wrong) + 2 and 'neo memory forget' in caplog.text


@pytest.mark.parametrize('numbers', [
    (np.nan, 0, 0, 1), (0, 0, np.inf, 1), (0, 0, 0, -0.5), (6e4, 0, 0, 1), (0, 0, 0, 1e4),
], ids=str)
def test_numbers_that_no_light_has_are_refused(tmp_path: Path, numbers: tuple) -> None:
    light, lights = some_lights(1)
    lights[0][1][0, 0, 0] = numbers
    write_lights(tmp_path / 'lights', SHA256, lights)
    assert read_lights(tmp_path / 'lights', SHA256, light.empty) == []


def test_a_model_that_learns_keeps_its_lights(tmp_path: Path) -> None:
    path = write_box_model(tmp_path)
    model = FovExtrapolator.load(path, threads=1, learn='at once')
    for pose in WALK:
        image = np.ascontiguousarray(EXPANSION.crop(lit(pose, 0.1)))
        assert image.shape == (SOURCE.height, SOURCE.width, 3)
        model.expand(image, prior=pose)
    again = FovExtrapolator.load(path, threads=1)
    model.finish_learning()
    kept, = tmp_path.glob('*.lights')
    assert kept.name.endswith('.memory.lights')
    assert again._guided_view is not None and not again._guided_view._guide.light.lights
    again.forget_light()  # What a node does whose model is exchanged.
    assert len(again._guided_view._guide.light.lights) == 1


def test_few_lights_are_kept() -> None:
    guide, most = SceneGuide(MEMORY, EXPANSION, 1), 0
    for slope in (0.1, -0.1, 0.06, -0.06, 0.12, -0.12, 0.1):
        for pose in WALK[:8]:
            guide.guide(np.ascontiguousarray(EXPANSION.crop(lit(pose, slope))), prior=pose)
        most = max(most, len(guide.light.lights))
    assert 1 < most <= guide.light.thresholds.most_lights


def looks(light: SceneLight, images: list[np.ndarray]) -> None:
    """Let the light see images of the memory's own views, in the exposure that they have."""
    for pose, image in zip(WALK, images):
        shown, depth = wide_view(pose)
        wide = shown.astype(np.float32)
        light.relight(wide, depth, pose, EXPANSION.target)
        light.see(image, wide, depth, pose)


def narrow(slope: float) -> list[np.ndarray]:
    return [np.array(EXPANSION.crop(lit(pose, slope))) for pose in WALK]


def test_a_light_that_fades_gently_is_kept() -> None:
    light = SceneLight(MEMORY.positions, EXPANSION)
    looks(light, narrow(0.1))
    assert light.other
    for slope in (0.08, 0.06, 0.04, 0.02, 0.0, 0.0, 0.0):
        looks(light, narrow(slope))
    assert not light.other and 1 <= len(light.known()) <= light.thresholds.most_lights
    looks(light, narrow(0.1)[:3])
    assert light.other


def test_a_long_day_does_not_outvote_the_evening() -> None:
    light = SceneLight(MEMORY.positions, EXPANSION)
    for _ in range(12):
        looks(light, narrow(0.0))
    assert not light.other
    evening, fresh = narrow(0.12), SceneLight(MEMORY.positions, EXPANSION)
    for _ in range(3):
        looks(light, evening)
        looks(fresh, evening)
    assert levels_off(light, 0.12) < 1.1 * levels_off(fresh, 0.12)


def levels_off(light: SceneLight, slope: float) -> float:
    """Return by how much the memory differs from what is there, in that light, grey levels."""
    differs = []
    for pose in WALK:
        shown, depth = wide_view(pose)
        wide = 0.7 * shown.astype(np.float32)
        light.relight(wide, depth, pose, EXPANSION.target)
        truth = lit(pose, slope)
        gain = np.median(truth[RING]) / np.median(wide[RING])
        differs.append(np.abs(gain * wide - truth)[RING].mean())
    return float(np.mean(differs))


def test_what_is_black_in_the_memory_gets_no_brighter_without_end() -> None:
    light = SceneLight(MEMORY.positions, EXPANSION)
    looks(light, narrow(0.1))
    assert light.other
    red = np.zeros((*RING.shape, 3), np.float32)
    red[..., 0] = 150
    image = np.full((SOURCE.height, SOURCE.width, 3), (110, 9, 7), np.uint8)
    for _ in range(100):
        for pose in WALK[:2]:
            shown, depth = red.copy(), wide_view(pose)[1]
            light.relight(shown, depth, pose, EXPANSION.target)
            light.see(image, shown, depth, pose)
    most = max(float((np.abs(cells[..., :3]) / np.maximum(cells[..., 3:], 1e-3)).max())
               for cells in light._now)
    assert 0 < most <= light.thresholds.most_log + 1e-3


def test_images_that_tell_nothing_of_light_change_nothing() -> None:
    light, random = SceneLight(MEMORY.positions, EXPANSION), np.random.default_rng(0)
    looks(light, narrow(0.1))
    assert light.other
    off = light._deviation
    noise = [random.integers(0, 256, (SOURCE.height, SOURCE.width, 3), np.uint8) for _ in WALK]
    looks(light, [cv2.resize(cv2.resize(one, (16, 16)), (SOURCE.width, SOURCE.height),
                             interpolation=cv2.INTER_NEAREST) for one in noise])
    assert light.other and light._deviation == off


def test_a_light_can_be_forgotten() -> None:
    light = SceneLight(MEMORY.positions, EXPANSION)
    looks(light, narrow(0.1))
    light.begin([])
    assert not light.other and not light.known()


@pytest.mark.parametrize('slope, learns', [(0.0, True), (0.1, False)], ids=['photos', 'other'])
def test_in_another_light_nothing_is_learnt(slope: float, learns: bool) -> None:
    light = SceneLight(MEMORY.positions, EXPANSION)
    assert not light.as_in_photos
    for pose in WALK:
        # By day the memory is exact here.
        shown, depth = wide_view(pose)
        wide = shown.astype(np.float32)
        light.relight(wide, depth, pose, EXPANSION.target)
        light.see(np.array(EXPANSION.crop(lit(pose, slope))), wide, depth, pose)
        assert light.as_in_photos == learns


@pytest.mark.parametrize('apart', [
    (0.0, 0.0, 0.0), (80.0, 80.0, 6.0), (2e6, 0.0, 0.0), (2e6, 2e6, 0.0)], ids=str)
def test_the_cells_of_a_scene_of_any_shape_are_few(apart: tuple[float, float, float]) -> None:
    light = SceneLight(np.array([(0.0, 0.0, 0.0), apart]), EXPANSION)
    limits = light.thresholds
    for cells, size, least in zip(light.empty, light._sizes, limits.cells):
        assert cells[..., 0].size <= limits.most_cells
        assert (size * (np.array(cells.shape[:3]) - 1) > np.array(apart) + limits.reach).all()
        assert size == least or cells[..., 0].size > limits.most_cells / 2
