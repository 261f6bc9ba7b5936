"""What landmarks say of an image comes a fixed number of images later, on any machine."""
import threading
from typing import Any, cast

from neo_ros.geometry import CameraPose
from neo_ros.memory.landmark_watch import LandmarkWatch
from neo_ros.memory.landmarks import Location, Locator
from neo_ros.memory.local_features import Features
from neo_ros.memory.sight import CameraImage
import numpy as np
import pytest


IMAGE = CameraImage(np.zeros((1, 1, 3), np.uint8), [], lambda pixels: cast(Features, None))


def pose_at(x: float) -> CameraPose:
    T = np.eye(4)
    T[0, 3] = x
    return CameraPose(T)


def followed(watch: LandmarkWatch, images: int) -> list[float | None]:
    """Follow so many images from x = 0, 1, ...; return what was told at each."""
    told = [watch.follow(IMAGE, pose_at(x)) for x in range(images)]
    return [None if one is None else one[1].position[0] for one in told]


class StandIn:
    """A locator that waits until it may answer, and finds each image or none."""

    def __init__(self, finds: bool = True) -> None:
        self.finds, self.allowed = finds, threading.Event()
        self.allowed.set()

    def locate(self, features: Any, around: CameraPose) -> Location | None:
        self.allowed.wait()
        return cast(Location, around) if self.finds else None


def watch_of(locator: StandIn | None, every: int, later: int, threads: int) -> LandmarkWatch:
    return LandmarkWatch(cast(Locator, locator), every, later, threads)


@pytest.mark.parametrize('threads', [1, 2])
def test_what_is_told_and_when_depends_on_no_thread(threads: int) -> None:
    watch = watch_of(StandIn(), 4, 2, threads)
    assert followed(watch, 9) == [None, None, 0, None, None, None, 4, None, None]


@pytest.mark.parametrize('threads', [1, 2])
def test_after_something_went_wrong_the_next_image_is_asked_about(threads: int) -> None:
    watch = watch_of(StandIn(), 4, 2, threads)
    followed(watch, 2)
    watch.forget()
    assert followed(watch, 4) == [None, None, 0, None]


@pytest.mark.parametrize('locator', [StandIn(finds=False), None], ids=['none found', 'none'])
def test_without_landmarks_nothing_is_told(locator: StandIn | None) -> None:
    assert followed(watch_of(locator, 1, 1, 1), 6) == [None] * 6


def test_an_image_does_not_wait_for_the_landmarks_of_the_one_before() -> None:
    locator = StandIn()
    locator.allowed.clear()
    watch = watch_of(locator, 9, 3, threads=2)
    assert followed(watch, 3) == [None] * 3
    locator.allowed.set()
    assert followed(watch, 1) == [0]
