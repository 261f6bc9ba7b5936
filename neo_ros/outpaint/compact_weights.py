"""
Store a network's weights in a quarter of the space: int8 with one scale per output channel.

The rounding happens in torch, before the export, so that torch and the exported file are the same
function; the graph multiplies the integers out once, when ONNX Runtime folds its constants.
"""
from pathlib import Path

from neo_ros.machine.files import whole_file
import numpy as np
import onnx
from onnx import helper, numpy_helper, TensorProto
import torch
from torch import nn

# Smaller tensors (biases, scales) are left alone: they weigh nothing and hurt most.
LEAST_ELEMENTS = 4096


@torch.no_grad()
def round_weights(network: nn.Module) -> None:
    """Round the large weights, in place, to 127 steps each way per output channel."""
    for weight in network.parameters():
        if weight.numel() >= LEAST_ELEMENTS and weight.dim() > 1:
            scale = _channel_scales(weight.numpy())
            steps = np.rint(weight.numpy() / scale)
            weight.copy_(torch.from_numpy((steps * scale).astype(np.float32)))


def compact_weights(path: Path) -> None:
    """
    Replace the rounded float32 weights of an ONNX file by int8 and scales, exactly.

    Weights that are not a multiple of their channel's scale are left as they are. A kill in
    between leaves the old file whole.
    """
    model = onnx.load(path)
    graph, nodes = model.graph, []
    for initializer in list(graph.initializer):
        weight = numpy_helper.to_array(initializer)
        if weight.dtype != np.float32 or weight.size < LEAST_ELEMENTS or weight.ndim < 2:
            continue
        found = _integers(weight)
        if found is None:
            continue
        steps, scale = found
        name = initializer.name
        graph.initializer.remove(initializer)
        graph.initializer.extend([numpy_helper.from_array(steps, name + '_int8'),
                                  numpy_helper.from_array(scale, name + '_scale')])
        nodes += [helper.make_node('Cast', [name + '_int8'], [name + '_steps'],
                                   to=TensorProto.FLOAT),
                  helper.make_node('Mul', [name + '_steps', name + '_scale'], [name])]
    for node in reversed(nodes):
        graph.node.insert(0, node)
    with whole_file(path) as partial:
        onnx.save_model(model, str(partial))


def _integers(weight: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """Split rounded weights into int8 steps and scales; the exporter may have transposed them."""
    for axis in (0, weight.ndim - 1):
        scale = _channel_scales(weight, axis)
        steps = np.rint(weight / scale)
        if np.array_equal((steps * scale).astype(np.float32), weight):
            return steps.astype(np.int8), scale
    return None


def _channel_scales(weight: np.ndarray, axis: int = 0) -> np.ndarray:
    """Return the step size of every channel, float32, shaped to multiply the weights."""
    others = tuple(i for i in range(weight.ndim) if i != axis)
    largest = np.abs(weight).max(axis=others, keepdims=True)
    scale = (np.maximum(largest, 1e-12) / 127).astype(np.float32)
    # With 16 bits of mantissa every multiple up to 127 is exact, so the scale can be found again.
    return ((scale.view(np.uint32) + 0xff) & ~np.uint32(0xff)).view(np.float32)
