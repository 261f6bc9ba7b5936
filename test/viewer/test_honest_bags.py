"""A bag says of its pictures what the node would have said: of the scene, the place, the time."""
from typing import Any

from box_room import box_walk, EXPANSION, planar, view, write_box_model
from camera_bags import CameraBag
from neo_ros.bags import replay
from neo_ros.runtime import FovExtrapolator
from neo_ros.runtime.scene_check import fit_scene_reference
from neo_ros.viewer.bag_source import BagSource
import numpy as np
from picture_collector import collect
import pytest

START_NS, STEP_NS = 1_700_000_000 * 10**9, 400_000_000
KNOWN, FOREIGN = 3, 6


@pytest.fixture(scope='module')
def model(tmp_path_factory):
    photos = np.stack([view(planar(x, y, yaw), EXPANSION.source)[0]
                       for x in (1.2, 2.2, 3.2) for y in (1.2, 2.2) for yaw in range(0, 360, 15)])
    sureness = np.where(EXPANSION.extrapolated_mask, 64, 255).astype(np.uint8)
    reference = fit_scene_reference(photos, lambda _: sureness, EXPANSION)
    return write_box_model(tmp_path_factory.mktemp('model'), scene_reference=reference)


@pytest.fixture(scope='module')
def camera_bag(tmp_path_factory):
    """Walk through the room, and then look at noise."""
    path = tmp_path_factory.mktemp('bag') / 'walk'
    random = np.random.default_rng(0)
    images = [view(pose, EXPANSION.source)[0] for pose in box_walk(KNOWN)]
    images += [random.integers(0, 256, images[0].shape, np.uint8) for _ in range(FOREIGN)]
    with CameraBag(path) as bag:
        for number, image in enumerate(images):
            bag.log_ns = START_NS + number * STEP_NS - 1
            bag.image('/eye/image_raw', START_NS + number * STEP_NS, image)
    return path


@pytest.fixture(scope='module')
def wide_bag(camera_bag, model, tmp_path_factory):
    path = tmp_path_factory.mktemp('bag') / 'wide'
    replay(camera_bag, FovExtrapolator.load(model), path)
    return path


@pytest.mark.parametrize('replayed', [True, False], ids=['replayed', 'widened here'])
def test_an_unknown_place_is_named_in_every_round(camera_bag, wide_bag, model, replayed):
    count = KNOWN + FOREIGN
    source = BagSource(wide_bag if replayed else camera_bag, model)
    hub: Any = collect(source, count + 1, again=True)
    # The state at each picture: what was told last before the next one.
    verdicts = [hub.at_pictures[number] for number in range(count + 1)]
    assert [state.recognised for state in verdicts[1:KNOWN]] == (KNOWN - 1) * [True]
    assert not any(state.out_of_scene for state in verdicts[:KNOWN])
    assert [state.recognised for state in verdicts[KNOWN + 1:count]] == (FOREIGN - 1) * [False]
    assert verdicts[count - 1].out_of_scene
    # What is made here is judged by the last five seconds, of which the bag's end is a part.
    assert replayed or verdicts[count].out_of_scene


def test_pictures_of_a_bag_say_when_they_were_recorded(wide_bag, model):
    hub: Any = collect(BagSource(wide_bag, model, rate=3), KNOWN)
    start = START_NS / 1e9
    assert np.allclose([picture.recorded for picture in hub.pictures],
                       start + STEP_NS / 1e9 * np.arange(KNOWN))
    span = start, start + (KNOWN + FOREIGN - 1) * STEP_NS / 1e9
    assert all(np.allclose(state.span, span) for state in hub.states)
