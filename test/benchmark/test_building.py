"""A camera that is taken to another floor: what it believes there is counted."""
from types import SimpleNamespace
from typing import Any

from neo_ros.benchmark import building
from neo_ros.benchmark.building import _ride, BuildingRules, Counts
from neo_ros.flat.building_plan import FLOOR_HEIGHT
from neo_ros.geometry import CameraPose, Intrinsics
import numpy as np
import pytest

# As many images of the cab as of the walk: answers stay in step.
RULES = BuildingRules(cab_frames=3, walk_seeds=(1,))
WALK = [CameraPose.from_planar(1.0, 2.0 + 0.1 * step, 1.5, 0.3) for step in range(3)]


class Believer:
    """A guide that answers each image of a ride with a pose, or None."""

    def __init__(self, heights: list[float | None]) -> None:
        self.answers, self.images = iter(heights), list[np.ndarray]()

    def reset(self) -> None:
        self.asked = 0

    def guide(self, image: np.ndarray, prior: CameraPose | None = None) -> Any:
        self.images.append(image)
        height, pose = next(self.answers), WALK[self.asked % len(WALK)]
        self.asked += 1
        if height is None:
            return None
        x, y, _ = pose.position
        return SimpleNamespace(
            pose=CameraPose.from_planar(x, y, height, pose.yaw), found='tracked')


@pytest.mark.parametrize('after, right, wrong', [
    ([None, None, None], 0, 0), ([None, None, 1.5 + FLOOR_HEIGHT], 1, 0),
    ([1.5, None, 1.5 + FLOOR_HEIGHT], 1, 1), ([None, None, 1.5], 0, 1)])
def test_a_ride_in_a_lift(monkeypatch: pytest.MonkeyPatch, after: list[float | None],
                          right: int, wrong: int) -> None:
    source = Intrinsics.from_hfov(32, 32, np.pi / 2)
    rendered = list[CameraPose]()

    def render(_: Intrinsics, pose: CameraPose) -> tuple[np.ndarray]:
        rendered.append(pose)
        return (np.zeros((32, 32, 3), np.uint8),)

    monkeypatch.setattr(building, 'door_walks', lambda *_: [WALK])
    guide, counts = Believer([1.5, 1.5, 1.5, None, None, None, *after]), Counts()
    _ride(SimpleNamespace(render=render), source, guide, RULES, counts)  # type: ignore[arg-type]
    assert (counts.rides, counts.rides_found_right, counts.rides_ever_wrong) == (1, right, wrong)
    assert [pose.position[2] for pose in rendered] == 3 * [1.5] + 3 * [1.5 + FLOOR_HEIGHT]
    cab = guide.images[3]
    assert cab.shape == (32, 32, 3) and cab[:, 16].mean() < 60 < cab[:, 15].mean()
