"""fp32, fp16 and int8 files of one network: the same picture, other numbers."""
from pathlib import Path

from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.outpaint.networks import build_network
from neo_ros.outpaint.variants import export_variant, Format
from neo_ros.runtime.operators import ALLOWED_OPERATORS
import numpy as np
import onnx
import onnxruntime
import pytest
import torch

pytestmark = pytest.mark.slow

EXPANSION = ViewExpansion.to_size(Intrinsics(16, 16, 8.0, 8.0, 8.0, 8.0), 32, 32)


# With as much noise on the weights as makes pictures that differ from each other.
NETWORKS = {'neo_fast': (NetworkConfig(patch=4, width=16, depth=2, hidden=64), 0.05),
            'mat': (NetworkConfig(name='mat', patch=4, width=32, depth=2, window=4), 0.1),
            'lama': (NetworkConfig(name='lama', width=16, depth=2, blocks=1), 0.08)}


@pytest.fixture(scope='module', params=NETWORKS)
def network(request: pytest.FixtureRequest) -> torch.nn.Module:
    torch.manual_seed(1)
    config, noise = NETWORKS[request.param]
    result = build_network(EXPANSION, config)
    with torch.no_grad():
        for parameter in result.parameters():
            parameter.add_(torch.randn_like(parameter) * noise)
    return result.eval()


def frames() -> np.ndarray:
    """Return uint8 (8, 16, 16, 3): smooth pictures of different brightness."""
    rows, columns = np.indices((16, 16)) / 16
    return np.stack([np.stack([rows, columns, 1 - rows], -1) * (250 - 25 * i)
                     for i in range(8)]).astype(np.uint8)


@pytest.mark.parametrize('number_format, worst_mean, types', [
    ('fp32', 0.01, {onnx.TensorProto.FLOAT}),
    ('fp16', 0.1, {onnx.TensorProto.FLOAT16}),
    ('int8', 4.0, {onnx.TensorProto.INT8})])
def test_every_format_shows_the_picture(
        network: torch.nn.Module, tmp_path: Path, number_format: Format, worst_mean: float,
        types: set[int]) -> None:
    before = [parameter.clone() for parameter in network.parameters()]
    path = tmp_path / 'model.onnx'
    export_variant(network, EXPANSION, path, number_format, frames())
    assert [file.name for file in tmp_path.iterdir()] == ['model.onnx']
    graph = onnx.load(str(path)).graph
    assert {node.op_type for node in graph.node} <= ALLOWED_OPERATORS
    assert {t.data_type for t in graph.initializer if np.prod(t.dims) > 4000} == types
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(path), options)
    shown = []
    for image in frames()[::3]:
        wide, confidence = (np.asarray(output)[0] for output in session.run(
            ['wide', 'confidence'], {'image': image[None]}))
        np.testing.assert_array_equal(EXPANSION.crop(wide), image)
        assert (EXPANSION.crop(confidence) == 255).all()
        with torch.no_grad():
            colour, _ = network(torch.from_numpy(image).permute(2, 0, 1)[None] / 255)
        expected = colour[0].clamp(0, 1).permute(1, 2, 0).numpy() * 255
        ring = EXPANSION.extrapolated_mask
        assert expected[ring].std() > 15
        assert np.abs(wide[ring] - expected[ring]).mean() < worst_mean + 0.26
        shown.append(wide[ring].astype(int))
    assert np.abs(shown[0] - shown[-1]).mean() > 5, 'a picture of the image, not one for all'
    assert all(torch.equal(a, b) for a, b in zip(before, network.parameters()))
