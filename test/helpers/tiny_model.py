"""A small real model for tests: replicates the edges, slides the ring's values a little."""
from pathlib import Path
from typing import Any

from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.runtime.model_card import CARD_KEY, ModelCard, Parity
import pytest

TINY_EXPANSION = ViewExpansion.to_size(Intrinsics(32, 24, 16.0, 16.0, 16.0, 12.0), 64, 48)


def tiny_card(expansion: ViewExpansion = TINY_EXPANSION, **overrides: Any) -> ModelCard:
    """Build a card of a model that nobody trained."""
    fields: dict[str, Any] = {
        'scene_id': 'tiny', 'expansion': expansion, 'network': 'edge replication',
        'config_hash': '0' * 12, 'parity': Parity(max_abs_error=0, share_within_1=1.0),
        'trained_seconds': 0.0, 'neo_ros_version': '0.0.0', **overrides}
    return ModelCard(**fields)


def graph_file(expansion: ViewExpansion) -> Path:
    """Return where the graph of an expansion is kept, if it is: tiny_graph.py writes it."""
    source = expansion.source
    grown = f'{expansion.left}_{expansion.right}_{expansion.top}_{expansion.bottom}'
    return (Path(__file__).parents[1] / 'data' /
            f'tiny_{source.width}x{source.height}_grown_{grown}.onnx')


def write_tiny_model(path: Path, expansion: ViewExpansion = TINY_EXPANSION,
                     **card_overrides: Any) -> Path:
    """Write a small valid model; keyword arguments replace fields of its card."""
    kept = graph_file(expansion)
    if kept.exists():
        graph = kept.read_bytes()
    else:
        pytest.importorskip('onnx', reason='makes models of sizes that test/data has not')
        from tiny_graph import tiny_graph
        graph = tiny_graph(expansion).SerializeToString()
    path.write_bytes(graph + _metadata(CARD_KEY, tiny_card(expansion, **card_overrides).to_json()))
    return path


def _metadata(key: str, value: str) -> bytes:
    """Encode what onnx would append to ModelProto.metadata_props, its field 14."""
    return _field(14, _field(1, key.encode()) + _field(2, value.encode()))


def _field(number: int, content: bytes) -> bytes:
    """Encode a field of bytes of a protobuf message."""
    head, length = bytearray([number << 3 | 2]), len(content)
    while length > 127:
        head.append(length & 127 | 128)
        length >>= 7
    return bytes([*head, length]) + content
