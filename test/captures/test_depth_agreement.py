"""Depth is compared with what the poses give: said where it fits, refused in another unit."""
from dataclasses import replace
from functools import lru_cache
import math
from pathlib import Path

from camera_bags import CameraBag
from capture_files import write_image
from neo_ros.captures.capture import Capture, CapturedFrame, DepthSource
from neo_ros.captures.depth_agreement import measure_agreement
from neo_ros.captures.formats import CaptureFormat
from neo_ros.captures.importing import import_capture, ImportOptions
from neo_ros.captures.scene_writing import write_capture
from neo_ros.errors import SceneError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.progress import no_stage_progress
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest

CAMERA = Intrinsics.from_hfov(240, 180, math.radians(75))


@lru_cache(maxsize=None)
def arc() -> list[tuple[CameraPose, np.ndarray, np.ndarray]]:
    """Walk sideways through the living room: poses, photos, depth in metres."""
    flat = build_demo_flat()
    poses = [CameraPose.from_planar(2.2 + 0.09 * i, 1.1 + 0.01 * i * i / 2, 1.5, 1.2 + 0.03 * i)
             for i in range(12)]
    return [(pose, *flat.render(CAMERA, pose)) for pose in poses]


def write_arc(folder: Path, unit: float = 0.001, lengths: float = 1.0) -> Capture:
    """Return the walk with depth as of 1/1000 m a step, which is said to be `unit`."""
    frames = []
    for index, (pose, image, depth) in enumerate(arc()):
        T = pose.T_world_cam.copy()
        T[:3, 3] *= lengths
        file = write_image(folder / f'depth/{index}.png', np.rint(1000 * depth).astype(np.uint16))
        frames.append(CapturedFrame(
            f'images/{index}.png', CameraPose(T), Lens(CAMERA),
            file=write_image(folder / f'{index}.png', image), depth=DepthSource(unit, file)))
    return Capture(tuple(frames))


@pytest.mark.slow
def test_depth_that_fits_is_said_to_fit(tmp_path: Path) -> None:
    notes = write_capture(write_arc(tmp_path), tmp_path / 'scene')
    found = measure_agreement(read_scene(tmp_path / 'scene').train)
    assert found is not None and found.points > 500
    assert found.ratio == pytest.approx(1, abs=0.01) and found.close > 0.8
    note = next(note for note in notes if 'triangulated' in note)
    assert f'depth is {found.ratio:.3f} times what the poses give' in note
    assert f'{found.close:.0%} of {found.points} points are within 5% of that' in note


@pytest.mark.parametrize('unit, lengths, times, advice', [
    (0.005, 1.0, 5, '--depth-unit 0.001'), (0.001, 0.2, 5, '--scale 5'),
    (0.001, 30.0, 1 / 30, '--scale 0.0333')], ids=['depth', 'poses', 'poses of a model'])
def test_another_unit_is_refused_with_the_one_that_fits(
        tmp_path: Path, unit: float, lengths: float, times: float, advice: str) -> None:
    with pytest.raises(SceneError) as refused:
        write_capture(write_arc(tmp_path, unit, lengths), tmp_path / 'scene')
    words = str(refused.value)
    said = float(words.split('got ')[1].split()[0])
    assert said == pytest.approx(times, rel=0.02)
    option, number = advice.split()
    assert float(words.split(f'{option} ')[1].split()[0].rstrip(';,')) == pytest.approx(
        float(number), rel=0.02)
    assert not (tmp_path / 'scene/transforms_train.json').exists()


def test_depth_gives_poses_without_a_unit_their_scale(tmp_path: Path) -> None:
    capture = replace(write_arc(tmp_path, lengths=0.3), arbitrary_scale=True)
    notes = write_capture(capture, tmp_path / 'scene')
    assert any('the scale is no longer arbitrary' in note for note in notes)
    found = read_scene(tmp_path / 'scene').train
    assert not found.arbitrary_scale
    expected = [pose.position for pose, _, _ in arc()]
    np.testing.assert_allclose(found.T_world_cam[:, :3, 3], expected, rtol=0.01)


def test_photos_without_texture_say_nothing(tmp_path: Path) -> None:
    capture = write_arc(tmp_path)
    for frame in capture.frames:
        assert frame.file is not None
        write_image(frame.file, np.full((180, 240, 3), 90, np.uint8))
    notes = write_capture(capture, tmp_path / 'scene')
    assert any('depth: not compared with the poses' in note for note in notes)


@pytest.mark.slow
def test_a_bag_without_poses_gets_them_in_metres(tmp_path: Path) -> None:
    pytest.importorskip('pycolmap', reason='needs pycolmap (the train extra)')
    with CameraBag(tmp_path / 'bag') as bag:
        for index, (_, image, depth) in enumerate(arc()):
            stamp = (1 + index) * 100_000_000
            bag.info('/camera_info', stamp, CAMERA)
            bag.image('/image_raw', stamp, image)
            bag.send('/depth/image', 'sensor_msgs/msg/Image', stamp,
                     header=bag.header(stamp, 'optical'), height=180, width=240,
                     encoding='32FC1', is_bigendian=0, step=960,
                     data=depth.astype('<f4').view(np.uint8).reshape(-1))
    import_capture(tmp_path / 'bag', tmp_path / 'scene', CaptureFormat.BAG, ImportOptions(),
                   no_stage_progress)
    found = read_scene(tmp_path / 'scene').train
    assert not found.arbitrary_scale
    positions = np.array([pose.position for pose in found.poses])
    truth = np.array([pose.position for pose, _, _ in arc()])
    # The world is another one; how far the camera went is not.
    assert np.linalg.norm(positions[-1] - positions[0]) == pytest.approx(
        np.linalg.norm(truth[-1] - truth[0]), rel=0.02)
