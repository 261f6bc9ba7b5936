"""A place that landmarks tell badly is looked at closer, where the image surely agrees."""
from dataclasses import replace

from box_room import apart, box_memory, EXPANSION, planar, SOURCE, view
from neo_ros.memory.local_features import find_features
from neo_ros.memory.looking import Looker
from neo_ros.memory.place_finder import PlaceFinder
from neo_ros.memory.sight import CameraImage
from neo_ros.memory.thresholds import GuideThresholds
import numpy as np
import pytest


@pytest.mark.parametrize('hidden, moved', [(False, True), (True, False)])
def test_landmarks_that_are_off_give_way_to_what_surely_agrees(hidden: bool, moved: bool) -> None:
    memory = box_memory()
    looker = Looker(memory, EXPANSION, GuideThresholds())
    places = PlaceFinder(looker, memory, SOURCE, 1, looker.thresholds)
    true, told = planar(1.9, 1.7, 35), planar(2.1, 1.9, 45)
    pixels = view(true, SOURCE)[0].copy()
    if hidden:  # Where somebody stands, nothing agrees surely: landmarks are believed.
        pixels[16:, 16:48] = np.random.default_rng(0).integers(0, 255, (48, 32, 3))
    image = CameraImage(pixels, looker.aligner.photo(pixels), find_features)
    found = replace(looker.look(image, told), believed=True, located=True, found='landmarks')
    assert found.agreement < looker.thresholds.sure
    closer = places._surest(image, found)
    assert (closer is not found) == moved
    if moved:
        assert closer.believed and apart(closer.pose, true)[0] < 0.05
