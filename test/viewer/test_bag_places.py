"""Where the camera was, from a bag: recorded by the replay, or found while it is widened."""
from pathlib import Path
import threading
from types import SimpleNamespace
from typing import Any

from bag_files import START_NS
from box_room import apart, box_walk, EXPANSION, SOURCE, view, write_box_model
from hand_clock import HandClock
from neo_ros.bags import replay, write_demo_bag
from neo_ros.runtime import FovExtrapolator
from neo_ros.viewer.bag_source import BagSource
from neo_ros.viewer.hub import Wanted
from neo_ros.viewer.whereabouts import Place, Whereabouts
import numpy as np
import pytest

WALK = box_walk(5)


class Seen(Whereabouts):
    """Keeps every place."""

    def __init__(self) -> None:
        self.places: list[Place] = []
        super().__init__()

    def put(self, place: Place) -> None:
        self.places.append(place)
        super().put(place)


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp('places')
    model = write_box_model(path)
    frames = [(START_NS + i * 100_000_000, view(pose, EXPANSION.target)[0], pose)
              for i, pose in enumerate(WALK)]
    write_demo_bag(path / 'camera', frames, EXPANSION)
    replay(path / 'camera', FovExtrapolator.load(model), path / 'wide')
    return path


@pytest.mark.parametrize('bag', ['camera', 'wide'])
def test_the_places_are_those_of_the_walk(folder: Path, bag: str) -> None:
    stop, where = threading.Event(), Seen()

    def publish(picture: Any) -> None:
        if len(where.places) >= 4:
            stop.set()

    hub: Any = SimpleNamespace(where=where, clock=HandClock(), wanted=Wanted(True),
                               publish=publish, report=lambda state: None, changes=0,
                               playback=None)
    source = BagSource(folder / bag, folder / 'box.onnx')
    source.run(hub, stop)
    assert (source.model is None) == (bag == 'wide')
    assert len(where.places) >= 4
    for place, pose in zip(where.places, WALK):
        metres, degrees = apart(place.pose, pose)
        assert metres < 0.03 and degrees < 1
        image = place.read_image()
        assert image is not None
        assert np.array_equal(EXPANSION.crop(image), view(pose, SOURCE)[0])
    times = np.diff([place.captured for place in where.places[:4]])
    assert times == pytest.approx([0.1] * 3)
