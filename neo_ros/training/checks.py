"""What can be found wrong with a training before any of its work is done."""
from importlib.util import find_spec
import math

from neo_ros.errors import ConfigError, ModelError
from neo_ros.field.device import chosen_device
from neo_ros.machine.ray_jobs import check_ray
from neo_ros.outpaint.distributed import processes
from neo_ros.outpaint.fitting import outpaint_device, share_of_batch
from neo_ros.outpaint.perceptual import fetch_weights
from neo_ros.outpaint.training_log import TrainingLog
from neo_ros.pictures.header import MAX_PIXELS
from neo_ros.runtime.model_card import MemoryFile
from neo_ros.training.run import TrainingRun
from neo_ros.training.views import make_sampler


def check_training(run: TrainingRun) -> None:
    """
    Raise NeoError where scene or machine lack what the last steps of a training need.

    What was trained elsewhere is exported without such things: a GPU, weights of LPIPS.
    """
    try:
        MemoryFile(file=f'{run.scene.name}.memory', sha256='0' * 64)
    except ModelError:
        raise ConfigError('scene: expected a folder whose name has no backslash or control '
                          f'character, got {run.scene.name!r}; rename it') from None
    _check_size(run)
    if find_spec('onnxscript') is None:  # Torch asks for it when all else is done.
        raise ModuleNotFoundError("No module named 'onnxscript'", name='onnxscript')
    rank, world = processes()
    config = run.experiment.outpaint
    chosen_device(run.experiment.field.device)
    outpaint_device(config.device, rank)
    share_of_batch(config.batch, world)
    if run.cluster:
        check_ray()
    if run.sampling_area != 'free_space':  # It needs the field.
        make_sampler(run, None)
    if config.tensorboard:
        TrainingLog(run.out / 'tensorboard')
    if config.perceptual > 0 and rank == 0:
        fetch_weights()


def _check_size(run: TrainingRun) -> None:
    """Raise ConfigError where the wide view is larger than a model file may have it."""
    view, scale = run.expansion.target, run.experiment.scale
    if view.width * view.height > MAX_PIXELS:
        most = scale * math.sqrt(MAX_PIXELS / (view.width * view.height))
        raise ConfigError(
            f'scale: expected a wide view of at most {MAX_PIXELS} pixels, got '
            f'{view.width}x{view.height}; write "scale: {math.floor(20 * most) / 20:g}" into an '
            'experiment file and give it with --config')
