from typing import Any

from neo_ros.errors import ConfigError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.network import check_fits, NetworkConfig, Outpainter
import pytest
import torch

SMALL = NetworkConfig(patch=2, width=8, depth=3, hidden=16)  # cells of 8 pixels


def expansion(width: int, height: int, *growth: int) -> ViewExpansion:
    return ViewExpansion(Intrinsics(width, height, 20, 20, width / 2, height / 2), *growth)


def randomised(view: ViewExpansion, config: NetworkConfig = SMALL) -> Outpainter:
    """Return a network none of whose weights is zero, as after some training."""
    torch.manual_seed(0)
    network = Outpainter(view, config)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(torch.randn_like(parameter) * 0.02)
    return network.eval()


@pytest.mark.parametrize('view', [
    expansion(16, 16, 8, 8, 8, 8), expansion(16, 24, 8, 8, 0, 0), expansion(16, 8, 24, 0, 8, 16),
], ids=['symmetric', 'horizontal', 'arbitrary'])
@pytest.mark.parametrize('config', [
    SMALL, NetworkConfig(patch=8, width=4, depth=1, hidden=8)], ids=['three grids', 'one grid'])
def test_every_expansion_has_a_network(view: ViewExpansion, config: NetworkConfig) -> None:
    image = torch.rand(2, 3, view.source.height, view.source.width)
    network = randomised(view, config)
    colour, log_scale = network(image)
    assert colour.shape == (2, 3, view.target.height, view.target.width)
    assert log_scale.shape == (2, 1, view.target.height, view.target.width)
    # Deterministic, and each image of a batch by itself.
    alone, _ = network(image[1:])
    torch.testing.assert_close(alone[0], colour[1], atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(network(image)[0], colour, atol=0, rtol=0)


def test_a_new_network_starts_mid_grey_and_all_of_it_learns() -> None:
    view = expansion(16, 16, 8, 8, 8, 8)
    torch.manual_seed(0)
    colour, log_scale = Outpainter(view, SMALL)(torch.rand(4, 3, 16, 16))
    assert (colour - 0.5).abs().max() < 1 and (log_scale + 2).abs().max() < 1
    network = randomised(view)
    colour, log_scale = network(torch.rand(4, 3, 16, 16))
    (colour.square().sum() + log_scale.sum()).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None and parameter.grad.any(), name


def test_every_wide_pixel_depends_on_the_whole_view() -> None:
    view = expansion(16, 16, 8, 8, 8, 8)
    network, image = randomised(view), torch.rand(1, 3, 16, 16)
    changed = image.clone()
    changed[:, :, 15, 15] += 0.5
    difference = (network(changed)[0] - network(image)[0]).abs()
    assert (difference > 0).float().mean() > 0.99


@pytest.mark.parametrize('size, message', [
    ((12, 16, 8, 8, 8, 8), "multiples of 8 pixels .*got {'source width': 12}"),
    ((16, 16, 8, 8, 4, 4), "got {'top': 4, 'bottom': 4}"),
    ((16, 20, 6, 8, 0, 0), "got {'source height': 20, 'left': 6}"),
], ids=['source', 'growth', 'both'])
def test_sizes_that_do_not_fit_are_named(size: tuple[int, ...], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        Outpainter(expansion(*size), SMALL)
    with pytest.raises(ConfigError, match='choose another scale, patch or depth'):
        check_fits(expansion(*size), SMALL)


@pytest.mark.parametrize('name, value, least', [
    ('patch', -1, 0), ('width', 0, 1), ('depth', 0, 1), ('hidden', -1, 1)])
def test_settings_out_of_range(name: str, value: int, least: int) -> None:
    changes: dict[str, Any] = {name: value}
    with pytest.raises(ConfigError, match=f'{name}: expected {least} or more, got {value}'):
        NetworkConfig(**changes)
