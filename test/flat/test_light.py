from neo_ros.errors import SceneError
from neo_ros.flat import light as demo_light
from neo_ros.flat.rooms import demo_solids
from neo_ros.flat.shapes import FACES
import numpy as np
import pytest


@pytest.fixture(scope='module')
def light():
    return demo_light.demo_light()


def _texels_of(light, charts):
    return np.concatenate([
        np.arange(light.start[c], light.start[c] + light.columns[c] * light.rows[c])
        for c in charts])


def test_the_shipped_file_is_small():
    assert demo_light.LIGHT_FILE.stat().st_size < 200_000


@pytest.mark.slow
def test_gathering_light_anew_agrees_with_the_shipped_light(light):
    fewer = demo_light.LightQuality(shadow_rays=12, bounce_rays=48)  # noisier, but a test's time
    sizes = light.columns * light.rows
    means = np.array([light.values[start:start + size].mean() if size else 0
                      for start, size in zip(light.start, sizes)])
    # Faces that see something: of some size, and not inside a wall or under a cabinet.
    bright = np.flatnonzero((sizes >= 12) & (sizes < 300) & (means > 0.3))
    charts = np.sort(np.random.default_rng(3).choice(bright, 12, replace=False))
    again = demo_light.gather_light(demo_solids(), light.values, charts, fewer)
    shipped = light.values[_texels_of(light, charts)]
    assert np.median(np.abs(again - shipped) / shipped) < 0.1
    # The median: texels inside other solids are shipped with the light of their neighbours.
    assert np.median(again / shipped) == pytest.approx(1, abs=0.04)


def test_the_floor_is_darker_under_the_sofa(light):
    solids = demo_solids()
    floor = 0  # the first solid is the floor of the living room
    chart = floor * FACES + 5
    grid = light.values[_texels_of(light, [chart])].reshape(
        light.rows[chart], light.columns[chart], 3).mean(axis=-1)
    x = solids.lower[floor, 0] + (np.arange(grid.shape[1]) + 0.5) / grid.shape[1] * 2 * (
        solids.half[floor, 0])
    y = solids.lower[floor, 1] + (np.arange(grid.shape[0]) + 0.5) / grid.shape[0] * 2 * (
        solids.half[floor, 1])
    open_floor = grid[np.ix_((y > 1.0) & (y < 1.6), (x > 1.0) & (x < 3.0))].mean()
    under_sofa = grid[np.ix_((y > 3.5) & (y < 3.9), (x > 1.5) & (x < 3.0))].mean()
    assert open_floor > 3 * under_sofa > 0


def test_light_of_another_flat_is_refused(tmp_path, monkeypatch):
    wrong = tmp_path / 'light.npz'
    np.savez_compressed(wrong, codes=np.zeros((7, 3), np.uint8))
    monkeypatch.setattr(demo_light, 'LIGHT_FILE', wrong)
    with pytest.raises(SceneError, match='expected [0-9]+ texels, got 7'):
        demo_light.demo_light.__wrapped__()
