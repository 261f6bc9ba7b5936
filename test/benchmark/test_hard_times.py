"""A guided model is hardly worse than its network anywhere: the demo flat, without a training."""
from pathlib import Path

from neo_ros.benchmark.hard_times import AWAY, cases, markdown, score_cases, Shot
from neo_ros.errors import ModelError
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.speed.guided import level_pose, write_guided_stand_in
import numpy as np
import pytest
from tiny_model import write_tiny_model

pytestmark = pytest.mark.slow

VIEW = ViewExpansion.to_size(Intrinsics.from_hfov(64, 64, np.pi / 2), 128, 128)
WALKS = [[level_pose(np.array([x + 0.03 * step, 1.55, 1.5]), yaw + 0.1 * step)
          for step in range(12)] for x, yaw in ((2.9, 2.0), (3.4, 4.0))]


@pytest.fixture(scope='module')
def walks():
    flat = build_demo_flat()
    truths = [[flat.render(VIEW.target, pose)[0] for pose in walk] for walk in WALKS]
    return [[Shot(np.ascontiguousarray(VIEW.crop(truth)), truth) for truth in walk]
            for walk in truths]


def test_the_memory_helps_or_stays_out_of_it(walks, tmp_path: Path) -> None:
    model = write_guided_stand_in(tmp_path, VIEW, [pose for walk in WALKS for pose in walk])
    noise = np.random.default_rng(0).integers(0, 256, (AWAY, 64, 64, 3)).astype(np.uint8)
    rows = {row.case: row for row in score_cases(model, walks, list(noise))}
    plain, carried, away, hidden, *_ = rows.values()
    assert plain.frames == carried.frames == away.frames == hidden.frames == 24
    assert plain.known == 1 and plain.search is None
    assert carried.known > 0.9 and carried.search is not None and carried.search <= 1
    assert away.elsewhere_known == 0 and away.known > 0.9
    assert hidden.known > 0.7
    for row in rows.values():
        assert -0.1 < row.worst_walk <= row.ring_psnr - row.network_psnr, row
    assert carried.worst_walk < carried.ring_psnr - carried.network_psnr - 0.01
    assert plain.ring_psnr > plain.network_psnr + 5
    assert markdown([away]).splitlines()[-1].startswith('| out of the scene and back | 24 | ')


def test_cases_are_what_they_are_called(walks) -> None:
    found = cases(walks, [np.zeros((64, 64, 3), np.uint8)] * 20)
    (carried,) = found['carried elsewhere every 5 images']
    assert [index for index, shot in enumerate(carried) if shot.arrived] == [0, 5, 10, 15, 20, 22]
    assert carried[5].image is walks[1][0].image and carried[10].image is walks[0][5].image
    away = found['out of the scene and back'][0]
    assert [shot.truth is None for shot in away] == [False] * 6 + [True] * 10 + [False] * 6
    assert away[16].arrived and not away[17].arrived
    # Those of a walk are told apart from the others', however they are mixed.
    assert [shot.walk for shot in carried] == [*[0] * 5, *[1] * 5] * 2 + [0, 0, 1, 1]
    assert {shot.walk for walk in found['a quarter of the light'][1:] for shot in walk} == {1}
    hidden = found['30 % of the image hidden'][0]
    assert np.array_equal(hidden[1].image, walks[0][1].image)
    share = (hidden[4].image != walks[0][4].image).any(-1).mean()
    assert share == pytest.approx(0.3, abs=0.02) and hidden[4].truth is walks[0][4].truth
    dim = found['a quarter of the light'][0][0]
    assert dim.truth is not None
    assert dim.truth.mean() == pytest.approx(walks[0][0].truth.mean() / 4, abs=1)


def test_a_model_without_a_memory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match='expected a model with a scene memory'):
        score_cases(write_tiny_model(tmp_path / 'model.onnx'), [], [])
