"""
`mat`: a mask-aware transformer as an outpainter.

After Li et al., MAT: Mask-Aware Transformer for Large Hole Image Inpainting (CVPR 2022), section
3: a convolutional head, five stages of transformer blocks that attend to valid tokens alone, a
convolutional tail. Without style manipulation and noise, so the same image gives the same bits,
and without the second, refining network, whose purpose they are. The paper's 512x512 model has
head and stages of 180 channels, patch 8, depth 3, windows of 8 and 16; here all of it is small.
"""
import math

from neo_ros.errors import ConfigError
from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.network import NetworkConfig
import numpy as np
import torch
from torch import nn
import torch.nn.functional as F

HEAD_CHANNELS = 32
# What is added to the attention score of a token that shows nothing yet (the paper's -tau).
INVALID = -100.0


class Mat(nn.Module):
    """
    Predict the wide image and the scale of its error; see `build_network` for shapes.

    config.patch (a power of two) is the size of the finest tokens, config.width their channels
    at every stage, config.depth the number of token grids, each half as fine: depth stages on
    the way down, depth - 1 on the way up, of config.blocks blocks each.
    """

    def __init__(self, expansion: ViewExpansion, config: NetworkConfig) -> None:
        super().__init__()
        steps = config.patch.bit_length() - 1
        if config.patch != 2 ** steps:
            raise ConfigError(f'network.patch: mat expects a power of two, got {config.patch}')
        if config.width > HEAD_CHANNELS and config.width % HEAD_CHANNELS:
            raise ConfigError(f'network.width: mat expects a multiple of {HEAD_CHANNELS}, '
                              f'got {config.width}')
        target, cell = expansion.target, config.patch * 2 ** (config.depth - 1)
        self.size = (target.height, target.width)
        self.margins = (expansion.left, expansion.right, expansion.top, expansion.bottom)
        self.spare = (0, -target.width % cell, 0, -target.height % cell)
        seen = np.pad(~expansion.extrapolated_mask, ((0, self.spare[3]), (0, self.spare[1])))
        valid = _shrunk(seen, config.patch)
        channels = [max(config.width >> (steps - i), 8) for i in range(steps)] + [config.width]
        self.head = nn.ModuleList(
            nn.Conv2d(a, b, 3, stride=2 if i else 1, padding=1)
            for i, (a, b) in enumerate(zip([4, *channels], channels)))
        self.down_stages, self.shrink = nn.ModuleList(), nn.ModuleList()
        self.up_stages, self.grow = nn.ModuleList(), nn.ModuleList()
        width = config.width
        for level in range(config.depth):
            if level:
                self.shrink.append(nn.Conv2d(width, width, 3, stride=2, padding=1))
                valid = _shrunk(valid, 2)
            stage = Stage(config, valid)
            self.down_stages.append(stage)
            valid = stage.valid
        for _ in range(config.depth - 1):
            valid = valid.repeat(2, 0).repeat(2, 1)
            self.grow.append(nn.Conv2d(width, width, 3, padding=1))
            stage = Stage(config, valid)
            self.up_stages.append(stage)
            valid = stage.valid
        self.tail = nn.ModuleList(
            nn.Conv2d(b + a, a, 3, padding=1) for a, b in zip(channels[-2::-1], channels[::-1]))
        self.out = nn.Conv2d(channels[0], 4, 3, padding=1)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        seen = F.pad(torch.cat([image - 0.5, torch.ones_like(image[:, :1])], 1), self.margins)
        x, details = F.pad(seen, self.spare), []
        for convolution in self.head:
            x = F.leaky_relu(convolution(x), 0.2)
            details.append(x)
        tokens, known = x.permute(0, 2, 3, 1), []
        for level, stage in enumerate(self.down_stages):
            if level:
                tokens = _convolved(self.shrink[level - 1], tokens)
            tokens = stage(tokens)
            known.append(tokens)
        for level, stage in enumerate(self.up_stages):
            tokens = _convolved(self.grow[level], _doubled(tokens))
            tokens = stage(tokens + known[-2 - level])
        x = tokens.permute(0, 3, 1, 2) + details[-1]
        for level, convolution in enumerate(self.tail):
            x = F.interpolate(x, scale_factor=2.0, mode='nearest')
            x = F.leaky_relu(convolution(torch.cat([x, details[-2 - level]], 1)), 0.2)
        out = self.out(x)[:, :, :self.size[0], :self.size[1]]
        return out[:, :3] + 0.5, out[:, 3:] - 2


class Stage(nn.Module):
    """
    Some transformer blocks and a convolution, with a skip connection around all of them.

    valid is a bool (rows, columns) of the tokens that show something before the first block;
    `self.valid` is the same after the last.
    """

    def __init__(self, config: NetworkConfig, valid: np.ndarray) -> None:
        super().__init__()
        blocks = []
        for index in range(config.blocks):
            block = Block(config.width, config.window, valid, shifted=index % 2 == 1)
            blocks.append(block)
            valid = block.attention.valid
        self.blocks, self.valid = nn.Sequential(*blocks), valid
        self.smooth = nn.Conv2d(config.width, config.width, 3, padding=1)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """(B, rows, columns, C) -> the same."""
        return tokens + _convolved(self.smooth, self.blocks(tokens))


class Block(nn.Module):
    """
    The paper's adjusted transformer block (section 3.2): (B, rows, columns, C) -> the same.

    No layer normalisation, and fusion by a fully connected layer on the concatenation in place
    of a sum: both made the training with large holes unstable.
    """

    def __init__(self, width: int, window: int, valid: np.ndarray, shifted: bool) -> None:
        super().__init__()
        self.attention = WindowAttention(width, window, valid, shifted)
        self.fuse = nn.Linear(2 * width, width)
        self.mlp = nn.Sequential(
            nn.Linear(width, 2 * width), nn.GELU(), nn.Linear(2 * width, width))

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """See the class."""
        return self.mlp(self.fuse(torch.cat([self.attention(tokens), tokens], -1)))


class WindowAttention(nn.Module):
    """
    The paper's multi-head contextual attention in windows of the token grid (section 3.3).

    Only valid tokens are attended to; after it, every token of a window with a valid one is
    valid. As the mask is fixed geometry, all of that is known here. Every second block shifts
    the windows by half; at the border they hang over tokens that are never valid.
    """

    hidden: torch.Tensor | None

    def __init__(self, width: int, window: int, valid: np.ndarray, shifted: bool) -> None:
        super().__init__()
        self.heads = max(width // HEAD_CHANNELS, 1)
        rows, columns = valid.shape
        self.window = (min(window, rows), min(window, columns))
        # One window that holds everything gains nothing from a shift.
        before = [side // 2 if shifted and side < length else 0
                  for side, length in zip(self.window, valid.shape)]
        after = [-(b + length) % side for b, length, side in zip(before, valid.shape, self.window)]
        self.pads = (0, 0, before[1], after[1], before[0], after[0])
        self.inner = (slice(before[0], before[0] + rows), slice(before[1], before[1] + columns))
        padded = np.pad(valid, tuple(zip(before, after)))
        self.grid = (padded.shape[0] // self.window[0], padded.shape[1] // self.window[1])
        blocked = padded.reshape(self.grid[0], self.window[0], self.grid[1], self.window[1])
        shown = blocked.transpose(0, 2, 1, 3).reshape(-1, self.window[0] * self.window[1])
        hidden = np.where(shown, 0, INVALID).astype(np.float32)[:, None, None]
        self.register_buffer('hidden', None if shown.all() else torch.from_numpy(hidden),
                             persistent=False)
        reached = blocked.any((1, 3))[:, None, :, None].repeat(self.window[0], 1)
        reached = reached.repeat(self.window[1], 3).reshape(padded.shape)
        self.valid = reached[self.inner]
        self.queries = nn.Linear(width, 3 * width)
        self.project = nn.Linear(width, width)

    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        """(B, rows, columns, C) -> the same."""
        batch, channels = tokens.shape[0], tokens.shape[3]
        (down, across), (height, width) = self.grid, self.window
        x = self.queries(F.pad(tokens, self.pads))
        # (B, down, height, across, width, 3, heads, c) -> (3, B, windows, heads, tokens, c)
        x = x.reshape(batch, down, height, across, width, 3, self.heads, -1)
        x = x.permute(5, 0, 1, 3, 6, 2, 4, 7).reshape(
            3, batch, down * across, self.heads, height * width, -1)
        query, key, value = x[0], x[1], x[2]
        score = query @ key.transpose(-1, -2) / math.sqrt(channels // self.heads)
        if self.hidden is not None:
            score = score + self.hidden
        x = score.softmax(-1) @ value
        x = x.reshape(batch, down, across, self.heads, height, width, -1)
        x = x.permute(0, 1, 4, 2, 5, 3, 6).reshape(
            batch, down * height, across * width, channels)
        return self.project(x[:, self.inner[0], self.inner[1]])


def _convolved(convolution: nn.Module, tokens: torch.Tensor) -> torch.Tensor:
    """Run a convolution on tokens (B, rows, columns, C)."""
    return convolution(tokens.permute(0, 3, 1, 2)).permute(0, 2, 3, 1)


def _doubled(tokens: torch.Tensor) -> torch.Tensor:
    image = F.interpolate(tokens.permute(0, 3, 1, 2), scale_factor=2.0, mode='nearest')
    return image.permute(0, 2, 3, 1)


def _shrunk(valid: np.ndarray, factor: int) -> np.ndarray:
    """Tell which blocks of factor x factor hold a valid token or pixel."""
    rows, columns = valid.shape[0] // factor, valid.shape[1] // factor
    return valid.reshape(rows, factor, columns, factor).any((1, 3))
