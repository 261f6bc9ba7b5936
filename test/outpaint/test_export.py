import math
from pathlib import Path
from typing import NamedTuple

from neo_ros.errors import ModelError
from neo_ros.geometry import Intrinsics, ViewExpansion
import neo_ros.outpaint.export
from neo_ros.outpaint.export import (
    calibration_factor, check_parity, export_onnx, ExportedFunction, OPSET, require_parity)
from neo_ros.outpaint.network import NetworkConfig, Outpainter
from neo_ros.runtime.fov_extrapolator import WideView
import numpy as np
import onnx
import onnxruntime
import pytest
import torch

CAMERA = Intrinsics(16, 16, 8.0, 8.0, 8.0, 8.0)
EXPANSIONS = {'square': ViewExpansion.to_size(CAMERA, 32, 32),
              'to the right alone': ViewExpansion(CAMERA, 0, 8, 0, 0)}


def randomised(expansion: ViewExpansion) -> Outpainter:
    """Return a network none of whose weights is zero, as after some training."""
    torch.manual_seed(1)
    network = Outpainter(expansion, NetworkConfig(patch=4, width=8, depth=2, hidden=16))
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(torch.randn_like(parameter) * 0.1)
    return network.eval()


def photos(count: int) -> np.ndarray:
    """Return uint8 (count, 16, 16, 3): noise, black, white, and a ramp."""
    images = np.random.default_rng(0).integers(0, 256, (count, 16, 16, 3), np.uint8)
    images[1], images[2] = 0, 255
    images[3] = np.arange(256).reshape(16, 16, 1)
    return images


class Export(NamedTuple):
    """An exported model and what it was made of."""

    expansion: ViewExpansion
    function: ExportedFunction
    path: Path
    session: onnxruntime.InferenceSession

    def run(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return wide (H, W, 3) and confidence (H, W) of ONNX Runtime."""
        wide, confidence = self.session.run(['wide', 'confidence'], {'image': image[None]})
        return np.asarray(wide)[0], np.asarray(confidence)[0]


@pytest.fixture(scope='module', params=EXPANSIONS)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Export:
    expansion = EXPANSIONS[request.param]
    path = tmp_path_factory.mktemp('export') / 'model.onnx'
    function = export_onnx(randomised(expansion), expansion, path)
    return Export(expansion, function, path, onnxruntime.InferenceSession(str(path)))


@pytest.mark.slow
def test_the_export_is_one_complete_file_of_stock_operators(exported: Export) -> None:
    assert [path.name for path in exported.path.parent.iterdir()] == ['model.onnx']
    model = onnx.load(str(exported.path), load_external_data=False)
    onnx.checker.check_model(model, full_check=True)
    assert [(entry.domain, entry.version) for entry in model.opset_import] == [('', OPSET)]
    assert {node.domain for node in model.graph.node} == {''} and not model.functions
    assert not any(tensor.external_data for tensor in model.graph.initializer)


def test_inputs_and_outputs_are_bytes_of_fixed_sizes(exported: Export) -> None:
    source, target = exported.expansion.source, exported.expansion.target
    found = {node.name: (node.type, node.shape) for node in (
        *exported.session.get_inputs(), *exported.session.get_outputs())}
    assert found == {
        'image': ('tensor(uint8)', [1, source.height, source.width, 3]),
        'wide': ('tensor(uint8)', [1, target.height, target.width, 3]),
        'confidence': ('tensor(uint8)', [1, target.height, target.width])}


def test_the_file_does_not_tell_where_it_was_made(exported: Export) -> None:
    content = exported.path.read_bytes()
    for place in (neo_ros.outpaint.export.__file__, torch.__file__):
        assert str(Path(place).parent).encode() not in content
    assert b'stack_trace' not in content


def test_observed_pixels_come_back_bit_identical(exported: Export) -> None:
    for image in photos(6):
        wide, confidence = exported.run(image)
        np.testing.assert_array_equal(exported.expansion.crop(wide), image)
        assert (exported.expansion.crop(confidence) == 255).all()


def test_the_export_agrees_with_torch(exported: Export) -> None:
    images = photos(8)
    worst, within = check_parity(
        exported.function, lambda image: WideView(*exported.run(image)), images)
    assert within >= 0.999 and worst <= 2
    ring = exported.run(images[0])[0][exported.expansion.extrapolated_mask]
    assert ring.std() > 5, 'a picture, not one colour'


def test_parity_counts_every_value() -> None:
    expansion = EXPANSIONS['square']
    function = ExportedFunction(randomised(expansion), expansion).eval()

    def slightly_wrong(image: np.ndarray) -> WideView:
        wide, confidence = (output[0].detach().numpy().astype(int)
                            for output in function(torch.from_numpy(image[None])))
        wide[0, 0] += np.where(wide[0, 0] > 100, -7, 7)
        wide[1, :2] += np.where(wide[1, :2] > 100, -1, 1)
        confidence[31, 31] += 9 if confidence[31, 31] < 100 else -9
        return WideView(wide.astype(np.uint8), confidence.astype(np.uint8))

    worst, within = check_parity(function, slightly_wrong, photos(4))
    assert worst == 9 and within == pytest.approx(1 - 4 / (32 * 32 * 4))


@pytest.mark.slow
def test_an_export_with_a_wrong_confidence_is_refused(tmp_path: Path) -> None:
    expansion, path = EXPANSIONS['square'], tmp_path / 'model.onnx'
    function = export_onnx(randomised(expansion), expansion, path)
    session = onnxruntime.InferenceSession(str(path))

    def run(image: np.ndarray) -> WideView:
        wide, confidence = (np.asarray(output)[0] for output in session.run(
            ['wide', 'confidence'], {'image': image[None]}))
        return WideView(wide, confidence)

    require_parity(path, *check_parity(function, run, photos(4)))
    assert path.exists()
    function.decay *= 1.5  # The file was made with another factor.
    with pytest.raises(ModelError, match='model.onnx: expected 99.9 % of the values'):
        require_parity(path, *check_parity(function, run, photos(4)))
    assert not path.exists()


def calibration_views(grey: int) -> np.ndarray:
    """Return three wide views of one grey, black where nobody saw, white in the camera's view."""
    views = np.full((3, 32, 32, 4), 255, np.uint8)
    views[..., :3] = grey
    views[:, :3] = 0
    EXPANSIONS['square'].crop(views[0])[:] = 255
    return views


@pytest.mark.parametrize('grey, error, scale', [
    (0.5, 0.3, 0.1), (0.5, 0.3, 0.6), (1.7, 0.2, 0.4)],
    ids=['too sure', 'not sure enough', 'whiter than white'])
def test_the_calibration_factor_is_error_over_prediction_in_the_ring_that_was_seen(
        grey: float, error: float, scale: float) -> None:
    views = calibration_views(round(255 * (min(grey, 1) - error)))
    factor = calibration_factor(Stub(grey, math.log(scale)), EXPANSIONS['square'], views)
    assert factor == pytest.approx(error / scale, rel=0.02)
    views[..., 3] = 0
    assert calibration_factor(Stub(grey, 0.0), EXPANSIONS['square'], views) == 1


class Stub(torch.nn.Module):
    """Stand in for a network: one grey and one scale everywhere."""

    def __init__(self, grey: float, log_scale: float) -> None:
        super().__init__()
        self.grey, self.log_scale = grey, log_scale

    def forward(self, image: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return (torch.full((1, 3, 32, 32), self.grey),
                torch.full((1, 1, 32, 32), self.log_scale))


@pytest.mark.parametrize('grey, scale, colour, confidence', [
    (0.5, 0.05, 128, 64), (0.502, 0.1, 128, 16), (-3.0, 1e-6, 0, 255), (1.7, 5.0, 255, 0)],
    ids=['half', 'twice the scale', 'sure black', 'unsure white'])
def test_colours_are_rounded_and_scales_become_confidence(
        grey: float, scale: float, colour: int, confidence: int) -> None:
    expansion = EXPANSIONS['square']
    stub = Stub(grey, float(np.log(scale)))
    wide, sure = ExportedFunction(stub, expansion)(  # type: ignore[arg-type]
        torch.from_numpy(photos(4)[:1]))
    ring = torch.from_numpy(expansion.extrapolated_mask)
    assert wide[0][ring].unique().tolist() == [colour]
    assert sure[0][ring].unique().tolist() == [confidence]


@pytest.mark.slow
def test_a_refused_graph_leaves_nothing_behind(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expansion = EXPANSIONS['to the right alone']
    monkeypatch.setattr(neo_ros.outpaint.export, 'ALLOWED_OPERATORS', frozenset({'Conv'}))
    with pytest.raises(ModelError, match='express the network without them'):
        export_onnx(randomised(expansion), expansion, tmp_path / 'model.onnx')
    assert not list(tmp_path.iterdir())
