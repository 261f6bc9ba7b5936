"""What can be found wrong with a training before any of its work is done."""
from importlib.util import find_spec
from typing import TYPE_CHECKING

from neo_ros.errors import ConfigError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.field.device import chosen_device
from neo_ros.outpaint.distributed import processes
from neo_ros.outpaint.fitting import outpaint_device, share_of_batch
from neo_ros.outpaint.networks import check_network
from neo_ros.outpaint.perceptual import fetch_weights
from neo_ros.outpaint.training_log import TrainingLog
from neo_ros.runtime.model_card import MemoryFile
from neo_ros.training_views import make_sampler, sampling_area
import numpy as np
from pydantic import ValidationError

if TYPE_CHECKING:
    from neo_ros.pipeline import TrainingRun


def check_settings(run: 'TrainingRun') -> None:
    """Raise NeoError where view, network and test frames do not fit the photos."""
    photo = run.scene.train.intrinsics.scaled(run.experiment.scale)
    source = run.expansion.source
    rows, columns = photo.window(source)
    if (min(rows.start, columns.start) < 0
            or rows.stop > photo.height or columns.stop > photo.width):
        raise ConfigError(
            f'view.source: expected at most the size of the photos, {photo.width}x'
            f'{photo.height} pixels at this scale, got {source.width}x{source.height} from '
            f'{columns.start}, {rows.start} on')
    if not np.allclose([photo.fx, photo.fy], [source.fx, source.fy], rtol=1e-3):
        raise ConfigError(
            f'view: expected the focal length of the photos at this scale, {photo.fx:.1f} x '
            f'{photo.fy:.1f} pixels, got {source.fx:.1f} x {source.fy:.1f}; bring photos and test '
            'frames to one resolution, or take the test frames out of the scene')
    check_network(run.expansion, run.experiment.network)
    if run.scene.test is not None:
        TruthFrames(run.scene.test, run.expansion)


def check_training(run: 'TrainingRun') -> None:
    """
    Raise NeoError where scene or machine lack what the last steps of a training need.

    What was trained elsewhere is exported without such things: a GPU, weights of LPIPS.
    """
    try:
        MemoryFile(file=f'{run.scene.name}.memory', sha256='0' * 64)
    except ValidationError:
        raise ConfigError('scene: expected a folder whose name has no backslash or control '
                          f'character, got {run.scene.name!r}; rename it') from None
    rank, world = processes()
    config = run.experiment.outpaint
    chosen_device(run.experiment.field.device)
    outpaint_device(config.device, rank)
    share_of_batch(config.batch, world)
    if sampling_area(run) != 'free_space':  # It needs the field.
        make_sampler(run, None)
    if run.experiment.memory is not None and find_spec('numba') is None:
        raise ConfigError('memory: needs numba: pip install numba, or set it to null')
    if config.tensorboard:
        TrainingLog(run.out / 'tensorboard')
    if config.perceptual > 0 and rank == 0:
        fetch_weights()
