"""
The two-dimensional real Fourier transform as matrix products, for sizes fixed beforehand.

A product with a constant matrix trains, exports to ONNX and runs on every provider; the DFT
operator does not (measured in docs/decisions/0006).
"""
import numpy as np
import torch
from torch import nn


class RealFourier(nn.Module):
    """
    Orthonormal rfft2 of images of height x width pixels, and its inverse.

    `forward` takes (B, C, H, W) to (B, 2C, H, W // 2 + 1): channel 2c holds the real part of
    channel c's spectrum, 2c + 1 the imaginary one. `inverse` goes back.
    """

    along_rows: torch.Tensor
    along_columns: torch.Tensor
    back_rows: torch.Tensor
    back_columns: torch.Tensor

    def __init__(self, height: int, width: int) -> None:
        super().__init__()
        self.height, self.width, self.kept = height, width, width // 2 + 1
        rows = _fourier_matrix(height)
        columns = _fourier_matrix(width)[:, :self.kept]
        # Of a real signal, all frequencies but the first and the middle one stand for two.
        double = np.full((self.kept, 1), 2.0)
        double[0] = 1
        if width % 2 == 0:
            double[-1] = 1
        matrices = {
            'along_rows': np.concatenate([columns.real, columns.imag], 1),
            'along_columns': np.block([[rows.real, -rows.imag], [rows.imag, rows.real]]),
            'back_columns': np.block([[rows.real, rows.imag], [-rows.imag, rows.real]]),
            'back_rows': np.concatenate([double * columns.real.T, double * columns.imag.T]),
        }
        for name, matrix in matrices.items():
            self.register_buffer(name, torch.from_numpy(matrix.astype(np.float32)),
                                 persistent=False)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """Transform real (B, C, H, W); see the class."""
        spectrum = (image @ self.along_rows).unflatten(-1, (2, self.kept)).transpose(2, 3)
        spectrum = self.along_columns @ spectrum.flatten(2, 3)
        return spectrum.unflatten(2, (2, self.height)).flatten(1, 2)

    def inverse(self, spectrum: torch.Tensor) -> torch.Tensor:
        """Return the real image (B, C, H, W) of (B, 2C, H, W // 2 + 1)."""
        stacked = spectrum.unflatten(1, (-1, 2)).flatten(2, 3)
        stacked = (self.back_columns @ stacked).unflatten(2, (2, self.height))
        return stacked.transpose(2, 3).flatten(3, 4) @ self.back_rows


def _fourier_matrix(size: int) -> np.ndarray:
    """Return the symmetric, unitary matrix (size, size) of the discrete Fourier transform."""
    index = np.arange(size)
    # The product of the indices is reduced first: large angles would lose digits.
    return np.exp(-2j * np.pi * (np.outer(index, index) % size) / size) / np.sqrt(size)
