"""Frames of a video for structure from motion: sharp, and neither too many nor too few."""
from pathlib import Path

import cv2
from neo_ros.captures import video
from neo_ros.captures.formats import CaptureFormat, detect_format, FOLDER_OPTIONS
from neo_ros.captures.video import read_video, STEP
from neo_ros.cli.import_scene import import_scene
from neo_ros.errors import SceneError
import numpy as np
import pytest

WIDTH, HEIGHT, SHIFT = 128, 96, 2  # pixels of movement a frame


def write_video(path: Path, count: int, shift: int = SHIFT, sharp_every: int = 3) -> list[int]:
    """Pan over a texture; only every n-th frame is sharp. Returns the numbers of these."""
    texture = cv2.GaussianBlur(np.random.default_rng(0).integers(
        0, 256, (HEIGHT, WIDTH + count * SHIFT, 3), np.uint8), (0, 0), 1.5)
    texture = cv2.normalize(texture, texture, 0, 255, cv2.NORM_MINMAX)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*'MJPG'), 30, (WIDTH, HEIGHT))
    assert writer.isOpened()
    for i in range(count):
        frame = texture[:, i * shift:i * shift + WIDTH]
        writer.write(frame if i % sharp_every == 0 else cv2.GaussianBlur(frame, (0, 0), 1.5))
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
