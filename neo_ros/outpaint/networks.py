"""One interface, several networks: which one an experiment names."""
from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.lama import Lama
from neo_ros.outpaint.mat import Mat
from neo_ros.outpaint.network import NetworkConfig, Outpainter
import torch
from torch import nn


def build_network(expansion: ViewExpansion, config: NetworkConfig) -> nn.Module:
    """
    Make a network: image (B, 3, h, w) in [0, 1] -> colour (B, 3, H, W), log_scale (B, 1, H, W).

    Colour is not clipped; log_scale is the logarithm of a Laplace scale in units of full
    brightness. All are deterministic. Raises ConfigError where the expansion does not fit.
    """
    if config.name == 'mat':
        return Mat(expansion, config)
    if config.name == 'lama':
        return Lama(expansion, config)
    return Outpainter(expansion, config)


def check_network(expansion: ViewExpansion, config: NetworkConfig) -> None:
    """Raise ConfigError for settings and sizes that make no network; costs no memory."""
    with torch.device('meta'):
        build_network(expansion, config)
