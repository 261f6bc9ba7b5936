"""The three networks behind one interface: shapes, memory of the whole view, learning, export."""
from dataclasses import replace
from pathlib import Path
from typing import Any

from hypothesis import given, settings, strategies as st
from neo_ros.errors import ConfigError, GeometryError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.export import check_parity, export_onnx
from neo_ros.outpaint.fourier import RealFourier
from neo_ros.outpaint.mat import INVALID, Mat, WindowAttention
from neo_ros.outpaint.network import NetworkConfig, Outpainter
from neo_ros.outpaint.networks import (
    at_full_size, AtFullSize, build_network, check_network, fitted_expansion, fitting_expansion,
    fitting_patch, MOST_WEIGHTS, shrunk_expansion)
from neo_ros.runtime.fov_extrapolator import WideView
from neo_ros.runtime.operators import ALLOWED_OPERATORS
import numpy as np
import onnx
import onnxruntime
import pytest
import torch

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures('one_thread')]

CONFIGS = {
    'neo_fast': NetworkConfig(patch=4, width=8, depth=2, hidden=16),
    'neo_fast, few recalled': NetworkConfig(patch=4, width=8, depth=2, hidden=16, recall=2),
    'mat': NetworkConfig(name='mat', patch=4, width=16, depth=2, window=4),
    'lama': NetworkConfig(name='lama', width=8, depth=2, blocks=2)}


def expansion(width: int, height: int, *growth: int) -> ViewExpansion:
    return ViewExpansion(Intrinsics(width, height, 20, 20, width / 2, height / 2), *growth)


SQUARE = expansion(16, 16, 8, 8, 8, 8)


def randomised(name: str, view: ViewExpansion) -> torch.nn.Module:
    """Return a network none of whose weights is zero, as after some training."""
    torch.manual_seed(0)
    network = build_network(view, CONFIGS[name])
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(torch.randn_like(parameter) * 0.03)
    return network.eval()


@pytest.mark.parametrize('view', [
    SQUARE, expansion(16, 24, 8, 8, 0, 0), expansion(16, 8, 24, 0, 8, 16),
], ids=['square', 'horizontal', 'arbitrary'])
@pytest.mark.parametrize('name', CONFIGS)
def test_every_network_has_one_interface(name: str, view: ViewExpansion) -> None:
    network, image = randomised(name, view), torch.rand(2, 3, *view.crop(
        view.extrapolated_mask).shape)
    with torch.no_grad():
        colour, log_scale = network(image)
        again = network(image)[0]
        alone = network(image[1:])[0]
    assert colour.shape == (2, 3, view.target.height, view.target.width)
    assert log_scale.shape == (2, 1, view.target.height, view.target.width)
    assert torch.equal(again, colour), 'no randomness'
    torch.testing.assert_close(alone[0], colour[1], atol=1e-4, rtol=1e-3)


@pytest.mark.parametrize('name', ['mat', 'lama'])
@pytest.mark.parametrize('view', [expansion(13, 11, 5, 6, 3, 0), expansion(7, 30, 0, 10, 1, 1)],
                         ids=['small', 'narrow'])
def test_mat_and_lama_take_any_size(name: str, view: ViewExpansion) -> None:
    check_network(view, CONFIGS[name])
    image = torch.rand(1, 3, view.source.height, view.source.width)
    assert randomised(name, view)(image)[0].shape[2:] == view.extrapolated_mask.shape
    with pytest.raises(ConfigError, match='multiples of 8 pixels'):
        check_network(view, CONFIGS['neo_fast'])


@pytest.mark.parametrize('name', CONFIGS)
def test_every_wide_pixel_depends_on_the_whole_view(name: str) -> None:
    network, image = randomised(name, SQUARE).double(), torch.rand(1, 3, 16, 16).double()
    changed = image.clone()
    changed[:, :, 15, 15] += 0.5
    with torch.no_grad():
        difference = (network(changed)[0] - network(image)[0]).abs()
    assert (difference > 0).double().mean() > 0.99


@pytest.mark.parametrize('name', CONFIGS)
def test_all_of_a_network_learns(name: str) -> None:
    network = randomised(name, SQUARE).train()
    colour, log_scale = network(torch.rand(4, 3, 16, 16))
    (colour.square().sum() + log_scale.sum()).backward()
    for parameter_name, parameter in network.named_parameters():
        assert parameter.grad is not None and parameter.grad.any(), parameter_name


@pytest.mark.parametrize('name', ['mat', 'lama', 'neo_fast, few recalled'])
def test_exports_agree_with_torch_and_use_allowed_operators(name: str, tmp_path: Path) -> None:
    view = expansion(13, 11, 5, 6, 3, 0) if name != 'neo_fast, few recalled' else SQUARE
    path = tmp_path / 'model.onnx'
    function = export_onnx(randomised(name, view), view, path)
    session = onnxruntime.InferenceSession(str(path))
    images = np.random.default_rng(0).integers(
        0, 256, (4, view.source.height, view.source.width, 3), np.uint8)
    worst, within = check_parity(
        function, lambda image: WideView(*(
            output[0] for output in session.run(['wide', 'confidence'], {'image': image[None]}))),
        images)
    assert within >= 0.999 and worst <= 2
    wide = function(torch.from_numpy(images[:1]))[0][0].numpy()
    assert wide[view.extrapolated_mask].std() > 3, 'a picture, not one colour'
    assert {node.op_type for node in onnx.load(str(path)).graph.node} <= ALLOWED_OPERATORS


def test_the_parameters_of_neo_fast_keep_their_names() -> None:
    """A checkpoint that was trained with an earlier version must load."""
    state = build_network(SQUARE, NetworkConfig(patch=4, width=8, depth=2, hidden=16)).state_dict()
    assert sum(value.numel() for value in state.values()) == 34268
    assert {name.split('.')[0] for name in state} == {
        'stem', 'encode', 'shrink', 'squeeze', 'recall', 'join', 'decode', 'grow', 'head'}
    assert state['recall.4.weight'].shape == (8 * 4 * 4, 16)


def test_fewer_recalled_channels_make_a_smaller_network() -> None:
    full, few = (build_network(SQUARE, CONFIGS[name]).state_dict()
                 for name in ('neo_fast', 'neo_fast, few recalled'))
    assert full['recall.4.weight'].shape[0] == 4 * few['recall.4.weight'].shape[0]


@pytest.mark.parametrize('changes, message', [
    ({'name': 'gan'}, "network.name: expected one of neo_fast, mat, lama, got 'gan'"),
    ({'recall': -1}, 'network.recall: expected 0 or more, got -1'),
    ({'hidden': 1 << 24}, 'at most 1024 MB, .* got .* larger network.patch'),
    ({'blocks': 0}, 'network.blocks: expected 1 or more, got 0'),
    ({'name': 'mat', 'patch': 6}, 'network.patch: mat expects a power of two, got 6'),
    ({'name': 'mat', 'width': 48}, 'network.width: mat expects a multiple of 32, got 48'),
], ids=str)
def test_settings_that_make_no_network(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_network(SQUARE, NetworkConfig(**changes))


@pytest.mark.parametrize('camera, source, patch', [
    ((64, 64), (64, 64), 8), ((256, 256), (256, 256), 8), ((64, 48), (64, 48), 4),
    ((640, 480), (640, 480), 20), ((848, 480), (840, 480), 15), ((1280, 720), (1280, 720), 20),
    ((1296, 968), (1280, 960), 40), ((641, 479), (624, 468), 13)], ids=str)
def test_a_camera_of_any_size_gets_a_network_that_fits(
        camera: tuple[int, int], source: tuple[int, int], patch: int) -> None:
    config = NetworkConfig()
    view = fitting_expansion(Intrinsics(*camera, 500, 500, 300, 200), config)
    assert (view.source.width, view.source.height) == source
    # The middle of the image is kept, and with it the ray that each pixel shows.
    assert view.source.cx == 300 - (camera[0] - source[0]) // 2
    assert (view.target.width, view.target.height) == (2 * source[0], 2 * source[1])
    assert fitting_patch(view, config) == patch
    with torch.device('meta'):
        middle = Outpainter(view, replace(config, patch=patch)).recall
    assert sum(weight.numel() for weight in middle.parameters()) < 1.01 * MOST_WEIGHTS


@pytest.mark.parametrize('photo, margin, scale, shrink, source, target', [
    ((320, 240), 80, 1.0, 1, (160, 240), (320, 240)),
    ((320, 240), 80, 0.5, 2, (80, 120), (160, 120)),
    ((1080, 1920), 256, 0.25, 1, (120, 480), (264, 480)),
    ((1080, 1920), 256, 1.0, 8, (480, 1920), (1056, 1920)),
    ((641, 479), 160, 0.5, 1, (160, 232), (320, 232)),
    ((643, 481), 161, 0.5, 1, (160, 240), (320, 240))], ids=str)
def test_a_stated_view_is_trimmed_only_where_no_cells_fit(
        photo: tuple[int, int], margin: int, scale: float, shrink: int, source: tuple[int, int],
        target: tuple[int, int]) -> None:
    config = NetworkConfig(shrink=shrink)
    camera = Intrinsics(*photo, 500, 500, photo[0] / 2, photo[1] / 2)
    stated = ViewExpansion.inside(camera, margin, 0, photo[0] - 2 * margin, photo[1])
    view = fitted_expansion(stated, scale, config)
    assert (view.source.width, view.source.height) == source
    assert (view.target.width, view.target.height) == target
    assert view.source.fx == 500 * scale
    small = shrunk_expansion(view, config)
    check_network(small, NetworkConfig(patch=fitting_patch(small, config)))
    # What is left still has its place in the photo, to the pixel.
    off = camera.cx * scale - view.target.cx
    assert off == pytest.approx(round(off)) and off + target[0] <= photo[0] * scale


def test_no_size_that_fits_is_an_error() -> None:
    stated = ViewExpansion.to_size(Intrinsics(7, 9, 9, 9, 3, 4), 15, 9)
    with pytest.raises(GeometryError, match='whole pixels'):
        fitted_expansion(stated, 0.3, NetworkConfig())
    assert fitted_expansion(stated, 1, CONFIGS['lama']) == stated


def test_other_networks_take_the_whole_camera() -> None:
    view = fitting_expansion(Intrinsics(641, 479, 500, 500, 320, 240), CONFIGS['lama'])
    assert (view.source.width, view.target.width, view.target.height) == (641, 1282, 958)
    assert fitting_patch(view, CONFIGS['lama']) == 8


def test_a_stated_patch_stays() -> None:
    view = fitting_expansion(Intrinsics(70, 50, 30, 30, 35, 25), CONFIGS['neo_fast'])
    assert (view.source.width, view.source.height) == (64, 48)
    check_network(view, CONFIGS['neo_fast'])


@settings(max_examples=25)
@given(st.integers(1, 13), st.integers(2, 13), st.integers(0, 99))
def test_the_matrix_products_are_the_fourier_transform(height: int, width: int,
                                                       seed: int) -> None:
    image = torch.randn(2, 3, height, width, generator=torch.Generator().manual_seed(seed))
    fourier = RealFourier(height, width)
    spectrum = fourier(image)
    expected = torch.view_as_real(torch.fft.rfft2(image, norm='ortho'))
    torch.testing.assert_close(
        spectrum.unflatten(1, (3, 2)), expected.movedim(-1, 2), atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(fourier.inverse(spectrum), image, atol=1e-4, rtol=1e-4)


def test_attention_looks_at_valid_tokens_alone_and_makes_their_window_valid() -> None:
    valid = np.zeros((4, 8), bool)
    valid[1, 1] = True
    torch.manual_seed(0)
    attention = WindowAttention(16, 4, valid, shifted=False)
    assert attention.hidden is not None and attention.hidden.shape == (2, 1, 1, 16)
    assert (attention.hidden[0] == INVALID).sum() == 15
    np.testing.assert_array_equal(attention.valid[:, 3:5], [[True, False]] * 4)
    tokens = torch.randn(1, 4, 8, 16)
    changed = tokens.clone()
    changed[0, 0, 0] += 3  # invalid: no other token may notice
    difference = (attention(tokens) - attention(changed)).abs().amax(-1)[0]
    assert difference.max() < 1e-6
    changed = tokens.clone()
    changed[0, 1, 1] += 3
    difference = (attention(tokens) - attention(changed)).abs().amax(-1)[0]
    assert difference[:, :4].min() > 1e-4 and difference[:, 4:].max() == 0


def test_shifted_windows_reach_across_the_borders_of_the_others() -> None:
    valid = np.zeros((8, 8), bool)
    valid[:, :4] = True
    torch.manual_seed(0)
    shifted = WindowAttention(16, 4, valid, shifted=True)
    assert shifted.valid.sum() == 8 * 6
    tokens = torch.randn(1, 8, 8, 16)
    assert shifted(tokens).shape == tokens.shape


def test_all_tokens_of_mat_become_valid() -> None:
    network = build_network(SQUARE, CONFIGS['mat'])
    assert isinstance(network, Mat)
    stages = [*network.down_stages, *network.up_stages]
    assert stages[0].blocks[0].attention.hidden is not None
    assert all(stage.valid.all() for stage in stages[1:])


def test_a_network_that_sees_the_image_shrunk_is_one_of_the_full_size() -> None:
    full, config = expansion(48, 48, 24, 24, 24, 24), replace(CONFIGS['neo_fast'], shrink=3)
    small = shrunk_expansion(full, config)
    assert (small.source.width, small.left, small.source.fx) == (16, 8, pytest.approx(20 / 3))
    inner = randomised('neo_fast', small)
    network, image = at_full_size(inner, config), torch.rand(1, 3, 48, 48)
    assert at_full_size(inner, CONFIGS['neo_fast']) is inner
    with torch.no_grad():
        colour, log_scale = network(image)
        inner_colour, _ = inner(image.reshape(1, 3, 16, 3, 16, 3).mean((3, 5)))
    assert colour.shape == (1, 3, 96, 96) and log_scale.shape == (1, 1, 96, 96)
    # The middle of each block is the pixel itself.
    torch.testing.assert_close(colour[..., 1::3, 1::3], inner_colour, atol=1e-4, rtol=0)


def test_a_shrunk_network_is_exported_with_its_resizing(tmp_path: Path) -> None:
    full, config = expansion(48, 48, 24, 24, 24, 24), replace(CONFIGS['neo_fast'], shrink=3)
    network = AtFullSize(randomised('neo_fast', shrunk_expansion(full, config)), 3).eval()
    path = tmp_path / 'model.onnx'
    function = export_onnx(network, full, path)
    session = onnxruntime.InferenceSession(str(path), providers=['CPUExecutionProvider'])

    def run(image: np.ndarray) -> WideView:
        wide, confidence = session.run(None, {'image': image[None]})
        return WideView(wide[0], confidence[0])

    images = np.random.default_rng(0).integers(0, 256, (3, 48, 48, 3), np.uint8)
    worst, share = check_parity(function, run, images)
    assert worst <= 2 and share > 0.999
    assert np.array_equal(full.crop(run(images[0]).wide_image), images[0])


def test_a_shrink_that_leaves_no_whole_pixels_names_what_would() -> None:
    with pytest.raises(ConfigError, match='network.shrink: expected a divisor of 8,.*got 3'):
        shrunk_expansion(SQUARE, NetworkConfig(shrink=3))


@given(width=st.integers(60, 700), height=st.integers(60, 500), shrink=st.integers(1, 5))
@settings(max_examples=30, deadline=None)
def test_every_camera_gets_a_view_that_a_shrunk_network_fits(
        width: int, height: int, shrink: int) -> None:
    config = NetworkConfig(shrink=shrink)
    view = fitting_expansion(Intrinsics(width, height, 300, 300, width / 2, height / 2), config)
    check_network(shrunk_expansion(view, config), config)
    assert view.source.width > 0.6 * width and view.source.height > 0.6 * height
    assert view.target.width == 2 * view.source.width
