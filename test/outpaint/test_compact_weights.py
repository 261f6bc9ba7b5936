"""Weights as int8: rounded once, stored exactly, and small."""
from pathlib import Path

from neo_ros.outpaint.compact_weights import compact_weights, LEAST_ELEMENTS, round_weights
import numpy as np
import onnx
import onnxruntime
import pytest
import torch
from torch import nn


@pytest.fixture()
def network() -> nn.Module:
    torch.manual_seed(0)
    return nn.Sequential(nn.Conv2d(3, 64, 5), nn.Flatten(), nn.Linear(64 * 16, 200)).eval()


def test_rounding_moves_weights_by_half_a_step_at_most(network: nn.Module) -> None:
    before = [weight.detach().clone() for weight in network.parameters()]
    round_weights(network)
    for old, new in zip(before, network.parameters()):
        if old.numel() < LEAST_ELEMENTS or old.dim() == 1:
            assert torch.equal(old, new)
        else:
            step = old.abs().flatten(1).max(1).values / 127
            largest = (old - new).abs().flatten(1).max(1).values
            assert (largest <= 0.502 * step).all() and largest.max() > 0


@pytest.mark.slow
def test_the_compact_file_is_the_same_function_in_less_space(
        network: nn.Module, tmp_path: Path) -> None:
    round_weights(network)
    path, image = tmp_path / 'model.onnx', torch.rand(1, 3, 8, 8)
    torch.onnx.export(network, (image,), str(path), input_names=['x'], dynamo=True,
                      external_data=False, verbose=False)
    size = path.stat().st_size
    compact_weights(path)
    # All but the graph itself and the biases are a quarter of what they were.
    assert path.stat().st_size < 0.3 * size
    result = onnxruntime.InferenceSession(str(path)).run(None, {'x': image.numpy()})[0]
    with torch.no_grad():
        np.testing.assert_allclose(result, network(image).numpy(), atol=1e-5)


@pytest.mark.slow
def test_weights_that_were_not_rounded_stay(network: nn.Module, tmp_path: Path) -> None:
    path = tmp_path / 'model.onnx'
    torch.onnx.export(network, (torch.rand(1, 3, 8, 8),), str(path), input_names=['x'],
                      dynamo=True, external_data=False, verbose=False)
    size = path.stat().st_size
    compact_weights(path)
    assert path.stat().st_size > 0.98 * size


@pytest.mark.slow
def test_a_file_that_cannot_be_written_leaves_the_old_one(
        network: nn.Module, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    round_weights(network)
    path = tmp_path / 'model.onnx'
    torch.onnx.export(network, (torch.rand(1, 3, 8, 8),), str(path), input_names=['x'],
                      dynamo=True, external_data=False, verbose=False)
    before = path.read_bytes()

    def break_off(model: onnx.ModelProto, file: str) -> None:
        Path(file).write_bytes(b'half')
        raise OSError('no space left on device')

    monkeypatch.setattr(onnx, 'save_model', break_off)
    with pytest.raises(OSError):
        compact_weights(path)
    assert path.read_bytes() == before
