"""Frames of a video or bag for structure from motion: sharp, neither too many nor too few."""
from dataclasses import replace
from pathlib import Path

from camera_bags import CameraBag
from capture_files import START_NS, STEP_NS
import cv2
from neo_ros.captures import importing, video
from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.captures.capture import Capture
from neo_ros.captures.formats import CaptureFormat, detect_format, FOLDER_OPTIONS
from neo_ros.captures.importing import import_capture, ImportOptions
from neo_ros.captures.picture_steps import select_by_picture, STEP
from neo_ros.captures.video import read_video
from neo_ros.cli.import_scene import import_scene
from neo_ros.errors import SceneError
import numpy as np
import pytest

WIDTH, HEIGHT, SHIFT = 128, 96, 2  # pixels of movement a frame


def pan(count: int, shift: int = SHIFT, sharp_every: int = 3) -> list[np.ndarray]:
    """Pan over a texture; only every n-th frame is sharp."""
    texture = cv2.GaussianBlur(np.random.default_rng(0).integers(
        0, 256, (HEIGHT, WIDTH + count * SHIFT, 3), np.uint8), (0, 0), 1.5)
    texture = cv2.normalize(texture, texture, 0, 255, cv2.NORM_MINMAX)
    frames = [texture[:, i * shift:i * shift + WIDTH] for i in range(count)]
    return [frame if i % sharp_every == 0 else cv2.GaussianBlur(frame, (0, 0), 1.5)
            for i, frame in enumerate(frames)]


def write_video(path: Path, count: int, shift: int = SHIFT, sharp_every: int = 3) -> list[int]:
    """Write what `pan` shows. Returns the numbers of the sharp frames."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 30, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for frame in pan(count, shift, sharp_every):
        writer.write(frame)
    writer.release()
    return list(range(0, count, sharp_every))


def test_sharp_frames_are_chosen_step_by_step(tmp_path: Path) -> None:
    path = tmp_path / 'walk.avi'
    sharp = write_video(path, 40)
    assert detect_format(path) == CaptureFormat.VIDEO
    shown: list[tuple[int, int]] = []
    capture = read_video(path, lambda done, total: shown.append((done, total)))
    assert shown == [(done, 40) for done in range(1, 41)]
    numbers = [int(Path(frame.name).stem) for frame in capture.frames]
    assert set(numbers) <= set(sharp)
    steps = 40 * SHIFT / (STEP * WIDTH)
    assert steps - 2 <= len(numbers) <= steps + 1
    assert not capture.posed
    images = dict(capture.images([2, 0]))
    assert images[0] is not None and images[0].shape == (HEIGHT, WIDTH, 3)
    opened = cv2.VideoCapture(str(path))
    everything = [opened.read()[1][..., ::-1] for _ in range(40)]
    np.testing.assert_array_equal(images[2], everything[numbers[2]])


def test_a_video_that_stands_still_is_one_frame(tmp_path: Path) -> None:
    write_video(tmp_path / 'still.avi', 12, shift=0)
    assert len(read_video(tmp_path / 'still.avi')) == 1


@pytest.mark.parametrize('said, shown', [(0, []), (-1, []), (9, [*range(1, 9), 12])])
def test_progress_needs_the_number_of_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
                                             said: int, shown: list[int]) -> None:
    write_video(tmp_path / 'still.avi', 12, shift=0)
    monkeypatch.setattr(video, '_frame_count', lambda source: said)
    steps: list[int] = []
    read_video(tmp_path / 'still.avi', lambda done, total: steps.append(done))
    assert steps == shown


def test_an_import_shows_how_far_the_video_is_read(
        tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip('pycolmap', reason='needs pycolmap (the train extra)')
    write_video(tmp_path / 'still.avi', 12, shift=0)
    with pytest.raises(SceneError, match='placed none of the 1 photos'):
        import_scene(str(tmp_path / 'still.avi'), tmp_path / 'scene')
    assert 'video frames 12/12' in capsys.readouterr().out


def test_what_is_no_video_is_refused(tmp_path: Path) -> None:
    (tmp_path / 'a.mp4').write_bytes(b'no video')
    with pytest.raises(SceneError, match='expected a video'):
        read_video(tmp_path / 'a.mp4')


def test_a_video_may_come_with_its_calibration(tmp_path: Path) -> None:
    path = tmp_path / 'walk.avi'
    write_video(path, 10)
    (tmp_path / 'camera.json').write_text(
        '{"w": 128, "h": 96, "fl_x": 100, "cx": 60, "cy": 50, "k1": 0.1}')
    lenses = {frame.lens for frame in read_video(
        path, camera_info=tmp_path / 'camera.json').frames}
    lens, = lenses
    assert lens is not None and lens.distortion[0] == 0.1
    assert (lens.intrinsics.fx, lens.intrinsics.cx, lens.intrinsics.cy) == (100, 60, 50)
    assert CaptureFormat.VIDEO in FOLDER_OPTIONS['camera_info']


def write_bag(path: Path, order: list[int], depth: bool = True) -> Path:
    """Write what `pan` shows, each frame with a depth that is its number in millimetres."""
    frames = pan(len(order))
    with CameraBag(path) as bag:
        for i in order:
            stamp_ns = START_NS + i * STEP_NS
            bag.image('/image', stamp_ns, frames[i])
            if depth:
                bag.send('/depth', 'sensor_msgs/msg/Image', stamp_ns,
                         header=bag.header(stamp_ns, 'optical'), height=HEIGHT, width=WIDTH,
                         encoding='16UC1', is_bigendian=0, step=2 * WIDTH, data=np.full(
                             (HEIGHT, WIDTH), 1000 + i, np.uint16).view(np.uint8).reshape(-1))
    return path


def test_frames_of_a_bag_without_poses_are_chosen_like_those_of_a_video(tmp_path: Path) -> None:
    order = [*range(20, 40), *range(20)]  # The second half was recorded first.
    whole = read_bag_capture(write_bag(tmp_path / 'bag', order))
    shown: list[tuple[int, int]] = []
    capture = select_by_picture(whole, lambda done, total: shown.append((done, total)))
    assert shown == [(done, 40) for done in range(1, 41)]
    numbers = [int(Path(frame.name).stem) for frame in capture.frames]
    assert numbers == sorted(numbers) and set(numbers) <= set(range(0, 40, 3))
    steps = 40 * SHIFT / (STEP * WIDTH)
    assert steps - 2 <= len(numbers) <= steps + 2  # One more where the recording begins anew.
    assert capture.notes[-1] == (f'{len(numbers)} frames chosen of 40, the sharpest of every step '
                                 'of the picture')
    frames, images, depths = pan(40), dict(capture.images([2, 0])), dict(capture.depths([2, 0]))
    for index in (2, 0):
        assert capture.frames[index].stamp_ns == START_NS + numbers[index] * STEP_NS
        np.testing.assert_array_equal(images[index], frames[numbers[index]])
        depth = depths[index]
        assert depth is not None
        np.testing.assert_allclose(depth, 1 + numbers[index] / 1000, atol=1e-6)


def test_frames_that_cannot_be_read_or_change_their_size_are_no_steps_of_the_others(
        tmp_path: Path) -> None:
    images = [*pan(1), None, np.zeros((HEIGHT // 2, WIDTH, 3), np.uint8), None]
    bag = read_bag_capture(write_bag(tmp_path / 'bag', [*range(4)], depth=False))
    capture = replace(bag, stream=lambda indices: ((index, images[index]) for index in indices))
    assert [frame.name for frame in select_by_picture(capture).frames] == [
        'images/000000.png', 'images/000002.png']
    with pytest.raises(SceneError, match='none of the 4 images can be read'):
        select_by_picture(replace(bag, stream=lambda indices: (
            (index, None) for index in indices)))


@pytest.mark.parametrize('count, options', [
    (120, BagOptions()), (120, BagOptions(pose_topic='none')), (100, BagOptions())],
    ids=['has no poses', 'no poses wanted', 'few'])
def test_structure_from_motion_gets_the_chosen_frames_of_a_bag(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, options: BagOptions) -> None:
    given: list[Capture] = []

    def refused(capture: Capture, *arguments: object) -> None:
        given.append(capture)
        raise SceneError('no poses')

    monkeypatch.setattr(importing, 'reconstruct', refused)
    stages: dict[str, tuple[int, int]] = {}
    with pytest.raises(SceneError, match='no poses; ') as error:
        import_capture(
            write_bag(tmp_path / 'bag', [*range(count)]), tmp_path / 'scene', CaptureFormat.BAG,
            ImportOptions(bag=options),
            lambda stage, done, total, note='': stages.__setitem__(stage, (done, total)))
    # Of few all are taken: they are compared each with each.
    assert ('frames chosen of' in str(error.value)) == ('frames' in stages) == (count > 100)
    assert 0 < len(given[0]) < 40 if count > 100 else len(given[0]) == count
    assert stages.get('frames', (count, count)) == (count, count)
