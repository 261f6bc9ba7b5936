"""What an ONNX model costs, and a model of any size that nobody had to train."""
import math
from pathlib import Path
from typing import Any, TYPE_CHECKING

from neo_ros import __version__
from neo_ros.geometry import ViewExpansion
from neo_ros.runtime import ModelCard, write_model_card
from neo_ros.runtime.model_card import Parity
import numpy as np

if TYPE_CHECKING:
    import onnx

# The stand-in: pixels a side of a patch, channels between its convolutions, convolutions.
STAND_IN_PATCH, STAND_IN_WIDTH, LAYERS = 8, 48, 6


def count_flops(path: Path | str) -> float | None:
    """
    Return the floating-point operations of one run: 2 per multiply-add of layers.

    None where the onnx package (the train extra) is missing or a shape is not known.
    """
    try:
        import onnx
    except ImportError:
        return None
    graph = onnx.shape_inference.infer_shapes(onnx.load(str(path))).graph
    shapes: dict[str, list[int]] = {tensor.name: list(tensor.dims) for tensor in graph.initializer}
    for value in [*graph.input, *graph.value_info, *graph.output]:
        dims = value.type.tensor_type.shape.dim
        if all(dim.HasField('dim_value') for dim in dims):
            shapes[value.name] = [dim.dim_value for dim in dims]
    try:
        return float(sum(_node_flops(node, shapes) for node in graph.node))
    except KeyError:
        return None


def _node_flops(node: 'onnx.NodeProto', shapes: dict[str, list[int]]) -> int:
    if node.op_type == 'Conv':
        # Weights (out, in / groups, kernel...): each output value sums over all but the first.
        per_output = math.prod(shapes[node.input[1]][1:])
    elif node.op_type == 'ConvTranspose':
        # Each input value is spread over the weights (in, out / groups, kernel...) of its channel.
        return 2 * math.prod(shapes[node.input[0]]) * math.prod(shapes[node.input[1]][1:])
    elif node.op_type == 'MatMul':
        per_output = shapes[node.input[0]][-1]
    elif node.op_type == 'Gemm':
        transposed = any(a.name == 'transA' and a.i for a in node.attribute)
        per_output = shapes[node.input[0]][0 if transposed else 1]
    else:
        return 0
    return 2 * math.prod(shapes[node.output[0]]) * per_output


def write_stand_in_model(path: Path, expansion: ViewExpansion, seed: int = 0) -> Path:
    """
    Write a valid model with random weights, for the speed of what surrounds the network.

    A few 3x3 convolutions on patches of 8x8 pixels: 2.3 GFLOP at 256x256 -> 512x512, which two
    cores do at 30 Hz. All sides must be multiples of 8. Needs the onnx package.
    """
    import onnx
    from onnx import helper, numpy_helper, TensorProto

    source, target = expansion.source, expansion.target
    patch = STAND_IN_PATCH
    constants = _stand_in_constants(expansion) | _random_weights(seed)
    steps: list[tuple[str, list[str], list[str], dict[str, Any]]] = [
        ('Transpose', ['image'], ['image_BCHW'], {'perm': [0, 3, 1, 2]}),
        ('Cast', ['image_BCHW'], ['camera'], {'to': TensorProto.FLOAT}),
        ('Div', ['camera', 'full'], ['unit'], {}),
        ('SpaceToDepth', ['unit'], ['cells'], {'blocksize': patch}),
        ('Pad', ['cells', 'grow_cells'], ['layer_0'], {}),
        *(step for layer in range(LAYERS) for step in (
            ('Conv', [f'layer_{layer}', f'weight_{layer}'], [f'sum_{layer}'], {'pads': [1] * 4}),
            ('Relu', [f'sum_{layer}'], [f'layer_{layer + 1}'], {}))),
        ('DepthToSpace', [f'layer_{LAYERS}'], ['raw'], {'blocksize': patch}),
        ('Mul', ['raw', 'full'], ['scaled'], {}),
        ('Clip', ['scaled', 'zero', 'full'], ['clipped'], {}),
        ('Split', ['clipped', 'colour_channels'], ['colour', 'doubt'], {'axis': 1}),
        ('Pad', ['camera', 'grow'], ['pasted'], {}),
        ('Where', ['unseen', 'colour', 'pasted'], ['composite'], {}),
        ('Cast', ['composite'], ['composite_uint8'], {'to': TensorProto.UINT8}),
        ('Transpose', ['composite_uint8'], ['wide'], {'perm': [0, 2, 3, 1]}),
        ('Cast', ['doubt'], ['doubt_uint8'], {'to': TensorProto.UINT8}),
        ('Squeeze', ['doubt_uint8', 'channel_axis'], ['doubt_NHW'], {}),
        ('Where', ['unseen_NHW', 'doubt_NHW', 'sure'], ['confidence'], {})]
    image_shape = [1, source.height, source.width, 3]
    wide_shape = [1, target.height, target.width, 3]
    graph = helper.make_graph(
        [helper.make_node(kind, inputs, outputs, **attributes)
         for kind, inputs, outputs, attributes in steps], 'stand_in',
        [helper.make_tensor_value_info('image', TensorProto.UINT8, image_shape)],
        [helper.make_tensor_value_info('wide', TensorProto.UINT8, wide_shape),
         helper.make_tensor_value_info('confidence', TensorProto.UINT8, wide_shape[:3])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()])
    onnx.save_model(helper.make_model(
        graph, ir_version=10, opset_imports=[helper.make_opsetid('', 18)]), str(path))
    write_model_card(path, ModelCard(
        scene_id='speed_stand_in', expansion=expansion, network='random weights',
        config_hash='none', parity=Parity(max_abs_error=0, share_within_1=1),
        trained_seconds=0, neo_ros_version=__version__))
    return path


def _stand_in_constants(expansion: ViewExpansion) -> dict[str, np.ndarray]:
    sides = (expansion.top, expansion.left, expansion.bottom, expansion.right)
    grow = np.array([0, 0, *sides[:2], 0, 0, *sides[2:]], np.int64)
    unseen = expansion.extrapolated_mask
    return {
        'grow': grow, 'grow_cells': grow // STAND_IN_PATCH, 'zero': np.array(0, np.float32),
        'full': np.array(255, np.float32), 'unseen': unseen[None, None],
        'unseen_NHW': unseen[None], 'sure': np.full((1, *unseen.shape), 255, np.uint8),
        'colour_channels': np.array([3, 1], np.int64), 'channel_axis': np.array([1], np.int64)}


def _random_weights(seed: int) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    channels = [3 * STAND_IN_PATCH ** 2, *[STAND_IN_WIDTH] * (LAYERS - 1),
                4 * STAND_IN_PATCH ** 2]
    return {f'weight_{layer}': random.normal(
        0, (inputs * 9) ** -0.5, (outputs, inputs, 3, 3)).astype(np.float32)
            for layer, (inputs, outputs) in enumerate(zip(channels, channels[1:]))}
