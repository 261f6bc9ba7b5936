"""Poses of every kind that robots record, and the options for bags that leave something out."""
from collections.abc import Callable
import json
from pathlib import Path
from typing import Any

from camera_bags import CameraBag
from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.cli.main import app
from neo_ros.errors import BagError, ConfigError, NeoError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import T_BODY_OPTICAL
import numpy as np
import pytest
from typer.testing import CliRunner
import yaml

CAMERA = Intrinsics(32, 24, 30.0, 31.0, 16.5, 12.0)
START, STEP, COUNT = 1_700_000_000_000_000_000, 100_000_000, 4
RAW, INFO = '/cam/image_raw', '/cam/camera_info'
IMAGES = np.random.default_rng(2).integers(0, 256, (COUNT, 24, 32, 3), np.uint8)
MOUNT = CameraPose.from_planar(0.2, 0.1, 0.7, 0.5).T_world_cam @ np.linalg.inv(T_BODY_OPTICAL)
MOUNT_WORDS = '0.2 0.1 0.7 0 0 0.5'


def stamps() -> range:
    return range(START, START + COUNT * STEP, STEP)


def body_poses() -> list[np.ndarray]:
    return [CameraPose.from_planar(0.3 * i, -0.1 * i, 0, 0.2 * i).T_world_cam
            @ np.linalg.inv(T_BODY_OPTICAL) for i in range(COUNT)]


def optical_poses() -> list[np.ndarray]:
    return [T @ T_BODY_OPTICAL for T in body_poses()]


def add_camera(bag: CameraBag, info: str | None = INFO) -> None:
    for stamp, image in zip(stamps(), IMAGES):
        bag.image(RAW, stamp, image)
        if info is not None:
            bag.info(info, stamp, CAMERA)


def found_poses(path: Path, options: BagOptions = BagOptions()) -> np.ndarray:
    capture = read_bag_capture(path, options)
    return np.array([frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None])


def transform_stamped(bag: CameraBag) -> None:
    for stamp, T in zip(stamps(), optical_poses()):
        bag.transform('/vicon', stamp, 'optical', T)


def whole_path(bag: CameraBag) -> None:
    poses = dict(zip(stamps(), optical_poses()))
    # What was first thought is mended by the last path, as after a closed loop.
    bag.pose_path('/slam', START, {stamp: np.eye(4) for stamp in poses})
    bag.pose_path('/slam', START + STEP, poses)


def path_in_parts(bag: CameraBag) -> None:
    entries = list(zip(stamps(), optical_poses()))
    for first in (0, 1, 2):
        bag.pose_path('/slam', entries[first][0], dict(entries[first:first + 2]))


def path_without_stamps(bag: CameraBag) -> None:
    for i, stamp in enumerate(stamps()):
        T = optical_poses()[i]
        bag.send('/slam', 'nav_msgs/msg/Path', stamp, header=bag.header(stamp, 'map'), poses=[
            bag.make('geometry_msgs/msg/PoseStamped', header=bag.header(0, 'map'),
                     pose=bag.make_pose(pose)) for pose in (np.eye(4), T)])


def array_of_one(bag: CameraBag) -> None:
    for stamp, T in zip(stamps(), optical_poses()):
        bag.pose_array('/tag', stamp, [T])


def foreign_tf(bag: CameraBag) -> None:
    bag.tf('/r1/tf_static', START, 'base_link', 'optical', T_BODY_OPTICAL)
    for stamp, T in zip(stamps(), body_poses()):
        bag.tf('/r1/tf', stamp, 'odom', 'base_link', T)


@pytest.mark.parametrize('fill', [
    transform_stamped, whole_path, path_in_parts, path_without_stamps, array_of_one, foreign_tf],
    ids=lambda fill: fill.__name__)
def test_poses_are_read_from_every_type(
        tmp_path: Path, fill: Callable[[CameraBag], None]) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        fill(bag)
    np.testing.assert_allclose(found_poses(tmp_path / 'bag'), optical_poses(), atol=1e-9)


def test_a_plan_is_no_pose_where_there_are_others(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        transform_stamped(bag)
        bag.pose_path('/plan', START, {START: np.eye(4), START + STEP: np.eye(4)})
    np.testing.assert_allclose(found_poses(tmp_path / 'bag'), optical_poses(), atol=1e-9)


def test_particles_are_named(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        bag.pose_array('/particles', START, optical_poses())
    capture = read_bag_capture(tmp_path / 'bag')
    assert not capture.posed and any('/particles is not read' in note for note in capture.notes)


def test_one_robot_of_two_is_chosen(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        foreign_tf(bag)
        bag.tf('/tf', START, 'odom', 'base_link', np.eye(4))
    chosen = found_poses(tmp_path / 'bag', BagOptions(pose_topic='/r1/tf'))
    np.testing.assert_allclose(chosen, optical_poses(), atol=1e-9)


@pytest.mark.parametrize('x_forward', [False, True])
@pytest.mark.parametrize('kind', ['tf', 'odometry', 'vicon'])
def test_a_bag_without_static_transforms_is_told_where_the_camera_is(
        tmp_path: Path, kind: str, x_forward: bool) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        for stamp, T in zip(stamps(), body_poses()):
            if kind == 'tf':
                bag.tf('/tf', stamp, 'odom', 'base_link', T)
                bag.tf('/tf', stamp, 'base_link', 'wheel', T)
            elif kind == 'odometry':
                bag.odometry('/odom', stamp, 'base_link', T)
            else:
                bag.transform('/vicon', stamp, 'firefly', T)
    with pytest.raises(BagError, match='--base-to-camera'):
        read_bag_capture(tmp_path / 'bag')
    # The frame of an optical camera is turned against the body.
    words = MOUNT_WORDS if x_forward else f'0.2 0.1 0.7 {-np.pi / 2} 0 {0.5 - np.pi / 2}'
    found = found_poses(tmp_path / 'bag', BagOptions(base_to_camera=words, x_forward=x_forward))
    expected = [T @ MOUNT @ T_BODY_OPTICAL for T in body_poses()]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_calibration_may_stand_elsewhere(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag, '/calibration')
        transform_stamped(bag)
    with pytest.raises(BagError, match='--info-topic.*--camera-info'):
        read_bag_capture(tmp_path / 'bag')
    capture = read_bag_capture(tmp_path / 'bag', BagOptions(info_topic='/calibration'))
    lens = capture.frames[0].lens
    assert lens is not None and lens.intrinsics == CAMERA
    with pytest.raises(BagError, match='--info-topic: expected .* on /no.*/calibration'):
        read_bag_capture(tmp_path / 'bag', BagOptions(info_topic='/no'))


def calibration(**changes: Any) -> dict[str, Any]:
    return {
        'image_width': 32, 'image_height': 24, 'camera_name': 'eye',
        'camera_matrix': {'rows': 3, 'cols': 3,
                          'data': [30.0, 0, 16.0, 0, 31.0, 11.5, 0, 0, 1]},
        'distortion_model': 'plumb_bob',
        'distortion_coefficients': {'rows': 1, 'cols': 5, 'data': [0.1, 0, 0, 0, 0]}, **changes}


@pytest.mark.parametrize('content, distortion', [
    (calibration(), (0.1, 0, 0, 0, 0)),
    ({'w': 32, 'h': 24, 'fl_x': 30, 'fl_y': 31, 'cx': 16.5, 'cy': 12, 'k1': 0.2},
     (0.2, 0, 0, 0, 0)),
], ids=['camera_calibration', 'transforms'])
def test_a_calibration_may_stand_in_a_file(
        tmp_path: Path, content: dict[str, Any], distortion: tuple[float, ...]) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag, None)
        transform_stamped(bag)
    file = tmp_path / 'camera'
    file.write_text(yaml.safe_dump(content) if 'camera_matrix' in content else json.dumps(content))
    lens = read_bag_capture(tmp_path / 'bag', BagOptions(camera_info=file)).frames[0].lens
    assert lens is not None
    assert (lens.intrinsics, lens.distortion) == (CAMERA, distortion)


@pytest.mark.parametrize('text, message', [
    ('- 1', 'expected camera_calibration.*got list'),
    ('a: 1', 'expected camera_calibration.*got a'),
    ('a: [', 'expected YAML or JSON'),
    (yaml.safe_dump({key: value for key, value in calibration().items() if key != 'image_width'}),
     'expected the key image_width'),
    (yaml.safe_dump(calibration(projection_matrix={'data': [1, 2]})),
     'projection_matrix: expected 12 numbers, got 2'),
    (yaml.safe_dump(calibration(distortion_model='mystery')), "'mystery'"),
], ids=['list', 'other keys', 'no yaml', 'no width', 'short matrix', 'model'])
def test_a_file_that_is_no_calibration_is_named(tmp_path: Path, text: str, message: str) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag, None)
    file = tmp_path / 'camera.yaml'
    file.write_text(text)
    with pytest.raises(NeoError, match=f'--camera-info .*camera.yaml: .*{message}'):
        read_bag_capture(tmp_path / 'bag', BagOptions(camera_info=file))


@pytest.mark.parametrize('options, message', [
    ({'base_to_camera': '1 2 3'}, 'six numbers.*1 2 3'),
    ({'base_to_camera': '1 2 3 a b c'}, 'six numbers'),
    ({'base_to_camera': '1 2 3 0 0 nan'}, 'six numbers'),
    ({'info_topic': '/a', 'camera_info': Path('b')}, 'expected one of them, got both'),
])
def test_options_that_cannot_be_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        BagOptions(**options)


@pytest.mark.slow
def test_a_frame_that_looks_along_x_is_advised_its_option(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        add_camera(bag)
        for stamp, T in zip(stamps(), body_poses()):
            bag.transform('/gazebo', stamp, 'optical', T)
    command = ['import', str(tmp_path / 'bag'), str(tmp_path / 'scene')]
    result = CliRunner().invoke(app, command)
    words = ' '.join(result.output.split())
    assert result.exit_code == 0 and '--x-forward' in words and '--level' not in words
    result = CliRunner().invoke(app, [*command[:2], str(tmp_path / 'b'), '--x-forward'])
    words = ' '.join(result.output.split())
    assert result.exit_code == 0 and 'degrees from' not in words and '--level' not in words
    np.testing.assert_allclose(found_poses(
        tmp_path / 'bag', BagOptions(x_forward=True)), optical_poses(), atol=1e-9)
