"""What landmarks say of an image comes a fixed number of images later, on any machine."""
import threading
from typing import Any, cast

from neo_ros.geometry import CameraPose
from neo_ros.memory.landmark_watch import LandmarkWatch
from neo_ros.memory.landmarks import Location
from neo_ros.memory.sight import CameraImage
import numpy as np
import pytest


def pose_at(x: float) -> CameraPose:
    T = np.eye(4)
    T[0, 3] = x
    return CameraPose(T)


def followed(watch: LandmarkWatch, images: int) -> list[float | None]:
    """Follow so many images from x = 0, 1, ...; return what was told at each."""
    told = [watch.follow(cast(CameraImage, None), pose_at(x)) for x in range(images)]
    return [None if one is None else one[1].position[0] for one in told]


def find(image: Any, pose: CameraPose) -> Location:
    return cast(Location, pose)


@pytest.mark.parametrize('threads', [1, 2])
def test_what_is_told_and_when_depends_on_no_thread(threads: int) -> None:
    watch = LandmarkWatch(find, every=4, later=2, threads=threads)
    assert followed(watch, 9) == [None, None, 0, None, None, None, 4, None, None]


@pytest.mark.parametrize('threads', [1, 2])
def test_after_something_went_wrong_the_next_image_is_asked_about(threads: int) -> None:
    watch = LandmarkWatch(find, every=4, later=2, threads=threads)
    followed(watch, 2)
    watch.forget()
    assert followed(watch, 4) == [None, None, 0, None]


def test_where_no_landmark_is_found_nothing_is_told() -> None:
    watch = LandmarkWatch(lambda image, pose: None, every=1, later=1, threads=1)
    assert followed(watch, 6) == [None] * 6


def test_an_image_does_not_wait_for_the_landmarks_of_the_one_before() -> None:
    released = threading.Event()

    def find_late(image: Any, pose: CameraPose) -> Location:
        released.wait()
        return find(image, pose)
    watch = LandmarkWatch(find_late, every=9, later=3, threads=2)
    assert followed(watch, 3) == [None] * 3
    released.set()
    assert followed(watch, 1) == [0]
