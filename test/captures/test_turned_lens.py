"""A calibration of stored pixels turns with photos that are written upright."""
from collections.abc import Callable
import json
from pathlib import Path
import struct

from capture_files import demo_photos, write_turned_jpeg
import cv2
from encoded_images import turned_tiff
from neo_ros.captures.photos import read_photos
from neo_ros.captures.scene_writing import write_images
from neo_ros.captures.turned_lens import shown_lens, shown_pixels, TURNS
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.pictures.photo import read_photo
import numpy as np
import pytest

STORED = Intrinsics(64, 48, 58.0, 61.0, 27.0, 29.0)
TANGENTIAL = (-0.1, 0.02, 0.004, -0.003, 0.01)


def write_camera(path: Path, camera: Intrinsics, **changes: object) -> Path:
    path.write_text(json.dumps({
        'w': camera.width, 'h': camera.height, 'fl_x': camera.fx, 'fl_y': camera.fy,
        'cx': camera.cx, 'cy': camera.cy, **changes}))
    return path


def turned_webp(image: np.ndarray, orientation: int) -> bytes:
    """Return a WebP without loss of RGB uint8, with a tag (EXIF) that tells viewers to turn it."""
    plain = cv2.imencode('.webp', image[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    exif = struct.pack('<2sHIHHHIHHI', b'II', 42, 8, 1, 0x112, 3, 1, orientation, 0, 0)
    height, width = image.shape[:2]
    extended = b'\x08' + bytes(3) + b''.join(
        (size - 1).to_bytes(3, 'little') for size in (width, height))
    body = (b'WEBPVP8X' + struct.pack('<I', len(extended)) + extended + plain[12:]
            + b'EXIF' + struct.pack('<I', len(exif)) + exif)
    return b'RIFF' + struct.pack('<I', len(body)) + body


@pytest.mark.parametrize('orientation', TURNS)
def test_pixels_turn_as_a_viewer_turns_them(tmp_path: Path, orientation: int) -> None:
    path = write_turned_jpeg(tmp_path / 'a.jpg', demo_photos().images[0], orientation)
    stored = read_photo(path)
    assert stored is not None
    np.testing.assert_array_equal(
        shown_pixels(stored, orientation), read_photo(path, upright=True))


@pytest.mark.parametrize('distortion, fisheye', [
    ((), False), (TANGENTIAL, False), ((*TANGENTIAL, 0.1, 0.02, 0.0), False),
    ((0.05, -0.01, 0.0, 0.0), True)], ids=['pinhole', 'plumb_bob', 'rational', 'fisheye'])
@pytest.mark.parametrize('orientation', TURNS)
def test_a_turned_lens_sees_along_the_same_rays(
        orientation: int, distortion: tuple[float, ...], fisheye: bool) -> None:
    lens = Lens(STORED, distortion, fisheye)
    shown = shown_lens(lens, orientation, Path('cam.yaml'))
    rows, columns = np.mgrid[:48:5, :64:7]
    # Where a viewer shows each of the stored pixels.
    place = np.full((48, 64, 3), -1)
    place[rows, columns, 0] = np.arange(rows.size).reshape(rows.shape)
    found = shown_pixels(place, orientation)[..., 0]
    y, x = np.nonzero(found >= 0)
    turned = np.stack([x, y], 1)[np.argsort(found[y, x])] + 0.5
    pixels = np.stack([columns.ravel(), rows.ravel()], 1) + 0.5
    np.testing.assert_allclose(
        shown.straighten(turned), lens.straighten(pixels) @ TURNS[orientation].T, atol=1e-6)
    assert found.shape == (shown.intrinsics.height, shown.intrinsics.width)


@pytest.mark.parametrize('orientation', [3, 6])
def test_photos_that_are_stored_turned_take_their_calibration_along(
        tmp_path: Path, orientation: int) -> None:
    for name in ('a.jpg', 'b.jpg'):
        write_turned_jpeg(tmp_path / 'in' / name, demo_photos().images[0], orientation)
    capture = read_photos(tmp_path / 'in', write_camera(tmp_path / 'cam.json', STORED))
    expected = (Intrinsics(64, 48, 58, 61, 37, 19) if orientation == 3
                else Intrinsics(48, 64, 61, 58, 19, 27))
    assert {frame.lens for frame in capture.frames} == {Lens(expected, (0.0,) * 5)}
    names, camera = write_images(capture, tmp_path / 'out')
    written = read_photo(tmp_path / 'out' / str(names[0]))
    assert camera == expected and written is not None
    assert written.shape[:2] == (camera.height, camera.width)


def test_each_photo_has_the_lens_of_its_own_turn(tmp_path: Path) -> None:
    for name, orientation in (('a.jpg', 1), ('b.jpg', 3)):
        write_turned_jpeg(tmp_path / 'in' / name, demo_photos().images[0], orientation)
    capture = read_photos(tmp_path / 'in', write_camera(tmp_path / 'cam.json', STORED))
    assert [frame.lens and frame.lens.intrinsics.cx for frame in capture.frames] == [27, 37]


@pytest.mark.parametrize('turned', [turned_webp, turned_tiff])
@pytest.mark.parametrize('orientation', [3, 6])
def test_the_turn_of_a_webp_or_tiff_is_found(
        tmp_path: Path, orientation: int, turned: Callable[[np.ndarray, int], bytes]) -> None:
    path = tmp_path / 'in' / turned.__name__.replace('turned_', 'a.')
    path.parent.mkdir()
    path.write_bytes(turned(demo_photos().images[0], orientation))
    capture = read_photos(tmp_path / 'in', write_camera(tmp_path / 'cam.json', STORED))
    assert capture.frames[0].lens == shown_lens(
        Lens(STORED, (0.0,) * 5), orientation, tmp_path)


def test_a_calibration_of_upright_photos_stays_as_it_is(tmp_path: Path) -> None:
    upright = Intrinsics(48, 64, 61, 58, 19, 27)
    write_turned_jpeg(tmp_path / 'in/a.jpg', demo_photos().images[0], 6)
    capture = read_photos(tmp_path / 'in', write_camera(tmp_path / 'cam.json', upright))
    assert [frame.lens and frame.lens.intrinsics for frame in capture.frames] == [upright]
    # Held the other way round, too: nobody knows of which photos it is.
    write_turned_jpeg(tmp_path / 'in/b.jpg', demo_photos().images[0], 8)
    with pytest.raises(SceneError, match='--camera-info .*cam.json: expected the camera of 64x48 '
                       'pixels, as a.jpg is stored .*got 48x64; calibrate .*exiftool'):
        read_photos(tmp_path / 'in', tmp_path / 'cam.json')


def test_a_distortion_that_does_not_turn_is_refused(tmp_path: Path) -> None:
    lens = Lens(STORED, (*TANGENTIAL, 0, 0, 0, 0.01, 0, 0, 0))
    assert shown_lens(lens, 1, tmp_path) == lens
    with pytest.raises(SceneError, match='--camera-info cam.yaml: expected at most k1 to k6, p1 '
                       'and p2 .* got the distortion .*; calibrate with .*exiftool'):
        shown_lens(lens, 6, Path('cam.yaml'))
