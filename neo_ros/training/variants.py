"""A trained model in other number formats, with what each costs in size, time and quality."""
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
import statistics
import time

from neo_ros.errors import ConfigError
from neo_ros.evaluation.metrics import psnr
from neo_ros.field.device import chosen_device, read_field
from neo_ros.outpaint.export import (
    calibration_factor, check_parity, ExportedFunction, require_parity)
from neo_ros.outpaint.networks import at_full_size, build_network
from neo_ros.outpaint.variants import export_variant, Format, FORMATS
from neo_ros.runtime import FovExtrapolator, read_model_card, write_model_card
from neo_ros.runtime.model_card import Parity
from neo_ros.training.checkpoint import checkpoint_errors, read_checkpoint
from neo_ros.training.folder import claim
from neo_ros.training.run import TrainingRun
from neo_ros.training.views import held_out_wide_views, real_frames
import numpy as np
from torch import nn


@dataclass(frozen=True)
class VariantRules:
    """On how much a file of another number format is made and measured."""

    range_frames: int = 64   # camera images from which int8 takes the ranges of its values
    parity_frames: int = 8   # on which torch is compared, which is slow
    rounds: int = 30         # of timing: enough for a median beside other work


@dataclass(frozen=True)
class Variant:
    """A model file; milliseconds is a median, ring_psnr (dB) is over held-out photos."""

    name: str
    path: Path
    megabytes: float
    milliseconds: float
    ring_psnr: float


def export_variants(run: TrainingRun, formats: Sequence[Format] = FORMATS,
                    threads: int = 0, rules: VariantRules = VariantRules()) -> list[Variant]:
    """
    Write a finished run's model as SCENE.<format>.onnx beside it, and measure all of them.

    Quality is measured on photos that nothing was trained on, against the field around them,
    so the test frames stay unseen. Raises ConfigError for a run that is not finished, and
    ModelError where fp32 is not the function that was trained.
    """
    network = _trained_network(run)
    views = held_out_wide_views(run, read_field(
        run.out / 'field.npz', chosen_device(run.experiment.field.device)))
    if views is None:
        raise ConfigError(f'{run.out}: expected photos held out of the training to measure on, '
                          f'got none of {len(run.scene.train)}; import at least '
                          f'{run.hold_out.least_photos}')
    factor = calibration_factor(network, run.expansion, views)
    function = ExportedFunction(network, run.expansion, factor).eval()
    # What is measured here is of other frames than the scores of a card.
    card = replace(read_model_card(run.model_path), scores={})
    models = {'as trained': run.model_path}
    for number, number_format in enumerate(formats):
        run.progress('formats', number, len(formats), number_format)
        path = run.model_path.with_suffix(f'.{number_format}.onnx')
        export_variant(network, run.expansion, path, number_format,
                       real_frames(run, rules.range_frames, run.fitted), factor)
        write_model_card(path, card)
        model = FovExtrapolator.load(path, threads, guided=False)
        worst, share = check_parity(function, model.expand, real_frames(run, rules.parity_frames))
        if number_format == 'fp32':  # The others round on purpose.
            require_parity(path, worst, share)
        write_model_card(path, replace(
            card, parity=Parity(max_abs_error=worst, share_within_1=share)))
        models[number_format] = path
    run.progress('formats', len(formats), len(formats), '')
    variants = _measured(models, run, views, threads, rules)
    best = max(variant.ring_psnr for variant in variants)
    for variant in variants[1:]:
        write_model_card(variant.path, replace(read_model_card(variant.path), scores={
            'held_out_ring_psnr': round(variant.ring_psnr, 4),
            'held_out_ring_psnr_lost': round(best - variant.ring_psnr, 4)}))
    return variants


def _trained_network(run: TrainingRun) -> nn.Module:
    """Return the network of a finished run, as the model file has it."""
    checkpoint = run.out / 'outpainter.ckpt'
    missing = [path.name for path in (checkpoint, run.model_path) if not path.exists()]
    if missing:
        raise ConfigError(f'{run.out}: expected a finished run, got none with '
                          f'{" and ".join(missing)}; give neo train the same arguments')
    claim(run.out, run.scene, run.experiment)
    state = read_checkpoint(checkpoint)
    network = build_network(run.network_expansion, run.experiment.network)
    with checkpoint_errors(checkpoint):
        trained = state['trainer']
        done, total = run.experiment.outpaint.progress(trained['step'], trained['seconds'])
        network.load_state_dict(trained['averaged'])
    # An update trains it on for minutes of its own.
    if done < total and not read_model_card(run.model_path).updates:
        raise ConfigError(f'{run.out}: expected a finished run, got one that is at {done} of '
                          f'{total}; give neo train the same arguments')
    return at_full_size(network, run.experiment.network).eval()


def _measured(models: dict[str, Path], run: TrainingRun, views: np.ndarray,
              threads: int, rules: VariantRules) -> list[Variant]:
    loaded = {name: FovExtrapolator.load(path, threads, guided=False)
              for name, path in models.items()}
    scores: dict[str, list[float]] = {name: [] for name in models}
    milliseconds: dict[str, list[float]] = {name: [] for name in models}
    total = len(views) + rules.rounds
    for number, view in enumerate(views):
        run.progress('measuring', number, total, '')
        seen = run.expansion.extrapolated_mask & (view[..., 3] > 127)
        narrow = np.ascontiguousarray(run.expansion.crop(view)[..., :3])
        if seen.any():
            for name, model in loaded.items():
                wide_image = model.expand(narrow).wide_image
                scores[name].append(psnr(view[..., :3][seen], wide_image[seen]))
    # In turns, so that what else the machine does meets all of them.
    for number in range(rules.rounds):
        run.progress('measuring', len(views) + number, total, '')
        for name, model in loaded.items():
            started = time.perf_counter()
            model.expand(narrow)
            milliseconds[name].append(1e3 * (time.perf_counter() - started))
    run.progress('measuring', total, total, '')
    return [Variant(name, path, path.stat().st_size / 1e6, statistics.median(milliseconds[name]),
                    float(np.mean(scores[name]))) for name, path in models.items()]
