"""Poses from landmarks, in the demo flat, whose depth is known exactly."""
from box_room import apart
import cv2
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.files import share_dir
from neo_ros.memory import looking
from neo_ros.memory.landmarks import Landmarks, LandmarkThresholds, Location, Locator
from neo_ros.memory.local_features import Features
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.runtime import FovExtrapolator
from neo_ros.speed.guided import exact_landmarks
import numpy as np
import pytest

FLAT = build_demo_flat()
CAMERA = Intrinsics.from_hfov(96, 96, np.pi / 2)
WALK = walking_paths(FLAT, 1, 12, 5)[0]
# The one in the middle is not among the photos.
PHOTOS, NEW = [WALK[0], WALK[2], WALK[4], WALK[6]], WALK[3]


@pytest.fixture(scope='module')
def landmarks() -> Landmarks:
    found = exact_landmarks(CAMERA, PHOTOS)
    assert found is not None
    return found


def moved(pose: CameraPose, metres: float) -> CameraPose:
    T = pose.T_world_cam.copy()
    T[:3, 3] += [metres, 0, 0]
    return CameraPose(T)


def locate(locator: Locator, image: np.ndarray, around: CameraPose | None = None
           ) -> Location | None:
    features = locator.features(image)
    if around is not None:
        return locator.locate(features, around)
    return next(iter(locator.search(features)), None)


@pytest.mark.parametrize('off', [None, 0.0, 0.3], ids=['anywhere', 'here', 'off by a step'])
def test_an_image_is_found(landmarks: Landmarks, off: float | None) -> None:
    image, _ = FLAT.render(CAMERA, NEW)
    found = locate(Locator(landmarks, CAMERA), image, None if off is None else moved(NEW, off))
    assert found is not None
    metres, degrees = apart(found.pose, NEW)
    assert metres < 0.03 and degrees < 0.5
    assert len(found.points) == len(found.pixels) > 50


@pytest.mark.parametrize('size', [96, 960], ids=['small', 'large'])
def test_a_soft_image_of_any_size_is_found(landmarks: Landmarks, size: int) -> None:
    camera = Intrinsics.from_hfov(size, size, np.pi / 2)
    image = cv2.resize(FLAT.render(CAMERA, NEW)[0], (size, size), interpolation=cv2.INTER_CUBIC)
    found = locate(Locator(landmarks, camera), image)
    assert found is not None and len(found.points) > 50
    metres, degrees = apart(found.pose, NEW)
    assert metres < 0.03 and degrees < 0.5 and found.allows(NEW)


def test_other_poses_are_allowed_as_far_as_landmarks_can_tell(landmarks: Landmarks) -> None:
    found = locate(Locator(landmarks, CAMERA), FLAT.render(CAMERA, NEW)[0])
    assert found is not None
    assert found.allows(found.pose) and found.allows(NEW)
    assert not found.allows(moved(NEW, 0.1))
    # Landmarks behind a camera are not seen by it.
    about = NEW.T_world_cam @ np.diag([-1.0, 1, -1, 1])
    assert not found.allows(CameraPose(about))


def test_a_pose_that_most_pairs_fit_is_allowed_whichever_few_were_chosen() -> None:
    """Some pairs agree on a pose that is 0.2 metres off, as they are in a small image."""
    random = np.random.default_rng(0)
    own, other = moved(NEW, 0.2), NEW
    points = np.stack([own.position + own.forward * z + side for z, side in zip(
        random.uniform(2, 4, 60), random.uniform(-0.8, 0.8, (60, 3)))])

    def seen(pose: CameraPose, which: slice) -> np.ndarray:
        in_camera = (points[which] - pose.position) @ pose.T_world_cam[:3, :3]
        return CAMERA.project(in_camera) + random.normal(0, 0.3, in_camera[:, :2].shape)

    few, most = slice(0, 22), slice(22, 60)
    chosen = Location(own, CAMERA, points[few], seen(own, few), LandmarkThresholds(),
                      points[most], seen(other, most))
    assert chosen.allows(other) and chosen.allows(own)
    alone = chosen._replace(other_points=points[:0], other_pixels=np.zeros((0, 2)))
    assert not alone.allows(other)


def test_limits_are_of_the_image_that_features_are_found_in(landmarks: Landmarks) -> None:
    for width, pixels in ((64, 1.0), (128, 4 / 3), (192, 2.0), (640, 2.0)):
        locator = Locator(landmarks, Intrinsics.from_hfov(width, width, np.pi / 2))
        assert locator.thresholds.inlier_pixels == pytest.approx(pixels)


def test_what_shows_something_else_is_not_found(landmarks: Landmarks) -> None:
    locator = Locator(landmarks, CAMERA)
    noise = np.random.default_rng(0).integers(0, 256, (96, 96, 3), np.uint8)
    assert locate(locator, noise) is None
    assert locate(locator, np.full((96, 96, 3), 90, np.uint8)) is None
    image, _ = FLAT.render(CAMERA, NEW)
    behind = NEW.T_world_cam @ np.diag([-1.0, 1, -1, 1])
    assert locate(locator, image, CameraPose(behind)) is None


def test_landmarks_are_what_several_photos_show() -> None:
    points = np.arange(12.0).reshape(4, 3)
    descriptors = np.eye(128, dtype=np.float32)[:8]
    point_of = np.array([2, 2, 2, 0, 0, -1, 3, 3])
    found = Landmarks.from_observations(points, point_of, descriptors)
    assert found is not None and np.array_equal(found.points, points[[2]])
    # The mean of three descriptors, of length 1, x 512, in a byte.
    assert found.descriptors[0].tolist() == [255] * 3 + [0] * 125
    assert Landmarks.from_observations(points, point_of[3:], descriptors[3:]) is None


@pytest.fixture(scope='module')
def shipped() -> tuple[SceneMemory, ViewExpansion]:
    card = FovExtrapolator.load(share_dir() / 'models/demo_flat.onnx', guided=False).card
    assert card.memory is not None
    path = share_dir() / 'models' / card.memory.file
    return SceneMemory.read(path, card.memory.sha256), card.expansion


@pytest.mark.slow
def test_landmarks_lead_where_alignment_is_drawn_aside(
        shipped: tuple[SceneMemory, ViewExpansion], monkeypatch: pytest.MonkeyPatch) -> None:
    memory, expansion = shipped
    walk = walking_paths(FLAT, 1, 40, 5)[0][:6]
    poses = []
    for known in (memory.landmarks, None):
        monkeypatch.setattr(memory, 'landmarks', known)
        guide = SceneGuide(memory, expansion)
        align = guide.aligner.align
        monkeypatch.setattr(guide.aligner, 'align', lambda *a, **o: moved(align(*a, **o), 0.06))
        found = [guide.guide(FLAT.render(expansion.source, pose)[0]) for pose in walk]
        poses.append([one.pose for one in found if one is not None])
    led, drawn = ([apart(*pair)[0] for pair in zip(found, walk)] for found in poses)
    assert len(led) == 6 and max(led) < 0.03
    assert not drawn or max(drawn) > 0.05


@pytest.mark.slow
def test_while_landmarks_lead_alignment_says_where_exactly_as_far_as_they_allow(
        shipped: tuple[SceneMemory, ViewExpansion], monkeypatch: pytest.MonkeyPatch) -> None:
    guide = SceneGuide(*shipped)
    first, pose = walking_paths(FLAT, 1, 40, 5)[0][:2]
    guide.guide(FLAT.render(shipped[1].source, first)[0])
    locator = guide._places.locator
    assert locator is not None
    locate = locator.locate

    def a_little_off(features: Features, around: CameraPose) -> Location | None:
        found = locate(features, around)
        return found and found._replace(pose=moved(found.pose, 0.04))

    monkeypatch.setattr(locator, 'locate', a_little_off)
    guide._led = 1
    found = guide.guide(FLAT.render(shipped[1].source, pose)[0])
    assert found is not None and found.found == 'landmarks' and found.landmarks > 50
    assert apart(found.pose, pose)[0] < 0.015


@pytest.mark.slow
def test_landmarks_that_were_not_believed_do_not_lead(
        shipped: tuple[SceneMemory, ViewExpansion], monkeypatch: pytest.MonkeyPatch) -> None:
    guide = SceneGuide(*shipped)
    here, there = walking_paths(FLAT, 1, 40, 5)[0][0], walking_paths(FLAT, 1, 40, 5)[0][25]
    wrong, asked = Location(there, CAMERA, np.zeros((0, 3)), np.zeros((0, 2))), []
    monkeypatch.setattr(Location, 'allows', lambda *_: False)
    monkeypatch.setattr(guide._places.locator, 'search', lambda features: [wrong])
    monkeypatch.setattr(guide._places.locator, 'locate', lambda *around: asked.append(around))
    image = FLAT.render(shipped[1].source, here)[0]
    for _ in range(2):  # It is found by its looks, and followed.
        found = guide.guide(image)
        assert found is not None and apart(found.pose, here)[0] < 0.03
    assert len(asked) <= 1  # Beside the images, as for any camera that is followed.


@pytest.mark.slow
def test_landmarks_follow_a_camera_that_is_partly_hidden(
        shipped: tuple[SceneMemory, ViewExpansion]) -> None:
    guide = SceneGuide(*shipped)
    pattern = np.random.default_rng(0).integers(0, 256, (8, 4, 3), np.uint8)
    for step, pose in enumerate(walking_paths(FLAT, 1, 40, 5)[0][:6]):
        image = FLAT.render(shipped[1].source, pose)[0]
        if step >= 2:
            side = len(image) // 16
            left = side * step
            image[:, left:left + 6 * side] = pattern.repeat(2 * side, 0).repeat(3 * side // 2, 1)
        found = guide.guide(image)
        assert found is not None and apart(found.pose, pose)[0] < 0.03, step


@pytest.mark.slow
@pytest.mark.parametrize(('whole', 'partial', 'believed'), [
    (0.6, 0.9, True), (0.4, 0.98, True), (0.4, 0.9, False)])
def test_what_landmarks_say_is_believed_unless_all_differs(
        shipped: tuple[SceneMemory, ViewExpansion], monkeypatch: pytest.MonkeyPatch,
        whole: float, partial: float, believed: bool) -> None:
    guide = SceneGuide(*shipped)
    monkeypatch.setattr(looking, 'agreement', lambda *images: (whole, partial))
    for pose in walking_paths(FLAT, 1, 40, 5)[0][:2]:
        found = guide.guide(FLAT.render(shipped[1].source, pose)[0])
        assert (found is not None) == believed
