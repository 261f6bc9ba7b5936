"""What a guide knows besides its picture, on walks through the demo flat, whose truth is known."""
import cv2
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_from_vector
from neo_ros.machine.files import share_dir
from neo_ros.memory.landmarks import Location
from neo_ros.memory.pose_covariance import in_world, located_covariance
from neo_ros.memory.sight import Guide
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest

pytestmark = pytest.mark.slow

FLAT = build_demo_flat()
CHI_SQUARED_95 = 7.815  # of three degrees of freedom
Walk = list[tuple[CameraPose, Guide]]


@pytest.fixture(scope='module')
def extrapolator() -> FovExtrapolator:
    return FovExtrapolator.load(share_dir() / 'models/demo_flat.onnx')


@pytest.fixture(scope='module')
def walk(extrapolator: FovExtrapolator) -> Walk:
    found = []
    for pose in walking_paths(FLAT, 1, 40, 9)[0]:
        guide = extrapolator.expand(FLAT.render(extrapolator.expansion.source, pose)[0]).guide
        assert guide is not None
        found.append((pose, guide))
    return found


def pose_error(pose: CameraPose, guide: Guide) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors in position (3,), metres, and rotation (3,), radians, world axes."""
    turn = pose.T_world_cam[:3, :3] @ guide.pose.T_world_cam[:3, :3].T
    return pose.position - guide.pose.position, cv2.Rodrigues(turn)[0][:, 0]


def test_the_pose_is_true(walk: Walk) -> None:
    errors = [pose_error(*one) for one in walk]
    assert np.median([np.linalg.norm(moved) for moved, _ in errors]) < 0.01
    assert np.median([np.linalg.norm(turned) for _, turned in errors]) < np.radians(0.2)


def test_errors_lie_within_the_covariance(walk: Walk) -> None:
    inside = []
    for pose, guide in walk:
        covariance = guide.covariance
        assert covariance.shape == (6, 6) and np.allclose(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0
        inside.append([error @ np.linalg.inv(part) @ error < CHI_SQUARED_95 for error, part in zip(
            pose_error(pose, guide), (covariance[:3, :3], covariance[3:, 3:]))])
        # Not by saying that nothing is known.
        assert np.sqrt(np.diag(covariance)).max() < 0.1
    assert np.mean(inside, axis=0).min() > 0.85


def test_depth_is_true_and_says_what_it_does_not_know(
        extrapolator: FovExtrapolator, walk: Walk) -> None:
    ring, errors = extrapolator.extrapolated_mask > 0, []
    for pose, guide in walk[::10]:
        true, depth = FLAT.render(extrapolator.expansion.target, pose)[1], guide.depth()
        assert depth.dtype == np.float32 and depth.shape == true.shape
        known = ring & np.isfinite(depth)
        assert known.sum() > 0.85 * ring.sum() and not np.isfinite(depth[guide.stretched]).any()
        errors.append(np.abs(depth - true)[known] / true[known])
    assert np.median(np.concatenate(errors)) < 0.06


def test_it_is_told_how_the_camera_was_found(extrapolator: FovExtrapolator, walk: Walk) -> None:
    assert walk[0][1].found == 'landmarks' and walk[0][1].landmarks >= 20
    assert 'tracked' in {guide.found for _, guide in walk[1:]}
    assert all(guide.agreement > 0.5 for _, guide in walk)
    noise = np.random.default_rng(0).integers(0, 256, (*FLAT.render(
        extrapolator.expansion.source, walk[0][0])[0].shape,), np.uint8)
    extrapolator.reset()
    assert extrapolator.expand(noise).guide is None


def test_the_covariance_of_landmarks_is_that_of_their_projection() -> None:
    random = np.random.default_rng(0)
    camera = Intrinsics.from_hfov(128, 128, np.pi / 2)
    pose = CameraPose.from_planar(1.0, 2.0, 1.5, 0.4)
    local = np.column_stack([random.uniform(-1, 1, (30, 2)), random.uniform(2, 4, 30)])
    points = local @ pose.T_world_cam[:3, :3].T + pose.position

    def project(step: np.ndarray) -> np.ndarray:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation_from_vector(step[3:]), step[:3]
        moved = CameraPose(pose.T_world_cam @ T)
        x, y, z = ((points - moved.position) @ moved.T_world_cam[:3, :3]).T
        return np.stack([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy], 1)

    steps = 1e-6 * np.eye(6)
    J = np.stack([(project(step) - project(-step)).ravel() / 2e-6 for step in steps], 1)
    one, two = (located_covariance(Location(pose, camera, points, project(np.zeros(6)) + off))
                for off in (1.0, 2.0))
    expected = np.linalg.inv(J.T @ J)
    assert np.allclose(one / one[0, 0], expected / expected[0, 0], rtol=1e-4, atol=1e-7)
    assert np.allclose(two, 4 * one)
    # Landmarks on one line: nothing tells the way around it.
    on_line = np.column_stack([np.zeros(8), np.linspace(-1, 1, 8), np.full(8, 3.0)])
    points = on_line @ pose.T_world_cam[:3, :3].T + pose.position
    covariance = located_covariance(
        Location(pose, camera, points, project(np.zeros(6)) + 1.0))
    assert np.linalg.eigvalsh(covariance)[-1] == pytest.approx(40) and covariance[4, 4] > 3
    turned = in_world(np.diag([1.0, 2, 3, 4, 5, 6]), CameraPose.from_planar(0, 0, 0, 0))
    # A level camera that looks along x: its z is the world's x, its y points down.
    assert np.diag(turned) == pytest.approx([3, 1, 2, 6, 4, 5])
