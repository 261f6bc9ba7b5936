"""Curves of a training for TensorBoard, which is optional: only this file needs it."""
from pathlib import Path
from typing import Any, TYPE_CHECKING

from neo_ros.errors import ConfigError

if TYPE_CHECKING:
    from neo_ros.outpaint.fitting import OutpaintTrainer

# Steps between two points of the curves.
EVERY = 10


class TrainingLog:
    """Write loss, learning rate and validation score of an OutpaintTrainer into a folder."""

    def __init__(self, folder: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise ConfigError('outpaint.tensorboard: the package tensorboard is not installed; '
                              "pip install '.[train]' in a checkout, or set it to false"
                              ) from error
        self._make: Any = SummaryWriter
        self._folder = folder
        self._writer: Any | None = None
        self._validations = 0

    def note(self, trainer: 'OutpaintTrainer') -> None:
        """Add the points of the step that was just taken."""
        if self._writer is None:
            # A resumed training takes some steps again: what was written of them is dropped.
            self._writer = self._make(str(self._folder), purge_step=trainer.step)
            self._validations = sum(row[0] < trainer.step for row in trainer.validation)
        if trainer.step % EVERY == 0:
            self._writer.add_scalar('loss', trainer.loss, trainer.step)
            self._writer.add_scalar('learning rate', trainer.rate(), trainer.step)
        for step, _, psnr in trainer.validation[self._validations:]:
            self._writer.add_scalar('ring PSNR on held-out photos, dB', psnr, int(step))
        self._validations = len(trainer.validation)

    def close(self) -> None:
        """Write what is not on disk yet."""
        if self._writer is not None:
            self._writer.close()
