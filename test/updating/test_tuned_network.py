"""The network of an updated run is trained on, for the camera that it had."""
from dataclasses import replace
from pathlib import Path
import shutil

from neo_ros.geometry import ViewExpansion
from neo_ros.runtime.model_card import read_model_card, write_model_card
from neo_ros.training.run import TrainingRun
from neo_ros.updating import tuned_network
import pytest
from tiny_training import TINY

pytestmark = pytest.mark.slow


# At 0.6 the view has no whole size in pixels of the photos: 16 are 26 2/3 of theirs.
@pytest.mark.parametrize('scale', [1.0, 0.5, 0.6])
def test_the_view_stays_though_an_updated_scene_has_no_test_frames_to_tell_it(
        scale: float, tiny_run: TrainingRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
        ) -> None:
    out = shutil.copytree(tiny_run.out, tmp_path / 'out')
    model = out / tiny_run.model_path.name
    card = read_model_card(model)
    source = tiny_run.scene.train.intrinsics.scaled(scale)
    if scale == 0.6:
        source = source.middle(16, 16)
    view = ViewExpansion.to_size(source, source.width * 3 // 2, 2 * source.height)
    write_model_card(model, replace(card, expansion=view))
    seen: list[TrainingRun] = []

    def fit(run, *rest, **more):  # type: ignore[no-untyped-def]
        seen.append(run)
        raise InterruptedError

    monkeypatch.setattr(tuned_network, 'fit_outpainter_step', fit)
    scene = replace(tiny_run.scene, test=None, expansion=None)
    with pytest.raises(InterruptedError):
        tuned_network.tune_network(out, scene, replace(TINY, scale=scale), 0.1,
                                   lambda *progress: None)
    assert [run.expansion for run in seen] == [view]
