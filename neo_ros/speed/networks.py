"""Speed of the network that `neo train` makes, at the sizes of the paper; untrained."""
from collections.abc import Iterator
from dataclasses import replace
import math
from pathlib import Path
import tempfile

from neo_ros import __version__
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.host import Machine
from neo_ros.outpaint.networks import build_network, NetworkConfig
from neo_ros.outpaint.variants import export_variant, Format
from neo_ros.runtime import ModelCard, write_model_card
from neo_ros.runtime.model_card import Parity
from neo_ros.speed.images import noise_image, SEED
from neo_ros.speed.record import Effort, Record
from neo_ros.speed.runtime import measure_expand
import torch

VIEW = ViewExpansion.to_size(Intrinsics.from_hfov(256, 256, math.pi / 2), 512, 512)
NETWORK = NetworkConfig(patch=16, hidden=2048)  # As the full suite has it.
FORMATS: tuple[Format, ...] = ('fp32', 'int8')


def measure_networks(machine: Machine, effort: Effort, view: ViewExpansion = VIEW,
                     config: NetworkConfig = NETWORK) -> Iterator[Record]:
    """Time `neo_fast` with random weights in float32 and int8, one thread and all."""
    torch.manual_seed(SEED)
    network = build_network(view, config).eval()
    card = ModelCard(
        scene_id='speed', expansion=view, network=config.name, config_hash='none',
        parity=Parity(max_abs_error=0, share_within_1=1), trained_seconds=0,
        neo_ros_version=__version__)
    with tempfile.TemporaryDirectory() as folder:
        for number_format in FORMATS:
            path = Path(folder) / f'{config.name}.{number_format}.onnx'
            export_variant(network, view, path, number_format, noise_image(view.source)[None])
            write_model_card(path, card)
            for record in measure_expand(path, machine, effort):
                yield replace(record, benchmark='networks',
                              name=f'{config.name}, {number_format}, {record.name}')
