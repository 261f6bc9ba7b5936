"""A video without poses: the sharpest frame of every step that the picture moves."""
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
from neo_ros.captures.camera_file import read_camera_file
from neo_ros.captures.capture import Capture, CapturedFrame, origin_of
from neo_ros.captures.picture_steps import chosen_note, PictureSteps
from neo_ros.errors import SceneError
from neo_ros.machine.progress import no_progress, Progress
import numpy as np

VIDEO_SUFFIXES = ('.mp4', '.mov', '.avi', '.mkv', '.webm', '.m4v')


def read_video(source: Path, progress: Progress = no_progress,
               camera_info: Path | None = None) -> Capture:
    """
    Choose frames of a video for structure from motion.

    camera_info: the calibration of its frames, else the camera is estimated.

    Progress is shown of videos that say how many frames they have. Raises SceneError for files
    that are no video.
    """
    lens = None if camera_info is None else read_camera_file(camera_info)
    total = _frame_count(source)
    steps, count = PictureSteps(), 0
    for index, image in _frames(source):
        count = index + 1
        steps.add(index, image)
        if count < total:
            progress(count, total)
    chosen = steps.chosen
    if not chosen:
        raise SceneError(f'{source}: expected a video that OpenCV can read, got no frame')
    if total > 0:
        progress(count, count)  # Many videos say a few more or less than they have.

    def stream(indices: Sequence[int]) -> Iterator[tuple[int, np.ndarray | None]]:
        wanted = {chosen[index]: index for index in indices}
        if wanted:
            for number, image in _frames(source):
                if number in wanted:
                    yield wanted.pop(number), image
                if not wanted:
                    return
            yield from ((index, None) for index in wanted.values())

    return Capture(tuple(CapturedFrame(f'images/{number:06d}.png', None, lens)
                         for number in chosen),
                   (chosen_note(len(chosen), count),), stream, origin_of(source))


def _frames(source: Path) -> Iterator[tuple[int, np.ndarray]]:
    """Yield (number, RGB uint8 (H, W, 3)) of all frames."""
    video = cv2.VideoCapture(str(source))
    try:
        number = 0
        while True:
            there, image = video.read()
            if not there:
                return
            yield number, cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
            number += 1
    finally:
        video.release()


def _frame_count(source: Path) -> int:
    """Return how many frames the file says it has; 0 or less if it does not."""
    video = cv2.VideoCapture(str(source))
    try:
        return int(video.get(cv2.CAP_PROP_FRAME_COUNT))
    finally:
        video.release()
