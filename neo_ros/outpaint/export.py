"""Export an outpainter as one self-contained ONNX file: uint8 in, uint8 out, all inside."""
import logging
import os
from pathlib import Path
from typing import Callable

from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.compact_weights import compact_weights, round_weights
from neo_ros.outpaint.network import Outpainter
import numpy as np
import onnx
import torch
from torch import nn

OPSET = 18
# A Laplace scale of this much of full brightness halves the confidence twice (255 -> 64).
HALVING_SCALE = 0.05


class ExportedFunction(nn.Module):
    """
    The complete function of a model file.

    image uint8 (1, h, w, 3) RGB -> wide uint8 (1, H, W, 3) RGB, whose observed window is the
    input bit by bit, and confidence uint8 (1, H, W), 255 = sure (and always 255 where seen).
    """

    def __init__(self, network: Outpainter, expansion: ViewExpansion) -> None:
        super().__init__()
        self.network = network
        self.rows, self.columns = expansion.observed

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        colour, log_scale = self.network(image.permute(0, 3, 1, 2).float() / 255)
        wide = (colour.clamp(0, 1) * 255).round().to(torch.uint8).permute(0, 2, 3, 1)
        sure = torch.exp(-torch.exp(log_scale) / HALVING_SCALE * 1.3862944)
        confidence = (sure * 255).round().to(torch.uint8)[:, 0]
        return (self._framed(wide, image),
                self._framed(confidence, torch.full_like(image[..., 0], 255)))

    def _framed(self, wide: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        """Put the observed window into (1, H, W, ...) without touching its values."""
        rows, columns = self.rows, self.columns
        middle = torch.cat([wide[:, rows, :columns.start], seen, wide[:, rows, columns.stop:]], 2)
        return torch.cat([wide[:, :rows.start], middle, wide[:, rows.stop:]], 1)


def export_onnx(network: Outpainter, expansion: ViewExpansion, path: Path) -> ExportedFunction:
    """
    Write the model file (without its card) and return the torch function it must equal.

    The network's large weights are rounded to int8, in place.
    """
    round_weights(network)
    function = ExportedFunction(network, expansion).eval()
    source = expansion.source
    example = torch.zeros(1, source.height, source.width, 3, dtype=torch.uint8)
    partial = path.with_suffix('.partial')
    # It would warn of every operator of torchvision, which nothing here uses.
    logging.getLogger('torch.onnx._internal.exporter._registration').setLevel(logging.ERROR)
    torch.onnx.export(function, (example,), str(partial), input_names=['image'],
                      output_names=['wide', 'confidence'], opset_version=OPSET,
                      dynamo=True, external_data=False, verbose=False)
    _drop_notes(partial)
    compact_weights(partial)
    os.replace(partial, path)
    return function


def _drop_notes(path: Path) -> None:
    """Drop the exporter's notes on every node: source lines with this machine's paths."""
    model = onnx.load(str(path))
    graph = model.graph
    for part in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info,
                 *graph.initializer):
        del part.metadata_props[:]
    onnx.save_model(model, str(path))


def check_parity(function: ExportedFunction, run_exported: Callable[[np.ndarray], np.ndarray],
                 images: np.ndarray) -> tuple[int, float]:
    """
    Compare torch with the exported file on real frames, uint8 (N, h, w, 3).

    run_exported maps one image (h, w, 3) to the wide image (H, W, 3), both uint8.
    Returns the largest error in steps of 1/255 and the share of values within one step.
    """
    worst, within, total = 0, 0, 0
    for image in images:
        with torch.no_grad():
            expected = function(torch.from_numpy(image[None]))[0][0].numpy()
        error = np.abs(run_exported(image).astype(int) - expected.astype(int))
        worst = max(worst, int(error.max()))
        within += int((error <= 1).sum())
        total += error.size
    return worst, within / total
