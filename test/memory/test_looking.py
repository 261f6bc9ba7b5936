"""From where a lost camera is looked for closely."""
from dataclasses import replace

from box_room import apart, box_memory, EXPANSION, planar, SOURCE, view
from neo_ros.memory.local_features import find_features
from neo_ros.memory.looking import Looker
from neo_ros.memory.sight import CameraImage
from neo_ros.memory.thresholds import GuideThresholds
import numpy as np

TRUE = planar(1.9, 1.7, 35)
# Of the places around it all lead there; the others look at other walls.
AROUND = [planar(x, 1.7 + off, 35 + 40 * off) for x in (1.8, 2.0) for off in (-0.2, 0.2)]
ELSEWHERE = [planar(1.9, 1.7, yaw) for yaw in (125, 215, 305)]


def _likely(limits: GuideThresholds = GuideThresholds()) -> list[tuple[float, float]]:
    looker = Looker(box_memory(), EXPANSION, limits)
    pixels = view(TRUE, SOURCE)[0]
    image = CameraImage(pixels, looker.aligner.photo(pixels), find_features)
    poses = looker._most_likely(image, [*ELSEWHERE, *AROUND])
    return [apart(pose, TRUE) for pose in poses]


def test_what_small_images_agree_with_is_looked_at_closely_from_where_they_lead() -> None:
    first, best, *others = _likely()
    assert first == apart(ELSEWHERE[0], TRUE)  # As somebody said, or the glance most alike.
    assert best[0] < 0.03 and best[1] < 1 < min(apart(one, TRUE)[0] for one in AROUND) * 10
    # One place is looked at once, wherever one comes from.
    assert all(metres > 0.2 or degrees > 8 for metres, degrees in others)


def test_so_many_are_looked_at_closely() -> None:
    # Also what agrees little, such as the other walls.
    limits = replace(GuideThresholds(), least_likely=-1.0)
    assert len(_likely(limits)) > 3
    assert len(_likely(replace(limits, likely=2))) == 1 + 2
    np.testing.assert_allclose(_likely(replace(limits, likely=2)), _likely(limits)[:3])
