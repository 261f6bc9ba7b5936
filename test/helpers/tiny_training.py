"""A training that takes seconds, on a demo scene of small photos."""
from pathlib import Path

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.experiment import Experiment
from neo_ros.field.config import FieldConfig
from neo_ros.flat.scene_writing import write_demo_scene
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.outpaint.fitting import OutpaintConfig
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.pipeline import train
from neo_ros.scenes.pose_sampling import SamplingConfig
from neo_ros.training.run import TrainingRun
import onnx

TINY = Experiment(
    seed=3, field=FieldConfig(steps=400, voxels=20_000, rays_per_step=512, device='cpu'),
    sampling=SamplingConfig(positions=8), network=NetworkConfig(width=8, hidden=32),
    outpaint=OutpaintConfig(steps=20, batch=4, device='cpu'), memory=MemoryConfig(distance=1.0))


def write_tiny_scene(folder: Path) -> None:
    """Write 60 photos of 32x32 pixels and six wide test frames of the demo flat."""
    write_demo_scene(folder, image_size=32, n_train=60, n_paths=2, frames_per_path=3, workers=1)


def train_tiny(scene: Path, out: Path, experiment: Experiment = TINY,
               progress: StageProgress = no_stage_progress,
               cache_gb: float = 0.0) -> TrainingRun:
    """Train on a scene of `write_tiny_scene`."""
    return train(scene, experiment, out, progress, cache_gb)


def graph_of(run: TrainingRun) -> bytes:
    """Return the model's graph with its weights, without the card and its times."""
    return bytes(onnx.load(str(run.model_path)).graph.SerializeToString())
