"""Export an outpainter as one self-contained ONNX file: uint8 in, uint8 out, all inside."""
from collections.abc import Callable
import logging
from pathlib import Path

from neo_ros.errors import ModelError
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.files import whole_file
from neo_ros.outpaint.compact_weights import compact_weights, round_weights
from neo_ros.runtime.confidence import DECAY
from neo_ros.runtime.fov_extrapolator import WideView
from neo_ros.runtime.operators import ALLOWED_OPERATORS
import numpy as np
import onnx
import torch
from torch import nn

OPSET = 18
# Share of the values that torch and the exported file must agree on within 1/255.
LEAST_PARITY = 0.999


class ExportedFunction(nn.Module):
    """
    The complete function of a model file.

    image uint8 (1, h, w, 3) RGB -> wide uint8 (1, H, W, 3) RGB, whose observed window is the
    input bit by bit, and confidence uint8 (1, H, W), 255 = sure (and always 255 where seen); see
    `runtime/confidence.py`. error_factor is what `calibration_factor` found.
    """

    def __init__(self, network: nn.Module, expansion: ViewExpansion,
                 error_factor: float = 1.0) -> None:
        super().__init__()
        self.network, self.decay = network, DECAY * error_factor
        self.rows, self.columns = expansion.observed

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        colour, log_scale = self.predict(image.permute(0, 3, 1, 2).float() / 255)
        wide = (colour.clamp(0, 1) * 255).round().to(torch.uint8).permute(0, 2, 3, 1)
        sure = torch.exp(-torch.exp(log_scale) * self.decay)
        confidence = (sure * 255).round().to(torch.uint8)[:, 0]
        return (self._framed(wide, image),
                self._framed(confidence, torch.full_like(image[..., 0], 255)))

    def predict(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Run the network on (1, 3, h, w) in [0, 1]."""
        return self.network(image)

    def _framed(self, wide: torch.Tensor, seen: torch.Tensor) -> torch.Tensor:
        """Put the observed window into (1, H, W, ...) without touching its values."""
        rows, columns = self.rows, self.columns
        middle = torch.cat([wide[:, rows, :columns.start], seen, wide[:, rows, columns.stop:]], 2)
        return torch.cat([wide[:, :rows.start], middle, wide[:, rows.stop:]], 1)


def calibration_factor(network: nn.Module, expansion: ViewExpansion, views: np.ndarray) -> float:
    """
    Return the factor that brings the mean predicted error to the mean error on held-out views.

    views: RGBA uint8 (N, H, W, 4) with coverage in A, as training batches. 1 where none of them
    shows anything of the ring.
    """
    rows, columns = expansion.observed
    predicted = actual = 0.0
    for view in views:
        wide = torch.from_numpy(view).permute(2, 0, 1)[None].float() / 255
        ring = torch.from_numpy(expansion.extrapolated_mask) & (wide[0, 3] > 0.5)
        with torch.no_grad():
            colour, log_scale = network(wide[:, :3, rows, columns])
        predicted += float(log_scale[0, 0].exp()[ring].sum())
        actual += float((colour.clamp(0, 1) - wide[:, :3]).abs().mean(1)[0][ring].sum())
    return actual / predicted if actual > 0 and predicted > 0 else 1.0


def export_onnx(network: nn.Module, expansion: ViewExpansion, path: Path,
                error_factor: float = 1.0) -> ExportedFunction:
    """
    Write the model file (without its card) and return the torch function it must equal.

    The network's large weights are rounded to int8, in place. Raises ModelError for operators
    that no model file may use.
    """
    round_weights(network)
    function = ExportedFunction(network, expansion, error_factor).eval()
    write_graph(function, expansion, path)
    try:
        compact_weights(path)
    except OSError as error:
        raise ModelError(f'{path}: cannot write: {error.strerror}; make room, and give the same '
                         'command again') from error
    return function


def write_graph(function: ExportedFunction, expansion: ViewExpansion, path: Path) -> None:
    """Write a function as one ONNX file; raises ModelError for operators outside the list."""
    source = expansion.source
    example = torch.zeros(1, source.height, source.width, 3, dtype=torch.uint8)
    # It would warn of every operator of torchvision, which nothing here uses.
    logging.getLogger('torch.onnx._internal.exporter._registration').setLevel(logging.ERROR)
    try:
        with whole_file(path) as partial:
            torch.onnx.export(function, (example,), str(partial), input_names=['image'],
                              output_names=['wide', 'confidence'], opset_version=OPSET,
                              dynamo=True, external_data=False, verbose=False)
            _clean_graph(partial)
    except OSError as error:
        raise ModelError(f'{path}: cannot write: {error.strerror}; make room, and give the same '
                         'command again') from error


def _clean_graph(path: Path) -> None:
    """Drop the exporter's notes on every node, source lines with paths; check the operators."""
    model = onnx.load(str(path))
    graph = model.graph
    for part in (graph, *graph.node, *graph.input, *graph.output, *graph.value_info,
                 *graph.initializer):
        del part.metadata_props[:]
    foreign = {node.op_type for node in graph.node} - ALLOWED_OPERATORS
    if foreign:
        raise ModelError(f'{path}: expected operators of runtime/operators.py alone, the export '
                         f'needs {sorted(foreign)}; express the network without them')
    onnx.save_model(model, str(path))


def check_parity(function: ExportedFunction,
                 run_exported: Callable[[np.ndarray], WideView], images: np.ndarray,
                 ) -> tuple[int, float]:
    """
    Compare torch with the exported file on real frames, uint8 (N, h, w, 3).

    run_exported widens one image; wide image and confidence are compared.
    Returns the largest error in steps of 1/255 and the share of values within one step.
    """
    worst, within, total = 0, 0, 0
    for image in images:
        with torch.no_grad():
            expected = function(torch.from_numpy(image[None]))
        found = run_exported(image)
        for output, values in zip(expected, (found.wide_image, found.confidence)):
            error = np.abs(values.astype(int) - output[0].numpy().astype(int))
            worst = max(worst, int(error.max()))
            within += int((error <= 1).sum())
            total += error.size
    return worst, within / total


def require_parity(path: Path, worst: int, share: float) -> None:
    """Raise ModelError, and delete the file, where it is not the function that was trained."""
    if share < LEAST_PARITY:
        path.unlink(missing_ok=True)
        raise ModelError(
            f'{path}: expected {100 * LEAST_PARITY} % of the values within 1/255 of torch, got '
            f'{100 * share:.3f} % and an error of up to {worst}/255; the file was deleted')
