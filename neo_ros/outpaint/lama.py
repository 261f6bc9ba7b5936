"""
`lama`: an outpainter of fast Fourier convolutions, for views of any size.

After Suvorov et al., Resolution-robust Large Mask Inpainting with Fourier Convolutions (WACV
2022), section 2.1: a convolutional encoder, residual blocks whose global branch works on the
spectrum of the whole image, a decoder. Without the adversarial part; it predicts the scale of its
error as well.
"""
import math

from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.fourier import RealFourier
from neo_ros.outpaint.network import NetworkConfig
import torch
from torch import nn
import torch.nn.functional as F

# Share of the channels in the global branch (the paper's alpha_in = alpha_out).
GLOBAL_SHARE = 0.75


class Lama(nn.Module):
    """
    Predict the wide image and the scale of its error; see `build_network` for shapes.

    config.width is the number of channels at full resolution, doubled `depth` times while the
    grid is halved; config.blocks is the number of residual blocks on the coarsest grid (the
    paper: 64, 3 and 9). Sizes that are no multiples of 2^depth are padded.
    """

    def __init__(self, expansion: ViewExpansion, config: NetworkConfig) -> None:
        super().__init__()
        target, cell = expansion.target, 2 ** config.depth
        self.size = (target.height, target.width)
        self.margins = (expansion.left, expansion.right, expansion.top, expansion.bottom)
        grid = (math.ceil(target.height / cell), math.ceil(target.width / cell))
        self.spare = (0, grid[1] * cell - target.width, 0, grid[0] * cell - target.height)
        channels = [config.width * 2 ** level for level in range(config.depth + 1)]
        self.stem = _layer(nn.Conv2d(4, channels[0], 7, padding=3, bias=False))
        self.down = nn.Sequential(*(
            _layer(nn.Conv2d(a, b, 3, stride=2, padding=1, bias=False))
            for a, b in zip(channels, channels[1:])))
        self.body = nn.Sequential(*(
            FourierBlock(channels[-1], *grid) for _ in range(config.blocks)))
        self.up = nn.Sequential(*(
            _layer(nn.ConvTranspose2d(b, a, 3, stride=2, padding=1, output_padding=1, bias=False))
            for a, b in zip(channels[-2::-1], channels[::-1])))
        self.head = nn.Conv2d(channels[0], 4, 7, padding=3)

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        # Seen pixels come with a one in the fourth channel, all others are zero.
        seen = F.pad(torch.cat([image - 0.5, torch.ones_like(image[:, :1])], 1), self.margins)
        x = self.body(self.down(self.stem(F.pad(seen, self.spare))))
        out = self.head(self.up(x))[:, :, :self.size[0], :self.size[1]]
        return out[:, :3] + 0.5, out[:, 3:] - 2


class FourierBlock(nn.Module):
    """Two fast Fourier convolutions on a skip connection, (B, C, height, width) -> the same."""

    def __init__(self, channels: int, height: int, width: int) -> None:
        super().__init__()
        self.near = max(channels - int(channels * GLOBAL_SHARE), 1)
        sizes = (self.near, channels - self.near, height, width)
        self.first, self.second = FourierConvolution(*sizes), FourierConvolution(*sizes)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """See the class."""
        near, far = x[:, :self.near], x[:, self.near:]
        return x + torch.cat(self.second(*self.first(near, far)), 1)


class FourierConvolution(nn.Module):
    """
    Exchange between a local branch of 3x3 convolutions and a global one in the spectrum.

    The paper's figure 2: each branch is the sum of what comes from both.
    """

    def __init__(self, near: int, far: int, height: int, width: int) -> None:
        super().__init__()
        self.near_to_near = nn.Conv2d(near, near, 3, padding=1, bias=False)
        self.far_to_near = nn.Conv2d(far, near, 3, padding=1, bias=False)
        self.near_to_far = nn.Conv2d(near, far, 3, padding=1, bias=False)
        self.far_to_far = SpectralTransform(far, height, width)
        self.near_norm, self.far_norm = nn.BatchNorm2d(near), nn.BatchNorm2d(far)

    def forward(self, near: torch.Tensor,
                far: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(B, near, H, W), (B, far, H, W) -> the same."""
        new_near = self.near_to_near(near) + self.far_to_near(far)
        new_far = self.near_to_far(near) + self.far_to_far(far)
        return F.relu(self.near_norm(new_near)), F.relu(self.far_norm(new_far))


class SpectralTransform(nn.Module):
    """Show every pixel of (B, C, height, width) the whole image: a 1x1 layer on the spectrum."""

    def __init__(self, channels: int, height: int, width: int) -> None:
        super().__init__()
        half = max(channels // 2, 1)
        self.reduce = _layer(nn.Conv2d(channels, half, 1, bias=False))
        self.fourier = RealFourier(height, width)
        self.mix = _layer(nn.Conv2d(2 * half, 2 * half, 1, bias=False))
        self.restore = nn.Conv2d(half, channels, 1, bias=False)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """See the class."""
        x = self.reduce(x)
        # A spectrum sums over all pixels: bfloat16 would lose the small frequencies.
        with torch.autocast(x.device.type, enabled=False):
            spectrum = self.fourier(x.to(self.fourier.along_rows.dtype))
        mixed = self.mix(spectrum)
        with torch.autocast(x.device.type, enabled=False):
            back = self.fourier.inverse(mixed.to(self.fourier.along_rows.dtype))
        return self.restore(x + back)


def _layer(convolution: nn.Conv2d | nn.ConvTranspose2d) -> nn.Sequential:
    """Follow a convolution by batch normalisation and ReLU, as the paper does everywhere."""
    return nn.Sequential(convolution, nn.BatchNorm2d(convolution.out_channels), nn.ReLU())
