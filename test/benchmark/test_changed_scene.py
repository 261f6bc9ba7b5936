"""Guided views of the demo flat: fast to set up without a training, and honest about changes."""
from pathlib import Path

from neo_ros.benchmark.changed_scene import score_change
from neo_ros.evaluation.metrics import psnr
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.geometry import Band, Intrinsics, ViewExpansion
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import Glances, SceneMemory
from neo_ros.runtime import FovExtrapolator
from neo_ros.speed.guided import exact_keyframe, level_pose, measure_guided, write_guided_stand_in
from neo_ros.speed.record import Effort
import numpy as np
import pytest

pytestmark = pytest.mark.slow

VIEW = ViewExpansion.to_size(Intrinsics.from_hfov(64, 64, np.pi / 2), 128, 128)
# Along the living room, past the armchair and the dining chairs, looking around.
WALK = [level_pose(np.array([2.9 + 0.03 * step, 1.55, 1.5]), 2.0 + 0.16 * step)
        for step in range(40)]


def test_an_exact_keyframe_shows_the_flat() -> None:
    position, band = WALK[0].position, Band(1.11, -1.11)
    keyframe = exact_keyframe(build_demo_flat(), position, band, VIEW.target.fx)
    memory = SceneMemory.from_keyframes([keyframe], band, Glances(
        np.zeros((1, 4, 4), np.uint8), np.eye(4)[None]))
    for yaw in (0.3, 1.9, 4.4):
        pose = level_pose(position, yaw)
        truth, depth = build_demo_flat().render(VIEW.target, pose)
        seen = MemoryRenderer(memory).render(pose, VIEW.target)
        assert psnr(truth, seen.image.astype(np.uint8)) > 24
        assert np.median(np.abs(seen.depth / depth - 1)) < 0.01


def test_speed_is_measured_without_a_training() -> None:
    followed, found = measure_guided(Effort(seconds=0.1, frames=6), [VIEW])
    assert followed.n == 5 and followed.details['guided'] == 1
    assert followed.median_ms and found.median_ms and found.n >= 3


def test_confidence_falls_where_a_chair_was_moved(tmp_path: Path) -> None:
    extrapolator = FovExtrapolator.load(write_guided_stand_in(tmp_path, VIEW, WALK))
    scores = score_change(extrapolator, [WALK])
    assert scores.frames >= 3 and scores.guided > 0.9
    # Somebody's chair in the image drags neither the pose nor the rest of the ring.
    assert scores.unchanged_psnr[1] > scores.unchanged_psnr[0] - 1
    assert scores.confidence[1] < scores.confidence[0] - 20
    assert scores.auroc > 0.65
    assert 5 < scores.changed_psnr < scores.unchanged_psnr[1] and 0 < scores.wrong < 1
