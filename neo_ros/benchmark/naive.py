"""
B1: naive outpainting, the same network without the radiance field.

It learns from the original photos, resized to the wide frame, with their own middle as input.
At the square protocol the photos' field of view is not the wide one: that mismatch is B1's
nature (paper, section 4.2).
"""
from dataclasses import dataclass, replace
import time
from typing import Any

import cv2
from neo_ros.errors import ConfigError
from neo_ros.outpaint.fitting import OutpaintTrainer
from neo_ros.pictures.filling import extend_edges
from neo_ros.pipeline import export_step
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.training.checkpoint import train_with_checkpoints
from neo_ros.training.run import TrainingRun
import numpy as np
import torch


@dataclass(frozen=True)
class NaiveRules:
    """How B1 learns from photos alone; chosen by measuring."""

    zoom: float = 0.85      # photos are cut to between this share of their size and all of it
    validations: int = 40   # twice NEO's: the best of them is exported
    patience: int = 10      # validations without a better score until the training ends


class ResizedPhotos:
    """An endless, seeded stream of photos as wide views, RGBA uint8; A is 255 where they count."""

    def __init__(self, photos: PosedImages, width: int, height: int, seed: int,
                 rules: NaiveRules = NaiveRules()) -> None:
        self.size, self.seed, self.zoom = (width, height), seed, rules.zoom
        self.images = [as_wide(photos, index, width, height) for index in range(len(photos))]

    def batch(self, step: int, size: int) -> torch.Tensor:
        """Return batch `step`: (size, H, W, 4), each photo a little cut."""
        random = np.random.default_rng([self.seed, 4, step])
        return torch.from_numpy(np.stack([
            self._cut(self.images[index], random)
            for index in random.integers(len(self.images), size=size)]))

    def _cut(self, image: np.ndarray, random: np.random.Generator) -> np.ndarray:
        width, height = self.size
        share = random.uniform(self.zoom, 1)
        w, h = max(round(share * width), 1), max(round(share * height), 1)
        x, y = random.integers(width - w + 1), random.integers(height - h + 1)
        return cv2.resize(image[y:y + h, x:x + w], self.size, interpolation=cv2.INTER_LINEAR)


def train_naive(run: TrainingRun, rules: NaiveRules = NaiveRules()) -> None:
    """
    Train B1 into `run.out` and export it as the run's model file.

    run: its outpaint settings say how long. The weights with the best score on held-out photos
    are exported; the training ends early where it only overfits. A broken-off run goes on.
    """
    if run.held_out is None:
        raise ConfigError(f'naive: expected at least {run.hold_out.least_photos} photos, so that '
                          f'one is held out, {run.scene.name} has {len(run.scene.train)}; leave '
                          'naive out of --methods')
    target, experiment = run.network_expansion.target, run.experiment
    held_out = np.stack([as_wide(run.held_out, index, target.width, target.height)
                         for index in range(len(run.held_out))])
    started = time.monotonic()
    trainer = OutpaintTrainer(
        run.network_expansion, experiment.network,
        replace(experiment.outpaint, validations=rules.validations, real_centre=0.0),
        experiment.seed, held_out)
    stream = ResizedPhotos(run.fitted, target.width, target.height, experiment.seed,
                           rules)
    run.seconds += time.monotonic() - started
    kept: dict[str, Any] = {'best': {
        'psnr': -np.inf, 'at': 0, 'weights': trainer.averaged.state_dict()}}

    def done() -> tuple[int, int]:
        step, total = trainer.done
        overfits = len(trainer.validation) - kept['best']['at'] >= rules.patience
        return step, step if overfits else total

    def learn() -> None:
        scores = len(trainer.validation)
        trainer.train_step(stream.batch(trainer.step, trainer.batch_size))
        if len(trainer.validation) > scores and trainer.validation[-1][2] > kept['best']['psnr']:
            kept['best'] = {'psnr': trainer.validation[-1][2], 'at': len(trainer.validation),
                            'weights': {name: value.detach().cpu().clone() for name, value
                                        in trainer.averaged.state_dict().items()}}

    train_with_checkpoints(run, trainer, run.out / 'naive.ckpt', 'naive', done, learn,
                           trainer.note, beside=kept)
    network = trainer.averaged.eval().cpu()
    network.load_state_dict(kept['best']['weights'])
    export_step(run, network)


def as_wide(photos: PosedImages, index: int, width: int, height: int) -> np.ndarray:
    """
    Read a photo resized to the wide frame: the largest part with its aspect, RGBA uint8.

    What a mask leaves out has A 0, and colours of what is beside it.
    """
    photo, usable = photos.read_shown(index)
    filled = np.rint(extend_edges(photo.astype(np.float32), usable)).astype(np.uint8)
    image = np.dstack([filled, np.where(usable, 255, 0).astype(np.uint8)])
    h, w = image.shape[:2]
    share = min(w / width, h / height)
    cut_w, cut_h = round(share * width), round(share * height)
    x, y = (w - cut_w) // 2, (h - cut_h) // 2
    shrink = width < cut_w
    return cv2.resize(image[y:y + cut_h, x:x + cut_w], (width, height),
                      interpolation=cv2.INTER_AREA if shrink else cv2.INTER_CUBIC)
