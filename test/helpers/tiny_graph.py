"""
The graph of the tests' tiny model, and its files in test/data, which a robot runs without onnx.

    python test/helpers/tiny_graph.py     # writes test/data anew
"""
from neo_ros.geometry import Intrinsics, ViewExpansion
import numpy as np
import onnx
from onnx import helper, numpy_helper, TensorProto
from tiny_model import graph_file, TINY_EXPANSION

# What the tests of a robot's rooms widen.
KEPT = (TINY_EXPANSION, ViewExpansion.to_size(TINY_EXPANSION.source, 80, 60),
        ViewExpansion.to_size(Intrinsics.from_hfov(64, 64, np.pi / 2), 128, 128))


def tiny_graph(expansion: ViewExpansion = TINY_EXPANSION) -> onnx.ModelProto:
    """
    Build image -> wide, confidence without a card.

    Ring: the nearest observed pixel, blurred by a 5x5 mean; confidence 64 there, 255 inside.
    """
    source, target = expansion.source, expansion.target
    grow = [0, 0, expansion.top, expansion.left, 0, 0, expansion.bottom, expansion.right]
    mask = expansion.extrapolated_mask
    constants = {
        'grow': np.array(grow, np.int64),
        'unseen': mask[None, None],
        'sureness': np.where(mask, 64, 255).astype(np.uint8)[None],
        'no_mask': np.zeros(1, np.uint8),
        'kernel': np.full((3, 1, 5, 5), 1 / 25, np.float32),
    }
    nodes = [
        helper.make_node('Transpose', ['image'], ['image_BCHW'], perm=[0, 3, 1, 2]),
        helper.make_node('Cast', ['image_BCHW'], ['pixels'], to=TensorProto.FLOAT),
        helper.make_node('Pad', ['pixels', 'grow'], ['padded'], mode='edge'),
        helper.make_node('Conv', ['padded', 'kernel'], ['blurred'], pads=[2] * 4, group=3),
        helper.make_node('Where', ['unseen', 'blurred', 'padded'], ['composite']),
        helper.make_node('Cast', ['composite'], ['wide_BCHW'], to=TensorProto.UINT8),
        helper.make_node('Transpose', ['wide_BCHW'], ['wide'], perm=[0, 2, 3, 1]),
        # An output must depend on a node; adding zero keeps it a constant.
        helper.make_node('Add', ['sureness', 'no_mask'], ['confidence']),
    ]
    graph = helper.make_graph(
        nodes, 'tiny',
        [helper.make_tensor_value_info(
            'image', TensorProto.UINT8, [1, source.height, source.width, 3])],
        [helper.make_tensor_value_info(
            'wide', TensorProto.UINT8, [1, target.height, target.width, 3]),
         helper.make_tensor_value_info(
             'confidence', TensorProto.UINT8, [1, target.height, target.width])],
        [numpy_helper.from_array(value, name) for name, value in constants.items()])
    return helper.make_model(
        graph, ir_version=10, opset_imports=[helper.make_opsetid('', 18)])


def main() -> None:
    """Write all files."""
    for expansion in KEPT:
        path = graph_file(expansion)
        path.write_bytes(tiny_graph(expansion).SerializeToString(deterministic=True))
        print(path.name, path.stat().st_size)


if __name__ == '__main__':
    main()
