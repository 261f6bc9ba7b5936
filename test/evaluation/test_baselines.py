from neo_ros.errors import SceneError
from neo_ros.evaluation.baselines import EdgeReplication, MeanImage, NeoModel
from neo_ros.geometry import Intrinsics, ViewExpansion
import numpy as np
import pytest
from tiny_model import TINY_EXPANSION, write_tiny_model

SOURCE = Intrinsics.from_hfov(16, 12, 1.2)
EXPANSIONS = {
    'square': ViewExpansion.to_size(SOURCE, 32, 24),
    'horizontal': ViewExpansion.horizontal(SOURCE, 32),
    'one_side': ViewExpansion(SOURCE, left=0, right=5, top=3, bottom=0),
}


def shown(photo, usable=None):
    return photo, np.ones(photo.shape[:2], bool) if usable is None else usable


def narrow_image(seed=0):
    return np.random.default_rng(seed).integers(0, 256, (12, 16, 3)).astype(np.uint8)


@pytest.mark.parametrize('expansion', EXPANSIONS.values(), ids=EXPANSIONS.keys())
@pytest.mark.parametrize('make', [
    EdgeReplication, lambda expansion: MeanImage(expansion, [shown(narrow_image(1))])],
    ids=['edge_replication', 'mean_image'])
def test_floors_paste_the_observed_pixels(make, expansion):
    method, image = make(expansion), narrow_image()
    wide_image = method.expand(image)
    assert wide_image.dtype == np.uint8
    assert wide_image.shape == (expansion.target.height, expansion.target.width, 3)
    np.testing.assert_array_equal(expansion.crop(wide_image), image)
    assert method.observed_pasted
    assert method.train_minutes is method.model_mb is None


@pytest.mark.parametrize('expansion', EXPANSIONS.values(), ids=EXPANSIONS.keys())
def test_edge_replication_repeats_the_nearest_observed_pixel(expansion):
    image, target = narrow_image(), expansion.target
    rows = np.clip(np.arange(target.height) - expansion.top, 0, 11)
    columns = np.clip(np.arange(target.width) - expansion.left, 0, 15)
    np.testing.assert_array_equal(
        EdgeReplication(expansion).expand(image), image[rows[:, None], columns])


def test_the_mean_image_is_the_mean_of_a_stream_of_wide_photos():
    expansion = EXPANSIONS['horizontal']
    photos = np.random.default_rng(2).integers(0, 256, (5, 12, 32, 3)).astype(np.uint8)
    wide_image = MeanImage(expansion, (shown(photo) for photo in photos)).expand(narrow_image())
    ring = expansion.extrapolated_mask
    np.testing.assert_array_equal(
        wide_image[ring], np.rint(photos.mean(axis=0)).astype(np.uint8)[ring])


def test_the_mean_of_narrow_photos_is_stretched_over_the_wide_frame():
    photo = np.full((12, 16, 3), 10, np.uint8)
    photo[:6] = 200
    wide_image = MeanImage(EXPANSIONS['square'], [shown(photo)]).expand(narrow_image())
    assert (wide_image[:5] == 200).all()
    assert (wide_image[-5:] == 10).all()


def test_a_mean_leaves_out_what_masks_do():
    expansion = EXPANSIONS['horizontal']
    usable = np.ones((3, 12, 32), bool)
    usable[0, :, :4] = usable[:, :, 28:] = False
    photos = np.full((3, 12, 32, 3), 90, np.uint8)
    photos[~usable] = 255
    wide_image = MeanImage(expansion, zip(photos, usable)).expand(narrow_image())
    assert (wide_image[expansion.extrapolated_mask] == 90).all()


def test_a_mean_of_no_photos_is_an_error():
    with pytest.raises(SceneError, match='shown: expected at least one photo'):
        MeanImage(EXPANSIONS['square'], [])


def test_a_neo_model_expands_and_knows_its_cost(tmp_path):
    path = write_tiny_model(tmp_path / 'tiny.onnx', trained_seconds=90.0)
    method = NeoModel(path, name='neo_tiny')
    image = np.random.default_rng(0).integers(0, 256, (24, 32, 3)).astype(np.uint8)
    wide_image = method.expand(image)
    np.testing.assert_array_equal(TINY_EXPANSION.crop(wide_image), image)
    assert (method.name, method.train_minutes) == ('neo_tiny', 1.5)
    assert method.model_mb == path.stat().st_size / 1e6
    assert method.expansion == TINY_EXPANSION
