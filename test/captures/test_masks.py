"""Masks of every layout take the same pixels out, where the photo of the scene shows them."""
from collections.abc import Callable
import json
from pathlib import Path

from capture_files import (
    CAMERA, demo_photos, write_colmap_text, write_image, write_transforms_capture,
    write_turned_jpeg)
from neo_ros.captures.formats import CaptureFormat, detect_format
from neo_ros.captures.importing import import_capture, ImportOptions
from neo_ros.captures.photos import find_photos
from neo_ros.captures.scene_copying import import_transforms
from neo_ros.errors import SceneError
from neo_ros.machine.progress import no_stage_progress
from neo_ros.scenes.digests import list_digest
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import read_scene
import numpy as np
import pytest

# Of photos 0 and 3 a person fills a part.
USABLE = np.ones((5, 48, 64), bool)
USABLE[0, 10:30, 5:25] = USABLE[3, :, 50:] = False


def black(index: int) -> np.ndarray:
    return USABLE[index].astype(np.uint8) * 255


def listed_masks(folder: Path) -> Path:
    """List masks as nerfstudio does, one grey, one in colour."""
    write_transforms_capture(folder, demo_photos())
    document = json.loads((folder / 'transforms.json').read_text())
    write_image(folder / 'person/0.png', black(0))
    write_image(folder / 'person/3.png', np.repeat(black(3)[..., None], 3, 2))
    for index in (0, 3):
        document['frames'][index]['mask_path'] = f'person/{index}.png'
    (folder / 'transforms.json').write_text(json.dumps(document))
    return folder


def dynamic_masks(folder: Path) -> Path:
    """Lay masks beside the photos as instant-ngp does, white where pixels are left out."""
    write_transforms_capture(folder, demo_photos())
    for index in (0, 3):
        write_image(folder / f'images/dynamic_mask_{index}.png', 255 - black(index))
    return folder


def colmap_masks(folder: Path) -> Path:
    write_colmap_text(folder, demo_photos())
    for index in (0, 3):
        write_image(folder / f'masks/{index}.png.png', black(index))
    return folder


def nerfstudio_masks(folder: Path) -> Path:
    """Lay masks of twice the size into a folder, by the photos' names."""
    write_transforms_capture(folder, demo_photos())
    for index in (0, 3):
        write_image(folder / f'masks/{index}.png', black(index).repeat(2, 0).repeat(2, 1))
    return folder


def nested_masks(folder: Path) -> Path:
    """Lay masks into folders named like those of the photos."""
    write_transforms_capture(folder, demo_photos())
    (folder / 'images').rename(folder / 'walk')
    (folder / 'images').mkdir()
    (folder / 'walk').rename(folder / 'images/walk')
    text = (folder / 'transforms.json').read_text()
    (folder / 'transforms.json').write_text(text.replace('images/', 'images/walk/'))
    for index in (0, 3):
        write_image(folder / f'masks/walk/{index}.png', black(index))
    return folder


def imported(source: Path, scene: Path) -> tuple[PosedImages, str]:
    notes = import_capture(source, scene, detect_format(source), ImportOptions(),
                           no_stage_progress)
    return read_scene(scene).train, '\n'.join(notes)


@pytest.mark.parametrize('write', [
    listed_masks, dynamic_masks, colmap_masks, nerfstudio_masks, nested_masks])
def test_every_layout_leaves_out_the_same(tmp_path: Path, write: Callable[[Path], Path]) -> None:
    found, notes = imported(write(tmp_path / 'source'), tmp_path / 'scene')
    usable = found.read_all_usable()
    assert usable is not None and len(found) == 5
    np.testing.assert_array_equal(usable, USABLE)
    share = (~USABLE[[0, 3]]).mean()
    assert f'masks: 2 of 5 photos have one, which leaves out {share:.1%} of the picture' in notes
    # What is black in the scene's files is left out, as nerfstudio has it.
    copy = tmp_path / 'copy'
    import_transforms(tmp_path / 'scene', copy)
    np.testing.assert_array_equal(read_scene(copy).train.read_all_usable(), USABLE)
    assert {path and path.parent.parent for path in read_scene(copy).train.mask_paths} <= {
        None, copy, copy / 'masks'}


def test_masks_are_straightened_as_their_photos(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos(), k1=-0.2, p1=0.01)
    ramp = np.add.outer(np.arange(CAMERA.height), 2 * np.arange(CAMERA.width)).astype(np.uint8)
    for index in range(5):
        write_image(source / f'images/{index}.png', np.repeat(ramp[..., None], 3, 2))
        write_image(source / f'masks/{index}.png', np.where(ramp < 40, 0, 255).astype(np.uint8))
    found, _ = imported(source, tmp_path / 'scene')
    shown, usable = found.read_image(0)[..., 0], found.read_usable(0)
    assert usable is not None
    assert usable[shown > 43].all() and not usable[shown < 37].any()
    assert (usable != (ramp >= 40)).mean() > 0.005  # so it was bent


def test_a_smaller_pixel_is_usable_where_all_of_it_is(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos())
    mask = np.full((48, 64), 255, np.uint8)
    mask[9, 20] = 0
    write_image(source / 'masks/2.png', mask)
    found, _ = imported(source, tmp_path / 'scene')
    half = found.read_usable(2, 0.5)
    assert half is not None and np.argwhere(~half).tolist() == [[4, 10]]
    assert found.read_usable(1, 0.5) is None
    subset = found.subset([2, 1]).read_all_usable(0.5)
    assert subset is not None and [one.sum() for one in subset] == [24 * 32 - 1, 24 * 32]


def test_only_masks_change_the_digest_of_a_list(tmp_path: Path) -> None:
    plain, _ = imported(write_transforms_capture(tmp_path / 'a', demo_photos()), tmp_path / 's')
    masked, _ = imported(listed_masks(tmp_path / 'b'), tmp_path / 't')
    without = PosedImages(masked.intrinsics, masked.image_paths, masked.poses, masked.path_ids)
    assert list_digest(plain) == list_digest(without) != list_digest(masked)


def test_masks_the_wrong_way_round_are_refused(tmp_path: Path) -> None:
    source = write_transforms_capture(tmp_path / 's', demo_photos())
    for index in range(5):
        mask = np.zeros((48, 64), np.uint8)
        mask[20:24, 20:24] = 255
        write_image(source / f'masks/{index}.png', mask)
    with pytest.raises(SceneError, match='masks/0.png: expected masks that are black only where'
                                         '.*99% left out in 5 masks; turn black and white round'):
        imported(source, tmp_path / 'scene')
    assert not (tmp_path / 'scene/transforms_train.json').exists()


def test_masks_that_are_not_used_are_named(tmp_path: Path) -> None:
    source = listed_masks(tmp_path / 's')
    (source / 'person/0.png').write_bytes(b'no picture')
    (source / 'person/3.png').unlink()
    found, notes = imported(source, tmp_path / 'scene')
    assert found.read_all_usable() is None
    assert '1 listed masks are missing: person/3.png' in notes
    assert '1 masks cannot be read and leave nothing out' in notes and 'person/0.png' in notes
    source = write_transforms_capture(tmp_path / 't', demo_photos())
    write_image(source / 'masks/other.png', black(0))
    _, notes = imported(source, tmp_path / 'scene2')
    assert f'{source}/masks is not read: expected masks named like the photos' in notes


def test_a_mask_beside_a_photo_is_no_photo(tmp_path: Path) -> None:
    write_turned_jpeg(tmp_path / 'photos/a.jpg', demo_photos().images[0], 1)
    write_image(tmp_path / 'photos/dynamic_mask_a.png', black(0))
    assert detect_format(tmp_path / 'photos') == CaptureFormat.PHOTOS
    assert [path.name for path in find_photos(tmp_path / 'photos')] == ['a.jpg']
