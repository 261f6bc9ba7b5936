"""TensorBoard's files, read back with its own reader."""
from pathlib import Path
import sys

from neo_ros.errors import ConfigError
from neo_ros.outpaint.training_log import EVERY, TrainingLog
import pytest


class Trainer:
    """Stand in for an OutpaintTrainer at some step."""

    def __init__(self, step: int) -> None:
        self.step, self.loss = step, 1 / (1 + step)
        self.validation = [[s, 0.0, 10.0 + s] for s in range(15, step + 1, 15)]

    def rate(self) -> float:
        """Return a learning rate."""
        return 0.5


def train(folder: Path, first: int, last: int) -> None:
    log = TrainingLog(folder)
    for step in range(first, last + 1):
        log.note(Trainer(step))  # type: ignore[arg-type]
    log.close()


def test_curves_are_written_and_go_on_after_a_break(tmp_path: Path) -> None:
    reader = pytest.importorskip('tensorboard.backend.event_processing.event_accumulator')
    train(tmp_path, 1, 44)
    train(tmp_path, 31, 60)  # broken off; the last checkpoint was of step 30
    found = reader.EventAccumulator(str(tmp_path))
    found.Reload()
    losses = {event.step: event.value for event in found.Scalars('loss')}
    assert sorted(losses) == list(range(EVERY, 61, EVERY))
    assert losses[60] == pytest.approx(1 / 61)
    scores = {event.step: event.value
              for event in found.Scalars('ring PSNR on held-out photos, dB')}
    assert scores == {15: 25, 30: 40, 45: 55, 60: 70}


def test_without_tensorboard_the_setting_is_an_error(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, 'torch.utils.tensorboard', None)
    with pytest.raises(ConfigError, match='outpaint.tensorboard: .* not installed; pip install'):
        TrainingLog(tmp_path)
