"""One interface, several networks: which one an experiment names, on which grid of cells."""
from dataclasses import replace
import math

from neo_ros.errors import ConfigError, GeometryError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.regular_file import MAX_BYTES
from neo_ros.outpaint.lama import Lama
from neo_ros.outpaint.mat import Mat
from neo_ros.outpaint.network import NetworkConfig, Outpainter
import torch
from torch import nn
from torch.nn import functional

# Pixels a side of the finest cells, where nothing speaks for others.
PATCH = 8
# Where the patch is open, the middle of neo_fast has at most so many weights: a frame reads all.
MOST_WEIGHTS = 200_000_000


def build_network(expansion: ViewExpansion, config: NetworkConfig) -> nn.Module:
    """
    Make a network: image (B, 3, h, w) in [0, 1] -> colour (B, 3, H, W), log_scale (B, 1, H, W).

    Colour is not clipped; log_scale is the logarithm of a Laplace scale in units of full
    brightness. All are deterministic. Raises ConfigError where the expansion does not fit.
    """
    config = replace(config, patch=config.patch or fitting_patch(expansion, config))
    if config.name == 'mat':
        return Mat(expansion, config)
    if config.name == 'lama':
        return Lama(expansion, config)
    return Outpainter(expansion, config)


class AtFullSize(nn.Module):
    """
    A network that sees the image shrunk, and whose wide image is enlarged again.

    Takes and gives what the network does, (B, 3, h, w) -> (B, 3, H, W) and (B, 1, H, W), at
    `shrink` times its size.
    """

    def __init__(self, network: nn.Module, shrink: int) -> None:
        super().__init__()
        self.network, self.shrink = network, shrink

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        colour, log_scale = self.network(functional.avg_pool2d(image, self.shrink))
        return self._enlarged(colour), self._enlarged(log_scale)

    def _enlarged(self, image: torch.Tensor) -> torch.Tensor:
        height, width = image.shape[-2:]
        return functional.interpolate(image, (height * self.shrink, width * self.shrink),
                                      mode='bilinear', align_corners=False)


def at_full_size(network: nn.Module, config: NetworkConfig) -> nn.Module:
    """Return what a network of these settings is in a model file."""
    return network if config.shrink == 1 else AtFullSize(network, config.shrink)


def shrunk_expansion(expansion: ViewExpansion, config: NetworkConfig) -> ViewExpansion:
    """Return the view that the network sees; ConfigError where it has no whole pixels."""
    sizes = (expansion.source.width, expansion.source.height, expansion.left, expansion.right,
             expansion.top, expansion.bottom)
    if any(size % config.shrink for size in sizes):
        common = math.gcd(*sizes)
        raise ConfigError(
            f'network.shrink: expected a divisor of {common}, of the image and of what it grows '
            f'by at each side ({", ".join(map(str, sizes))}), got {config.shrink}; choose another '
            'one, or a view')
    return expansion.scaled(1 / config.shrink)


def check_network(expansion: ViewExpansion, config: NetworkConfig) -> None:
    """Raise ConfigError for settings and sizes that make no network or file; costs no memory."""
    with torch.device('meta'):
        network = build_network(expansion, config)
    size = 4 * sum(weight.numel() for weight in network.parameters())
    if size > MAX_BYTES:
        raise ConfigError(
            f'network: expected weights of at most {MAX_BYTES >> 20} MB, as in a model file, '
            f'got {size >> 20} MB; choose a larger network.patch, or a smaller '
            'network.hidden, network.recall or scale')


def fitting_patch(expansion: ViewExpansion, config: NetworkConfig) -> int:
    """
    Return the finest patch of at least PATCH pixels whose cells fit the sizes; mat, lama: PATCH.

    The next below where none of that size fits; coarser where the middle of neo_fast would have
    more than MOST_WEIGHTS.
    """
    source, finer = expansion.source, config.depth - 1
    common = math.gcd(source.width, source.height, expansion.left, expansion.right,
                      expansion.top, expansion.bottom)
    fitting = [patch for patch in range(1, common + 1) if common % (patch << finer) == 0]
    if config.name != 'neo_fast' or not fitting:
        return PATCH
    return max((patch for patch in fitting if _is_light(expansion, patch, config)),
               key=lambda patch: (min(patch, PATCH), -patch), default=fitting[-1])


def fitting_expansion(camera: Intrinsics, config: NetworkConfig) -> ViewExpansion:
    """
    Return the view that grows a camera to twice its size.

    The cells of neo_fast have to fit: as few pixels as possible are left out at the rim.
    """
    if config.shrink > 1:
        times = config.shrink
        even = camera.middle(camera.width // times * times, camera.height // times * times)
        small = fitting_expansion(even.scaled(1 / times), replace(config, shrink=1))
        middle = camera.middle(times * small.source.width, times * small.source.height)
        return ViewExpansion(middle, *(times * side for side in (
            small.left, small.right, small.top, small.bottom)))
    found: list[tuple[tuple[int, ...], ViewExpansion]] = []
    patches = [config.patch] if config.patch else _patches(camera)
    for patch in patches if config.name == 'neo_fast' else ():
        # It grows by half of its size at each side.
        unit = 2 * patch << (config.depth - 1)
        width, height = camera.width // unit * unit, camera.height // unit * unit
        if width and height:
            view = ViewExpansion.to_size(camera.middle(width, height), 2 * width, 2 * height)
            if config.patch or _is_light(view, patch, config):
                found.append(((width * height, min(patch, PATCH), -patch), view))
    return max(found, key=lambda item: item[0], default=((), ViewExpansion.to_twice(camera)))[1]


def fitted_expansion(stated: ViewExpansion, scale: float, config: NetworkConfig
                     ) -> ViewExpansion:
    """
    Return a stated view at a scale, its rims left out where the cells of neo_fast do not fit.

    As few pixels as possible are left out, and what the camera's view loses the margins gain. A
    patch that the settings name has to fit the view as it is. Raises GeometryError where no size
    gives whole pixels at that scale.
    """
    if config.name == 'neo_fast' and not config.patch and not _fits(stated, scale, config):
        found = [(view, patch) for patch in _patches(stated.source.scaled(scale))
                 if (view := _trimmed(stated, scale, config.shrink * patch << (config.depth - 1)))
                 and _is_light(view.scaled(1 / config.shrink), patch, config)]
        if found:
            return max(found, key=lambda item: (
                item[0].target.width * item[0].target.height, min(item[1], PATCH), -item[1]))[0]
    return stated.scaled(scale)


def _fits(stated: ViewExpansion, scale: float, config: NetworkConfig) -> bool:
    try:
        view = stated.scaled(scale / config.shrink)
    except GeometryError:
        return False
    common = math.gcd(view.source.width, view.source.height, view.left, view.right, view.top,
                      view.bottom)
    return any(common % (patch << (config.depth - 1)) == 0
               and _is_light(view, patch, config) for patch in _patches(view.source))


def _patches(camera: Intrinsics) -> range:
    return range(1, min(camera.width, camera.height) + 1)


def _trimmed(stated: ViewExpansion, scale: float, unit: int) -> ViewExpansion | None:
    """Return a stated view at a scale with all sizes in multiples of `unit`, if there is one."""
    step = round(unit / scale)
    source, target = stated.source, stated.target
    width, height = source.width // step * step, source.height // step * step
    if abs(step * scale - unit) > 1e-6 or not (width and height):
        return None
    # On whole pixels of that scale, too.
    whole = max(round(1 / scale), 1)
    left = (stated.left + (source.width - width) // 2) // whole * whole
    top = (stated.top + (source.height - height) // 2) // whole * whole
    sides = [side // step * step for side in (
        left, target.width - left - width, top, target.height - top - height)]
    if not any(sides):
        return None
    view = ViewExpansion(target.cropped(left, top, width, height), *sides)
    return view.scaled(scale)


def _is_light(expansion: ViewExpansion, patch: int, config: NetworkConfig) -> bool:
    """Tell whether the middle of neo_fast has at most MOST_WEIGHTS; see `Outpainter`."""
    cell, coarse = patch << (config.depth - 1), config.width << (config.depth - 1)
    seen, wide = (view.width * view.height // cell ** 2
                  for view in (expansion.source, expansion.target))
    channels = coarse // 4 * seen + (config.recall or coarse // 2) * wide
    return config.hidden * channels <= MOST_WEIGHTS
