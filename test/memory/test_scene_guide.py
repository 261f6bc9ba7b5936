"""Finding and following a camera in the box room, whose poses are known."""
from concurrent.futures import Future, ThreadPoolExecutor
import time
from typing import Any

from box_room import apart, box_memory, EXPANSION, planar, SOURCE, view
from neo_ros.geometry import CameraPose
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.machine.compiled import ALL_THREADS
from neo_ros.machine.files import share_dir
from neo_ros.memory import looking
from neo_ros.memory.alignment import agreement, Aligner, AlignmentThresholds, Drawn
from neo_ros.memory.alignment_kernels import GuideLevel, Warp
from neo_ros.memory.rendering import GuideView, MemoryRenderer
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.sight import better, Sight
from neo_ros.memory.thresholds import GuideThresholds
from neo_ros.runtime import FovExtrapolator
from numba import get_num_threads
import numpy as np
import pytest

pytestmark = pytest.mark.slow

MEMORY = box_memory()
TRUE_POSE = planar(1.9, 1.7, 35)
PATTERN = np.random.default_rng(0).random((4, 4))


def moved(pose: CameraPose, metres: tuple[float, float, float], degrees: float) -> CameraPose:
    """Shift a pose in the world and turn it about its own vertical."""
    T = pose.T_world_cam.copy()
    T[:3, 3] += metres
    T[:3, :3] = T[:3, :3] @ rotation_from_vector(np.array([0, np.radians(degrees), 0]))
    return CameraPose(T)


def photo_at(pose: CameraPose) -> np.ndarray:
    return view(pose, SOURCE)[0]


@pytest.mark.parametrize(('metres', 'degrees'), [
    ((0.02, 0, 0), 1), ((0.1, -0.1, 0), -5), ((-0.15, 0.2, 0.05), 6), ((0.3, 0, 0), 10)],
    ids=['near', 'turned', 'higher', 'far'])
@pytest.mark.parametrize(('gain', 'bias'), [(1, 0), (0.7, 30)], ids=['same light', 'darker'])
def test_alignment_finds_the_pose(metres: tuple[float, float, float], degrees: float,
                                  gain: float, bias: float) -> None:
    aligner = Aligner(MemoryRenderer(MEMORY), SOURCE)
    image = np.clip(gain * photo_at(TRUE_POSE) + bias, 0, 255).astype(np.uint8)
    photo = aligner.photo(image)
    found = aligner.align(photo, moved(TRUE_POSE, metres, degrees), rounds=3)
    metres_off, degrees_off = apart(found, TRUE_POSE)
    assert metres_off < 0.02 and degrees_off < 0.4
    assert aligner.agreement(photo, found) > 0.97


@pytest.mark.parametrize('gain', [0.25, 0.5], ids=str)
def test_a_camera_that_moves_a_little_is_followed_in_less_light(gain: float) -> None:
    aligner = Aligner(MemoryRenderer(MEMORY), SOURCE)
    image = np.clip(gain * photo_at(TRUE_POSE), 0, 255).astype(np.uint8)
    start = moved(TRUE_POSE, (0.05, -0.03, 0), 2)
    found = aligner.align(aligner.photo(image), start, rounds=1, near=True)
    assert apart(found, TRUE_POSE)[0] < 0.02


def test_agreement_tells_a_wrong_pose() -> None:
    aligner = Aligner(MemoryRenderer(MEMORY), SOURCE)
    photo = aligner.photo(photo_at(TRUE_POSE))
    assert aligner.agreement(photo, planar(1.9, 1.7, 120)) < 0.8


@pytest.mark.parametrize('iterations', [12, 1], ids=['some', 'the last one'])
def test_a_step_that_loses_the_image_is_taken_back(iterations: int) -> None:
    aligner = Aligner(MemoryRenderer(MEMORY), SOURCE, AlignmentThresholds(iterations=iterations))
    across = np.broadcast_to(np.linspace(-1, 1, SOURCE.width), (SOURCE.height, SOURCE.width))
    # Grey that rises so little that only a turn by half a circle would make a bow of it.
    photo = aligner.photo(np.repeat(255 * (0.5 + 0.06 * across)[..., None], 3, axis=2))
    bow = (0.5 + 0.2 * across ** 2).astype(np.float32)
    shown = GuideLevel(bow, np.full(bow.shape, 2, np.float32), aligner.levels[0].pixel_rays())
    found = aligner._align_level(0, photo[0], shown, Warp(np.eye(4), 1.0, 0.0), False)
    assert np.array_equal(found.T, np.eye(4)) and (found.gain, found.bias) == (1.0, 0.0)


@pytest.mark.parametrize(('image', 'guide', 'known', 'expected'), [
    (PATTERN, 3 * PATTERN + 1, np.ones((4, 4), bool), 1.0),
    (PATTERN, -PATTERN, np.ones((4, 4), bool), -1.0),
    (np.ones((4, 4)), PATTERN, np.ones((4, 4), bool), 0.0),
    (np.arange(16.0).reshape(4, 4), np.arange(16.0).reshape(4, 4), np.ones((4, 4), bool), 0.0),
    (PATTERN, 2 * PATTERN + np.arange(4.0), np.ones((4, 4), bool), 1.0),
    (PATTERN, PATTERN, np.eye(4) > 0, -1.0),
], ids=['another exposure', 'a negative', 'one colour', 'a gradient', 'light from one side',
        'hardly known'])
def test_agreement_by_hand(image: np.ndarray, guide: np.ndarray, known: np.ndarray,
                           expected: float) -> None:
    assert agreement(image, guide, known)[0] == pytest.approx(expected)


def test_a_camera_is_found_anywhere_and_followed() -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    for step in range(6):
        pose = planar(1.4 + 0.1 * step, 1.5 + 0.05 * step, 20 + 4 * step)
        wide, _ = view(pose, EXPANSION.target)
        found = guide.guide(EXPANSION.crop(wide))
        assert found is not None
        assert apart(found.pose, pose)[0] < 0.02
        ring = EXPANSION.extrapolated_mask & found.known
        assert np.abs(found.image - wide)[ring].mean() < 5


def test_a_camera_is_followed_for_a_long_time() -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    for step in range(150):
        phase = step / 12
        pose = planar(1.9 + 0.3 * np.sin(phase), 1.7 + 0.2 * np.sin(2 * phase), 30 * phase)
        found = guide.guide(photo_at(pose))
        assert found is not None and apart(found.pose, pose)[0] < 0.03, step


@pytest.mark.parametrize('pause_s, found', [(0.1, 'tracked'), (2.0, None)])
def test_an_image_that_shows_nothing_costs_one_image_and_a_long_pause_the_place(
        pause_s: float, found: str | None) -> None:
    guide, stamp_ns = SceneGuide(MEMORY, EXPANSION), 0
    for step in range(9):
        stamp_ns += int(1e9 * (pause_s if step == 7 else 0.1))
        pose = planar(1.6 + 0.02 * step, 1.5 + 0.01 * step, 20 + 2 * step)
        image = np.zeros((64, 64, 3), np.uint8) if step == 6 else photo_at(pose)
        seen = guide.guide(image, stamp_ns=stamp_ns)
        assert (seen is None) == (step == 6 or (step > 6 and found is None)), step
        if seen is not None:
            assert apart(seen.pose, pose)[0] < 0.03
    assert (seen and seen.found) == found


def test_a_kidnapped_camera_is_found_again() -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    assert guide.guide(photo_at(planar(1.4, 1.5, 20))) is not None
    elsewhere = planar(3.0, 2.0, 200)
    found = guide.guide(photo_at(elsewhere))
    assert found is not None and apart(found.pose, elsewhere)[0] < 0.03


@pytest.mark.parametrize('one, other', [
    ((True, False, 0.86), (False, False, 0.9)), ((True, True, 0.7), (True, False, 0.95)),
    ((True, True, 0.9), (True, True, 0.8)), ((True, False, 0.97), (True, False, 0.96))],
    ids=['believed', 'landmarks', 'agrees more', 'agrees more without landmarks'])
def test_the_better_of_two_poses(one: tuple[bool, bool, float], other: tuple[bool, bool, float]
                                 ) -> None:
    view = MemoryRenderer(MEMORY).render(TRUE_POSE, SOURCE)
    drawn = Drawn(TRUE_POSE, view.image[..., 0], view.depth)
    sights = [Sight(TRUE_POSE, lambda: view, view, drawn, agrees, believed, located)
              for believed, located, agrees in (one, other)]
    assert better(*sights) is better(*sights[::-1]) is sights[0]
    assert better(None, sights[1]) is sights[1] and better(sights[1], None) is sights[1]


@pytest.mark.parametrize('degrees, drawings', [(1, 1), (6, 2)], ids=['slow', 'fast'])
def test_a_slow_camera_is_aligned_with_what_was_drawn_before(
        monkeypatch: pytest.MonkeyPatch, degrees: float, drawings: int) -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    walk = [planar(1.9 + 0.02 * step, 1.7, 35 + degrees * step) for step in range(5)]
    for pose in walk[:-1]:
        assert guide.guide(photo_at(pose)) is not None
    drawn: list[CameraPose] = []
    render = guide.renderer.render

    def watched(pose: CameraPose, *arguments: Any) -> GuideView:
        drawn.append(pose)
        return render(pose, *arguments)
    monkeypatch.setattr(guide.renderer, 'render', watched)
    found = guide.guide(photo_at(walk[-1]))
    assert len(drawn) == drawings
    assert found is not None
    metres, angle = apart(found.pose, walk[-1])
    assert metres < 0.02 and angle < 0.5


def test_keyframes_are_decoded_before_the_camera_comes_to_them(
        monkeypatch: pytest.MonkeyPatch) -> None:
    memory = box_memory()
    guide = SceneGuide(memory, EXPANSION, thresholds=GuideThresholds(shown=1))
    there = next(int(index) for index in np.argsort(memory.positions[:, 0])[::-1])
    end = memory.positions[there]
    walk = [planar(end[0] - 0.3 + 0.06 * step, end[1], 180) for step in range(4)]
    asked: list[tuple[int, float]] = []
    decode_ahead = memory.decode_ahead

    def watched(indices: list[int], focal: float) -> None:
        asked.extend((index, focal) for index in indices)
        decode_ahead(indices, focal)
    monkeypatch.setattr(memory, 'decode_ahead', watched)
    for pose in walk:
        assert guide.guide(photo_at(pose)) is not None
    assert asked[-2:] == [(there, guide.aligner.levels[0].fx), (there, EXPANSION.target.fx)]


def test_a_jump_is_no_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    assert guide.guide(photo_at(planar(1.4, 1.5, 20))) is not None
    found = guide.guide(photo_at(planar(3.0, 2.0, 200)))
    starts: list[CameraPose] = []
    align = guide.aligner.align

    def watched(photo: Any, start: CameraPose, *arguments: Any, **options: Any) -> CameraPose:
        starts.append(start)
        return align(photo, start, *arguments, **options)
    monkeypatch.setattr(guide.aligner, 'align', watched)
    assert guide.guide(photo_at(planar(3.02, 2.0, 201))) is not None
    assert found is not None and apart(starts[0], found.pose)[0] < 1e-6


def test_images_from_elsewhere_get_no_guide_and_the_scene_is_found_again() -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    noise = np.random.default_rng(0).integers(0, 256, (64, 64, 3), np.uint8)
    assert guide.guide(photo_at(TRUE_POSE)) is not None
    assert [guide.guide(noise) for _ in range(3)] == [None] * 3
    back = [guide.guide(photo_at(TRUE_POSE)) for _ in range(5)]
    assert back[-1] is not None


def test_a_finger_on_the_lens_is_no_wall() -> None:
    extrapolator = FovExtrapolator.load(share_dir() / 'models/demo_flat.onnx')
    source = extrapolator.expansion.source
    light = np.linspace(0.5, 1, source.width)[:, None] * [96, 34, 24]
    finger = np.rint(np.broadcast_to(light, (source.height, source.width, 3))).astype(np.uint8)
    assert not any(extrapolator.expand(finger).guided for _ in range(6))


def test_an_occluder_does_not_drag_the_pose() -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    for step in range(4):
        pose = planar(1.9 + 0.02 * step, 1.7, 35 + step)
        image = photo_at(pose).copy()
        if step >= 2:
            image[20:, 10:38] = (60, 40, 50)  # 30 % of the image
        found = guide.guide(image)
        assert found is not None
        assert apart(found.pose, pose)[0] < 0.02


def test_a_camera_that_stops_behind_an_occluder_is_not_lost() -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    for yaw in (20, 29, 38):
        assert guide.guide(photo_at(planar(1.9, 1.7, yaw))) is not None
    image = photo_at(planar(1.9, 1.7, 38)).copy()
    image[:, 22:43] = (60, 40, 50)  # a third of the image
    found = guide.guide(image)
    assert found is not None and apart(found.pose, planar(1.9, 1.7, 38))[0] < 0.02


def test_a_pose_that_was_searched_for_has_to_agree_more(monkeypatch: pytest.MonkeyPatch) -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    for whole, partial, searched in ((0.91, 0, True), (0.88, 0.999, True), (0.88, 0.99, False),
                                     (0.84, 0.999, False)):
        monkeypatch.setattr(looking, 'agreement', lambda *images: (whole, partial))
        monkeypatch.setattr(looking, 'fine_agreement', lambda *images: 0.79)
        guide.reset()
        assert (guide.guide(photo_at(TRUE_POSE)) is not None) == searched
        image = guide._camera_image(photo_at(TRUE_POSE))
        guide._last = guide._looker.look(image, TRUE_POSE)
        assert (guide.guide(photo_at(TRUE_POSE)) is not None) == (max(whole, partial) > 0.85)


def test_a_guide_asks_for_as_much_agreement_as_it_is_told() -> None:
    for least, guided in ((0.95, True), (1.01, False)):
        guide = SceneGuide(MEMORY, EXPANSION, thresholds=GuideThresholds(
            least_agreement=least, least_partial=least, least_fine=least))
        assert (guide.guide(photo_at(TRUE_POSE)) is not None) == guided


@pytest.mark.parametrize('colour', [(60, 40, 50), (240, 230, 235)], ids=['dark', 'light'])
def test_an_occluder_does_not_change_the_exposure(colour: tuple[int, int, int]) -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    for step in range(3):
        wide, _ = view(planar(1.9 + 0.02 * step, 1.7, 35 + step), EXPANSION.target)
        image = EXPANSION.crop(wide).copy()
        if step == 2:
            image[20:, 10:38] = colour  # 30 % of the image
        found = guide.guide(image)
        assert found is not None
        ring = EXPANSION.extrapolated_mask & found.known
        assert np.abs(found.image - wide)[ring].mean() < 5


@pytest.mark.parametrize('gain', [0.3, 1.4], ids=['darker', 'lighter'])
def test_the_guide_has_the_exposure_of_the_image(gain: float) -> None:
    wide, _ = view(TRUE_POSE, EXPANSION.target)
    exposed = np.minimum(gain * wide, 255)
    found = SceneGuide(MEMORY, EXPANSION).guide(EXPANSION.crop(exposed).astype(np.uint8))
    assert found is not None
    ring = EXPANSION.extrapolated_mask & found.known
    assert np.abs(found.image - exposed)[ring].mean() < 5
    assert found.image.min() >= 0 and found.image.max() <= 255


def test_agreement_of_the_best_part_ignores_an_occluder() -> None:
    image = np.random.default_rng(0).random((30, 30))
    hidden = image.copy()
    hidden[:10] = 0
    whole, best = agreement(0.5 * hidden + 0.2, image, np.ones((30, 30), bool))
    assert whole < 0.9 and best > 0.99


def test_the_same_frames_give_the_same_bits() -> None:
    guide = SceneGuide(MEMORY, EXPANSION)
    photos = [photo_at(planar(1.4 + 0.1 * step, 1.5, 20)) for step in range(3)]
    runs = []
    for _ in range(2):
        guide.reset()
        runs.append([guide.guide(photo) for photo in photos])
    for one, other in zip(*runs):
        assert one is not None and other is not None
        assert np.array_equal(one.image, other.image)
        assert np.array_equal(one.pose.T_world_cam, other.pose.T_world_cam)


@pytest.mark.skipif(ALL_THREADS < 2, reason='one processor')
def test_a_guide_leaves_the_number_of_threads_as_it_was() -> None:
    before = get_num_threads()
    guide = SceneGuide(MEMORY, EXPANSION, threads=1)
    guide.warm_up()
    assert guide.guide(photo_at(TRUE_POSE)) is not None
    assert get_num_threads() == before > 1


def test_two_guides_never_run_parallel_loops_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    running: list[int] = []
    most: list[int] = []

    def watched(self: MemoryRenderer, pose: CameraPose, camera: Any, count: int) -> GuideView:
        running.append(1)
        most.append(len(running))
        time.sleep(0.005)
        running.pop()
        shape = (camera.height, camera.width)
        return GuideView(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32),
                         np.zeros(shape, bool))
    monkeypatch.setattr(MemoryRenderer, 'render', watched)
    guides = [SceneGuide(MEMORY, EXPANSION) for _ in range(3)]
    photo = photo_at(TRUE_POSE)
    with ThreadPoolExecutor(len(guides)) as pool:
        tasks: list[Future[Any]] = [pool.submit(guides[0].guide, photo),
                                    pool.submit(guides[1].guide, photo),
                                    pool.submit(guides[2].warm_up)]
        for task in tasks:
            task.result()
    assert max(most) == 1
