"""
`neo_fast`: a deterministic, scene-specific network from the narrow to the wide view.

Most weights sit in a fully connected middle that sees the whole image at once: it has to
remember the place (where am I, which way do I look). Convolutions carry the observed detail
across the seam, on the same pixel grid as the wide view.
"""
from dataclasses import dataclass

from neo_ros.errors import ConfigError
from neo_ros.geometry import ViewExpansion
import torch
from torch import nn
import torch.nn.functional as F

NETWORKS = ('neo_fast', 'mat', 'lama')


@dataclass(frozen=True)
class NetworkConfig:
    """
    Which outpainter, and its size.

    Every network reads patch, width and depth in its own way: see `Outpainter` (neo_fast), `Mat`
    and `Lama`.
    """

    __pydantic_config__ = {'extra': 'forbid'}
    name: str = 'neo_fast'  # neo_fast, mat or lama
    shrink: int = 1         # it works at the camera's size divided by this, inside the model file
    patch: int = 0          # pixels a side of the finest grid's cells; 0 = as the sizes ask for
    width: int = 64         # channels on the finest grid; neo_fast and lama double them downwards
    depth: int = 2          # number of grids, each half as fine as the one before
    hidden: int = 1024      # neo_fast: units of the fully connected middle
    recall: int = 0         # neo_fast: channels that the middle gives each cell; 0 = all of them
    blocks: int = 2         # mat, lama: blocks in a stage
    window: int = 8         # mat: cells a side of an attention window

    def __post_init__(self) -> None:
        if self.name not in NETWORKS:
            raise ConfigError(
                f'network.name: expected one of {", ".join(NETWORKS)}, got {self.name!r}')
        for name, least in (('shrink', 1), ('width', 1), ('depth', 1), ('hidden', 1),
                            ('blocks', 1), ('window', 1), ('patch', 0), ('recall', 0)):
            if getattr(self, name) < least:
                raise ConfigError(
                    f'network.{name}: expected {least} or more, got {getattr(self, name)}')
        # The middle of neo_fast sees a quarter of the channels of the coarsest grid.
        least = 4 >> (self.depth - 1)
        if self.name == 'neo_fast' and self.width < least:
            raise ConfigError(f'network.width: expected {least} or more at depth {self.depth}, '
                              f'got {self.width}')


def check_fits(expansion: ViewExpansion, config: NetworkConfig) -> int:
    """Return the edge of the coarsest cells, pixels; ConfigError if sizes are no multiples."""
    cell = config.patch * 2 ** (config.depth - 1)
    source = expansion.source
    sizes = {'source width': source.width, 'source height': source.height,
             'left': expansion.left, 'right': expansion.right,
             'top': expansion.top, 'bottom': expansion.bottom}
    wrong = {name: size for name, size in sizes.items() if size % cell}
    if wrong:
        raise ConfigError(
            f'network: expected multiples of {cell} pixels (patch x 2^(depth - 1)), '
            f'got {wrong}; choose another scale, patch or depth')
    return cell


class Residual(nn.Module):
    """Two 3x3 convolutions on a skip connection."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = nn.Conv2d(channels, channels, 3, padding=1)
        nn.init.zeros_(self.second.weight)
        nn.init.zeros_(self.second.bias)  # type: ignore[arg-type]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, C, H, W) -> (B, C, H, W)."""
        return x + self.second(F.silu(self.first(F.silu(x))))


class Outpainter(nn.Module):
    """
    Predict the wide image and the scale of its error.

    Input (B, 3, h, w) float in [0, 1]; output colour (B, 3, H, W), unclipped, and log_scale
    (B, 1, H, W), the logarithm of a Laplace scale in units of full brightness.
    Raises ConfigError where the expansion does not fit the network's grid.
    """

    def __init__(self, expansion: ViewExpansion, config: NetworkConfig) -> None:
        super().__init__()
        cell = check_fits(expansion, config)
        source, target = expansion.source, expansion.target
        self.patch, self.depth = config.patch, config.depth
        self.margins = [
            tuple(side // (config.patch * 2 ** level) for side in
                  (expansion.left, expansion.right, expansion.top, expansion.bottom))
            for level in range(config.depth)]
        channels = [config.width * 2 ** level for level in range(config.depth)]
        self.stem = nn.Conv2d(3 * config.patch ** 2, channels[0], 3, padding=1)
        self.encode = nn.ModuleList(Residual(c) for c in channels)
        self.shrink = nn.ModuleList(
            nn.Conv2d(a, b, 2, stride=2) for a, b in zip(channels, channels[1:]))
        coarse = channels[-1]
        self.wide_grid = (target.height // cell, target.width // cell)
        inputs = coarse // 4 * (source.height // cell) * (source.width // cell)
        recalled = config.recall or coarse // 2
        outputs = recalled * self.wide_grid[0] * self.wide_grid[1]
        self.squeeze = nn.Conv2d(coarse, coarse // 4, 1)
        self.recall = nn.Sequential(
            nn.Linear(inputs, config.hidden), nn.SiLU(),
            nn.Linear(config.hidden, config.hidden), nn.SiLU(),
            nn.Linear(config.hidden, outputs))
        self.join = nn.ModuleList(
            nn.Conv2d(c + 1 + (recalled if level == config.depth - 1 else c),
                      c, 3, padding=1)
            for level, c in enumerate(channels))
        self.decode = nn.ModuleList(
            nn.Sequential(Residual(c), Residual(c)) for c in channels)
        self.grow = nn.ModuleList(
            nn.Conv2d(b, 4 * a, 1) for a, b in zip(channels, channels[1:]))
        self.head = nn.Conv2d(channels[0], 4 * config.patch ** 2, 3, padding=1)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        x = self.stem(F.pixel_unshuffle(image - 0.5, self.patch))
        seen = []
        for level in range(self.depth):
            if level:
                x = self.shrink[level - 1](x)
            x = self.encode[level](x)
            seen.append(x)
        middle = self.recall(self.squeeze(x).flatten(1))
        wide = middle.unflatten(1, (-1, *self.wide_grid))
        for level in reversed(range(self.depth)):
            if level < self.depth - 1:
                wide = F.pixel_shuffle(self.grow[level](wide), 2)
            # One more channel tells seen cells from cells to be made up.
            known = F.pad(seen[level], self.margins[level])
            mask = F.pad(torch.ones_like(seen[level][:, :1]), self.margins[level])
            wide = self.join[level](torch.cat([wide, known, mask], 1))
            wide = self.decode[level](wide)
        out = F.pixel_shuffle(self.head(F.silu(wide)), self.patch)
        return out[:, :3] + 0.5, out[:, 3:] - 2
