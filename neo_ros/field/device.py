"""Which machine part fits and renders the field: compiled kernels, or torch on a GPU."""
from pathlib import Path

from neo_ros.errors import ConfigError
from neo_ros.field.config import FieldConfig
from neo_ros.field.extent import FineBox
from neo_ros.field.fitting import FieldTrainer, FitRules
from neo_ros.field.mesh_field import MeshField
from neo_ros.field.radiance_field import FittedField, RadianceField
from neo_ros.field.torch_field import torch_device, TorchField
from neo_ros.field.torch_fitting import TorchFieldTrainer
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
import numpy as np
import torch


def chosen_device(name: str) -> str:
    """Return cpu, cuda or torch for `field.device`; raises ConfigError where it is not there."""
    if name == 'cuda' and not torch.cuda.is_available():
        raise ConfigError('field.device: cuda needs a GPU that torch can use, there is none; '
                          'choose auto or cpu')
    if name == 'auto':
        return 'cuda' if torch.cuda.is_available() else 'cpu'
    return name


def field_trainer(images: np.ndarray, intrinsics: Intrinsics, T_world_cam: np.ndarray,
                  config: FieldConfig, seed: int, depths: np.ndarray | None = None,
                  usable: np.ndarray | None = None, fine: FineBox | None = None
                  ) -> FieldTrainer:
    """Make the trainer for the device that `config` names; see `FieldTrainer`."""
    device = chosen_device(config.device)
    rules = FitRules()
    if device == 'cpu':
        return FieldTrainer(images, intrinsics, T_world_cam, config, seed, rules, depths, usable,
                            fine)
    return TorchFieldTrainer(images, intrinsics, T_world_cam, config, seed, device, rules,
                             depths, usable, fine)


def on_device(field: VoxelField, device: str) -> FittedField:
    """Bring a field, as it is now, to cpu, cuda or torch (what cuda does, on the CPU)."""
    return field if device == 'cpu' else TorchField(field, torch_device(device))


def read_field(path: Path, device: str) -> RadianceField:
    """Read the field of a run to cpu, cuda or torch; a mesh is seen on the CPU anywhere."""
    mesh = MeshField.load(path)
    return on_device(VoxelField.load(path), device) if mesh is None else mesh
