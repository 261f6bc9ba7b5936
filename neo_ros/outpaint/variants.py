"""Model files of other number formats than the usual one: fp32, fp16 and int8 arithmetic."""
from collections.abc import Iterator
from copy import deepcopy
import logging
from pathlib import Path
import tempfile
from typing import Literal

from neo_ros.geometry import ViewExpansion
from neo_ros.outpaint.export import ExportedFunction, write_graph
import numpy as np
from onnxruntime.quantization import CalibrationDataReader, quantize_static, QuantType
from onnxruntime.quantization.shape_inference import quant_pre_process
import torch
from torch import nn

Format = Literal['fp32', 'fp16', 'int8']
FORMATS: tuple[Format, ...] = ('fp32', 'fp16', 'int8')


def export_variant(network: nn.Module, expansion: ViewExpansion, path: Path, number_format: Format,
                   frames: np.ndarray, error_factor: float = 1.0) -> None:
    """
    Write a model file (without its card) of a number format; the network stays as it is.

    fp32  weights and arithmetic in single precision
    fp16  both in half precision, for GPUs; a CPU without it converts back and forth
    int8  weights and activations of convolutions and matrix products as int8 (QDQ), their ranges
          taken from `frames`, uint8 (N, h, w, 3): camera images that the model is made for
    """
    if number_format == 'fp16':
        write_graph(HalfFunction(deepcopy(network).half(), expansion, error_factor).eval(),
                    expansion, path)
        return
    function = ExportedFunction(network, expansion, error_factor).eval()
    if number_format == 'fp32':
        write_graph(function, expansion, path)
        return
    with tempfile.TemporaryDirectory() as folder:
        plain, prepared = Path(folder) / 'plain.onnx', Path(folder) / 'prepared.onnx'
        write_graph(function, expansion, plain)
        quant_pre_process(str(plain), str(prepared), skip_symbolic_shape=True)
        logging.getLogger().disabled, before = True, logging.getLogger().disabled
        try:
            # Weights of seven bits: processors without VNNI or AVX-512 add products of two in 16
            # bits, where those of eight overflow (`mat`: 9.9 grey levels off instead of less
            # than 4).
            quantize_static(
                str(prepared), str(path), _Frames(frames), per_channel=True, reduce_range=True,
                op_types_to_quantize=['Conv', 'MatMul', 'Gemm', 'ConvTranspose'],
                activation_type=QuantType.QUInt8, weight_type=QuantType.QInt8)
        finally:
            logging.getLogger().disabled = before


class HalfFunction(ExportedFunction):
    """An exported function whose network computes in half precision."""

    def predict(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Run the network; its results come back in single precision."""
        colour, log_scale = self.network(image.half())
        return colour.float(), log_scale.float()


class _Frames(CalibrationDataReader):
    """Hand camera images to the calibration, one by one."""

    def __init__(self, frames: np.ndarray) -> None:
        self._frames: Iterator[np.ndarray] = iter(frames)

    def get_next(self) -> dict[str, np.ndarray] | None:
        """Return the next input, None after the last."""
        frame = next(self._frames, None)
        return None if frame is None else {'image': frame[None]}
