"""Photos in the middle of rendered views, and the stream that mixes them in."""
from dataclasses import replace
from pathlib import Path

import cv2
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.outpaint import real_centres
from neo_ros.outpaint.pair_stream import PairStream, source_view_enlarged
from neo_ros.outpaint.real_centres import RealCentres
from neo_ros.scenes.pose_sampling import PoseSampler
from neo_ros.scenes.posed_images import PosedImages
import numpy as np
from plain_field import CENTRE, room_field
import pytest
import torch

PHOTO = Intrinsics(16, 16, 8.0, 8.0, 8.0, 8.0)


@pytest.fixture(scope='module')
def field() -> VoxelField:
    result = room_field(8000)
    result.update_occupancy()
    return result


@pytest.fixture(scope='module')
def photos(tmp_path_factory: pytest.TempPathFactory) -> PosedImages:
    """Return five photos of noise at different headings: no rendering looks like them."""
    folder, random = tmp_path_factory.mktemp('photos'), np.random.default_rng(0)
    paths = []
    for index in range(5):
        paths.append(folder / f'{index}.png')
        cv2.imwrite(str(paths[-1]), random.integers(0, 256, (16, 16, 3), np.uint8))
    x, y, z = map(float, CENTRE)
    poses = [CameraPose.from_planar(x, y, z, yaw) for yaw in range(5)]
    return PosedImages(PHOTO, tuple(paths), tuple(poses), (0,) * 5)


def test_the_photo_stands_in_its_rendered_surroundings(
        field: VoxelField, photos: PosedImages) -> None:
    expansion = ViewExpansion(PHOTO, 4, 8, 0, 2)
    wide = RealCentres(field, photos, expansion, 1.0).view(3)
    assert wide.shape == (18, 28, 4) and wide.dtype == np.uint8
    np.testing.assert_array_equal(expansion.crop(wide)[..., :3], photos.read_image(3))
    assert (expansion.crop(wide)[..., 3] == 255).all()
    rendering = render_view(field, expansion.target, photos.poses[3], 1)
    ring = expansion.extrapolated_mask
    np.testing.assert_array_equal(wide[ring][:, 3], to_uint8(rendering.coverage)[ring])


def test_the_surroundings_have_the_exposure_of_the_photo(
        field: VoxelField, photos: PosedImages, tmp_path: Path) -> None:
    expansion = ViewExpansion(PHOTO, 4, 8, 0, 2)
    shown = render_view(field, expansion.target, photos.poses[3], 1).image
    dim = 255 * shown * [0.5, 0.6, 0.7]
    cv2.imwrite(str(tmp_path / 'dim.png'),
                np.rint(expansion.crop(dim))[..., ::-1].astype(np.uint8))
    photo = PosedImages(PHOTO, (tmp_path / 'dim.png',), photos.poses[3:4], (0,))
    wide = RealCentres(field, photo, expansion, 1.0).view(0)
    assert np.abs(wide[..., :3] - dim).max() < 3


def test_what_a_mask_leaves_out_comes_from_the_field(
        field: VoxelField, photos: PosedImages, tmp_path: Path) -> None:
    expansion = ViewExpansion(PHOTO, 4, 8, 0, 2)
    mask = np.full((16, 16), 255, np.uint8)
    mask[4:10, 3:9] = 0
    cv2.imwrite(str(tmp_path / 'mask.png'), mask)
    masked = replace(photos, mask_paths=(None, None, None, tmp_path / 'mask.png', None))
    centre = expansion.crop(RealCentres(field, masked, expansion, 1.0).view(3))
    photo, hidden = photos.read_image(3), mask == 0
    np.testing.assert_array_equal(centre[~hidden, :3], photo[~hidden])
    assert (centre[hidden, :3] != photo[hidden]).any(-1).mean() > 0.9
    shown = expansion.crop(to_uint8(render_view(field, expansion.target, photos.poses[3],
                                                1).coverage))
    np.testing.assert_array_equal(centre[hidden, 3], shown[hidden])


@pytest.mark.parametrize('expansion, rows, columns', [
    (ViewExpansion.inside(PHOTO, 4, 0, 8, 16), slice(0, 16), slice(0, 16)),
    (ViewExpansion.inside(PHOTO.grown(4, 4, 0, 0), 8, 2, 8, 12), slice(0, 16), slice(4, 20)),
    (ViewExpansion.inside(PHOTO.cropped(2, 3, 10, 9), 2, 2, 4, 4), slice(0, 9), slice(0, 10)),
], ids=['the photo is the wide view', 'wider than the source', 'larger than the wide view'])
def test_photos_larger_than_the_source_are_truth_beyond_it(
        field: VoxelField, photos: PosedImages, expansion: ViewExpansion, rows: slice,
        columns: slice) -> None:
    wide = RealCentres(field, photos, expansion, 1.0).view(0)
    photo = photos.read_image(0)
    left, top = round(8 - expansion.target.cx), round(8 - expansion.target.cy)
    shown = photo[max(top, 0):, max(left, 0):]
    expected = shown[:rows.stop - rows.start, :columns.stop - columns.start]
    np.testing.assert_array_equal(wide[rows, columns, :3], expected)
    assert (wide[rows, columns, 3] == 255).all()


def test_views_that_no_memory_holds_are_rendered_again(
        field: VoxelField, photos: PosedImages, monkeypatch: pytest.MonkeyPatch) -> None:
    expansion = ViewExpansion(PHOTO, 4, 8, 0, 2)
    centres = RealCentres(field, photos, expansion, 1.0)
    first = centres.views([0, 1, 2, 3, 4])
    monkeypatch.setattr(real_centres, 'KEPT_BYTES', 3 * first[0].nbytes)
    few = RealCentres(field, photos, expansion, 1.0)
    order = [0, 1, 2, 0, 3, 4, 0, 1]
    np.testing.assert_array_equal(few.views(order), first[order])
    assert list(few._rendered) == [4, 0, 1]


def stream(field: VoxelField, photos: PosedImages, share: float) -> PairStream:
    expansion = ViewExpansion.to_size(PHOTO, 32, 32)
    sampler = PoseSampler(CENTRE[None, :2], (-3.14, 6.28), ((0.0, 0.0), (0.0, 0.0)),
                          (float(CENTRE[2]), 0.0))
    return PairStream(field, sampler, expansion.target, 2, 0,
                      RealCentres(field, photos, expansion, 1.0), share)


def centres_from(batch: torch.Tensor, photos: PosedImages) -> int:
    known = [photos.read_image(i) for i in range(len(photos))]
    return sum(any(np.array_equal(view[8:24, 8:24, :3], photo) for photo in known)
               for view in batch)


def test_the_stream_mixes_photos_in_as_often_as_asked(
        field: VoxelField, photos: PosedImages) -> None:
    field.seen[:] = 1
    mixed = stream(field, photos, 0.5)
    batches = [mixed.batch(step, 8) for step in range(8)]
    assert 0.3 < np.mean([centres_from(batch, photos) for batch in batches]) / 8 < 0.7
    resumed = stream(field, photos, 0.5)
    np.testing.assert_array_equal(resumed.batch(7, 8), batches[7])
    assert centres_from(stream(field, photos, 0.0).batch(0, 8), photos) == 0
    assert centres_from(stream(field, photos, 1.0).batch(0, 8), photos) == 8


@pytest.mark.parametrize('expansion, window', [
    (ViewExpansion.to_size(PHOTO, 32, 32), (0, 0, 16, 16)),
    (ViewExpansion.to_size(PHOTO, 32, 16), (0, 4, 16, 8)),
    (ViewExpansion(PHOTO, 0, 0, 16, 0), (4, 0, 8, 16)),
], ids=['square', 'horizontal', 'upwards'])
def test_the_source_view_enlarged_shows_its_middle_at_the_targets_size(
        expansion: ViewExpansion, window: tuple[int, int, int, int]) -> None:
    enlarged, target = source_view_enlarged(expansion), expansion.target
    assert (enlarged.width, enlarged.height) == (target.width, target.height)
    factor = target.width / window[2]
    shown = PHOTO.cropped(*window).scaled(factor)
    assert enlarged == shown
