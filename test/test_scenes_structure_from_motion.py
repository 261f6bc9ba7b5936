"""Poses for photos without poses; skipped where pycolmap is not installed."""
from dataclasses import replace
import math
from pathlib import Path

from capture_files import write_image
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.camera_pose import rotation_vector
from neo_ros.scenes.capture_writing import write_capture
from neo_ros.scenes.demo_captures import render_demo_views
from neo_ros.scenes.lens import Lens
from neo_ros.scenes.photos import read_photos
from neo_ros.scenes.scene import read_scene
from neo_ros.scenes.structure_from_motion import photo_pairs, reconstruct
import numpy as np
import pytest

CAMERA = Intrinsics.from_hfov(240, 180, math.radians(75))
COUNT = 15


def needs_pycolmap() -> None:
    pytest.importorskip('pycolmap', reason='needs pycolmap (the train extra)')


def arc(count: int) -> list[CameraPose]:
    """Walk sideways through the living room and turn a little."""
    return [CameraPose.from_planar(2.2 + 0.09 * i, 1.1 + 0.01 * i * i / 2, 1.5, 1.2 + 0.03 * i)
            for i in range(count)]


def test_photos_get_the_poses_they_were_taken_from(tmp_path: Path) -> None:
    needs_pycolmap()
    poses = arc(COUNT)
    for index, image in enumerate(render_demo_views(CAMERA, poses, workers=1)):
        write_image(tmp_path / f'photos/{index}.png', image)

    def interrupt(stage: str, done: int, total: int) -> None:
        if stage == 'matches':
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reconstruct(read_photos(tmp_path / 'photos'), tmp_path / 'sfm', interrupt)
    assert (tmp_path / 'sfm/database.db').is_file()
    stages: dict[str, tuple[int, int]] = {}
    capture, verdict = reconstruct(  # goes on
        read_photos(tmp_path / 'photos'), tmp_path / 'sfm',
        lambda stage, done, total: stages.__setitem__(stage, (done, total)))
    assert stages == {'images': (COUNT, COUNT), 'features': (COUNT, COUNT),
                      'matches': (COUNT * (COUNT - 1) // 2,) * 2, 'poses': (COUNT, COUNT)}
    assert (verdict.registered, verdict.photos) == (COUNT, COUNT)
    assert 0 < verdict.reprojection_error < 1
    assert 'arbitrary, not metres' in str(verdict)
    check_poses(capture.frames, poses)
    write_capture(capture, tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    assert found.intrinsics.hfov == pytest.approx(CAMERA.hfov, rel=0.1)  # self-calibrated
    # Again: the model is there, nothing is computed.
    stages.clear()
    again, verdict_again = reconstruct(
        read_photos(tmp_path / 'photos'), tmp_path / 'sfm',
        lambda stage, done, total: stages.__setitem__(stage, (done, total)))
    assert stages.keys() == {'images'} and verdict_again == verdict
    np.testing.assert_array_equal(
        [frame.pose.T_world_cam for frame in again.frames if frame.pose is not None],
        [frame.pose.T_world_cam for frame in capture.frames if frame.pose is not None])


def test_a_calibration_is_held_fixed(tmp_path: Path) -> None:
    needs_pycolmap()
    poses = arc(6)
    for index, image in enumerate(render_demo_views(CAMERA, poses, workers=1)):
        # Blanks in names end them in COLMAP's list of pairs.
        write_image(tmp_path / f'photos/IMG 1 ({index}).png', image)
    photos = read_photos(tmp_path / 'photos')
    capture, verdict = reconstruct(replace(photos, frames=tuple(
        replace(frame, lens=Lens(CAMERA)) for frame in photos.frames)), tmp_path / 'sfm')
    assert verdict.registered == 6
    assert {frame.lens for frame in capture.frames} == {Lens(CAMERA)}
    check_poses(capture.frames, poses)


def check_poses(frames: object, poses: list[CameraPose]) -> None:
    """Compare up to a turn about z, a scale and a shift: nobody can know more than that."""
    assert isinstance(frames, tuple)
    found = [frame.pose for frame in frames]
    first, last = found[0], found[-1]
    for a, b, true_a, true_b in zip(found, found[1:], poses, poses[1:]):
        turn = rotation_vector(a.T_world_cam[:3, :3].T @ b.T_world_cam[:3, :3])
        truth = rotation_vector(true_a.T_world_cam[:3, :3].T @ true_b.T_world_cam[:3, :3])
        np.testing.assert_allclose(turn, truth, atol=math.radians(0.5))
    scale = np.linalg.norm(last.position - first.position) / np.linalg.norm(
        poses[-1].position - poses[0].position)
    steps = [np.linalg.norm(b.position - a.position) / scale for a, b in zip(found, found[1:])]
    truth_steps = [np.linalg.norm(b.position - a.position) for a, b in zip(poses, poses[1:])]
    np.testing.assert_allclose(steps, truth_steps, rtol=0.25)
    assert all(abs(pose.forward[2]) < math.sin(math.radians(3)) for pose in found)  # level


def test_photos_of_nothing_are_refused(tmp_path: Path) -> None:
    needs_pycolmap()
    for index in range(3):
        write_image(tmp_path / f'photos/{index}.png', np.full((60, 80, 3), 128, np.uint8))
    with pytest.raises(SceneError, match='placed none of the 3 photos.*texture'):
        reconstruct(read_photos(tmp_path / 'photos'), tmp_path / 'sfm')


@pytest.mark.parametrize('count', [2, 100, 101, 1000])
def test_photos_are_compared_with_their_neighbours_and_no_pair_twice(count: int) -> None:
    names = [f'{i:04d}' for i in range(count)]
    pairs = photo_pairs(names)
    assert len(pairs) == len(set(pairs)) == len({frozenset(pair) for pair in pairs})
    assert set(zip(names, names[1:])) <= set(pairs)
    assert len(pairs) <= max(count * (count - 1) // 2 if count <= 100 else 20 * count, 1) + 1770
    if count > 100:
        assert (names[0], names[-1]) in pairs  # a loop can close
