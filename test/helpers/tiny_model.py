"""A small real model for tests: replicates the edges, slides the ring's values a little."""
from pathlib import Path
from typing import Any

from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime.model_card import ModelCard, Parity, write_model_card
import numpy as np
import onnx
from onnx import helper, numpy_helper, TensorProto

TINY_EXPANSION = ViewExpansion.to_size(Intrinsics(32, 24, 16.0, 16.0, 16.0, 12.0), 64, 48)


def tiny_card(expansion: ViewExpansion = TINY_EXPANSION, **overrides: Any) -> ModelCard:
    """Build a card of a model that nobody trained."""
    fields: dict[str, Any] = {
        'scene_id': 'tiny', 'expansion': expansion, 'network': 'edge replication',
        'config_hash': '0' * 12, 'parity': Parity(max_abs_error=0, share_within_1=1.0),
        'trained_seconds': 0.0, 'neo_ros_version': '0.0.0', **overrides}
    return ModelCard(**fields)


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


def write_tiny_model(path: Path, expansion: ViewExpansion = TINY_EXPANSION,
                     **card_overrides: Any) -> Path:
    """Write a small valid model; keyword arguments replace fields of its card."""
    onnx.save_model(tiny_graph(expansion), str(path))
    write_model_card(path, tiny_card(expansion, **card_overrides))
    return path
