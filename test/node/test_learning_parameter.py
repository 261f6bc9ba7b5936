"""The parameter `learn` reaches the memory, and another model can take over its journal."""
from dataclasses import fields
from pathlib import Path
from typing import Any

from box_room import EXPANSION, planar, SOURCE, view, write_box_model
from neo_ros.node.loaded_model import load_model
from neo_ros.node.parameters import NodeParameters, parameters
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest


def values(model: Path, learn: bool) -> NodeParameters:
    defaults = {name: default for name, default, _ in parameters()}
    given: dict[str, Any] = {**defaults, 'model': str(model), 'providers': ['cpu'],
                             'learn': learn}
    return NodeParameters(**{field.name: given[field.name] for field in fields(NodeParameters)})


@pytest.mark.parametrize('learn', [False, True])
def test_it_learns_where_it_is_asked_to(tmp_path: Path, learn: bool) -> None:
    asked: dict[str, Any] = {}

    def load(*arguments: Any, **more: Any) -> FovExtrapolator:
        asked.update(more)
        return FovExtrapolator.load(*arguments, **more)

    model = load_model(values(write_box_model(tmp_path), learn), load)
    assert asked == ({'learn': 'beside'} if learn else {})
    model.stop_learning()


@pytest.mark.slow
def test_learning_leaves_images_as_they_are_while_nothing_changed(tmp_path: Path) -> None:
    model = write_box_model(tmp_path)
    plain, learning, other = (FovExtrapolator.load(model, learn=learn)
                              for learn in ('never', 'beside', 'at once'))
    for step in range(8):
        image = view(planar(1.5 + 0.05 * step, 1.5, 10), SOURCE)[0]
        expected = plain.expand(image).wide_image
        assert expected.shape[:2] == (EXPANSION.target.height, EXPANSION.target.width)
        for one in (learning, other):
            np.testing.assert_array_equal(one.expand(image).wide_image, expected)
    learning.stop_learning()
    other.finish_learning()
    assert not list(tmp_path.glob('*.journal'))
