"""Captures of COLMAP, in text and binary."""
import math
from pathlib import Path
import shutil

from capture_files import demo_photos, write_colmap_binary, write_colmap_text
from neo_ros.captures.colmap import read_colmap
from neo_ros.captures.scene_writing import write_capture
from neo_ros.errors import SceneError
import numpy as np
import pytest


def test_blank_lines_do_not_shift_the_pairs_of_lines_of_colmap(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    path = source / 'sparse/0/images.txt'
    lines = path.read_text().splitlines()
    first = next(number for number, line in enumerate(lines) if not line.startswith('#'))
    path.write_text('\n'.join([*lines[:first], '', *lines[first:first + 2], '',
                               *lines[first + 2:]]) + '\n')
    capture = read_colmap(source)
    assert [frame.name for frame in capture.frames] == [f'images/{i}.png' for i in range(5)]


def test_the_largest_of_several_colmap_models_is_read(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    (source / 'sparse/7').mkdir()  # no model
    assert not read_colmap(source).notes
    shutil.copytree(source / 'sparse/0', source / 'sparse/1')
    small = source / 'sparse/0/images.txt'
    small.write_text('\n'.join(small.read_text().splitlines()[:5]))
    capture = read_colmap(source)
    assert len(capture) == 5
    assert capture.notes == (f'{source / "sparse"} holds 2 models: 1 is read, with 5 images; '
                             'others by --model: 0 (2)',)
    assert len(read_colmap(source, model=0)) == len(read_colmap(source / 'sparse/0')) == 2
    with pytest.raises(SceneError, match='--model: expected one of 0, 1 in .*, got 4'):
        read_colmap(source, model=4)


def test_images_of_a_colmap_model_may_be_elsewhere(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    (source / 'images').rename(tmp_path / 'elsewhere')
    with pytest.raises(SceneError, match='none of its 5 images .*--images DIR'):
        read_colmap(source)
    assert len(read_colmap(source, images=tmp_path / 'elsewhere')) == 5


def test_no_image_is_lost_where_images_txt_has_no_lines_of_points(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    path = source / 'sparse/0/images.txt'
    path.write_text('\n'.join(line for line in path.read_text().splitlines() if '.png' in line))
    assert [frame.name for frame in read_colmap(source).frames] == [
        f'images/{index}.png' for index in range(5)]


def test_images_of_colmap_stay_inside_the_scene(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 'a/b', demo_photos())
    shutil.copy(source / 'images/0.png', tmp_path / 'a/other.png')
    listing = source / 'sparse/0/images.txt'
    listing.write_text(listing.read_text().replace('0.png', '../../other.png', 1))
    write_capture(read_colmap(source), tmp_path / 'scene')
    images = sorted(path.relative_to(tmp_path / 'scene').as_posix()
                    for path in (tmp_path / 'scene').rglob('*.png'))
    assert images == [f'images/{index}.png' for index in range(1, 5)] + [
        'images/beside/beside/other.png']


def test_a_colmap_camera_that_is_none_is_refused_by_its_line(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos(), 'SIMPLE_RADIAL',
                               (60, 32, 24, math.nan))
    with pytest.raises(SceneError, match='cameras.txt:2: distortion: expected finite'):
        read_colmap(source)


def test_poses_of_colmap_that_are_not_finite_are_left_out(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos())
    path = source / 'sparse/0/images.txt'
    lines = path.read_text().split('\n')
    row = next(i for i, line in enumerate(lines) if line.startswith('2 '))
    lines[row] = ' '.join(['2', 'nan', *lines[row].split()[2:]])
    path.write_text('\n'.join(lines))
    capture = read_colmap(source)
    assert [frame.name for frame in capture.frames] == [f'images/{i}.png' for i in (0, 2, 3, 4)]
    assert capture.notes == ('1 images have no finite pose and are left out: 1.png',)


@pytest.mark.parametrize('folder, source', [('sparse/0', '.'), ('sparse', '0')])
def test_a_colmap_model_may_be_named_from_within(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str, source: str) -> None:
    monkeypatch.chdir(write_colmap_text(tmp_path / 's', demo_photos()) / folder)
    assert len(read_colmap(Path(source))) == 5


def test_colmap_models_that_cannot_be_made_straight_are_refused(tmp_path: Path) -> None:
    source = write_colmap_text(tmp_path / 's', demo_photos(), 'FOV', (58.5, 58.5, 32, 24, 0.9))
    with pytest.raises(SceneError, match='FOV is not supported.*image_undistorter'):
        read_colmap(source)


@pytest.mark.parametrize('model, params, distortion', [
    ('SIMPLE_PINHOLE', (60, 32, 24), ()),
    ('SIMPLE_RADIAL', (60, 32, 24, 0.1), (0.1, 0, 0, 0)),
    ('RADIAL', (60, 32, 24, 0.1, 0.2), (0.1, 0.2, 0, 0)),
    ('OPENCV', (60, 60, 32, 24, 0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4)),
    ('OPENCV_FISHEYE', (60, 60, 32, 24, 0.1, 0.2, 0.3, 0.4), (0.1, 0.2, 0.3, 0.4)),
], ids=lambda value: value if isinstance(value, str) else '')
def test_colmap_parameters_come_in_the_order_of_opencv(
        tmp_path: Path, model: str, params: tuple[float, ...],
        distortion: tuple[float, ...]) -> None:
    lens = read_colmap(
        write_colmap_text(tmp_path / 's', demo_photos(), model, params)).frames[0].lens
    assert lens is not None and lens.distortion == distortion
    assert lens.fisheye == ('FISHEYE' in model)
    assert (lens.intrinsics.fx, lens.intrinsics.fy) == (60, 60)
    assert (lens.intrinsics.cx, lens.intrinsics.cy) == (32, 24)


@pytest.mark.parametrize('length', [4, 20, 100], ids=lambda n: f'{n} bytes')
def test_cut_off_colmap_files_are_refused(tmp_path: Path, length: int) -> None:
    source = write_colmap_binary(tmp_path / 's', demo_photos())
    images = source / 'sparse/images.bin'
    images.write_bytes(images.read_bytes()[:length])
    with pytest.raises(SceneError, match='images.bin: damaged or cut off'):
        read_colmap(source)


def test_pycolmap_writes_what_is_read(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip('pycolmap', reason='needs pycolmap (the train extra)')
    source = write_colmap_text(tmp_path / 's', demo_photos())
    (source / 'sparse/0/points3D.txt').write_text('')
    images = source / 'sparse/0/images.txt'
    images.write_text(images.read_text().replace('1.5 2.5 -1 3.5 4.5 12', '1.5 2.5 -1'))
    reconstruction = pycolmap.Reconstruction(source / 'sparse/0')
    (source / 'colmap/sparse/0').mkdir(parents=True)
    reconstruction.write_binary(source / 'colmap/sparse/0')
    ours = read_colmap(source)
    (source / 'sparse/0').rename(source / 'text')
    binary = read_colmap(source)
    assert len(binary) == 5
    for a, b in zip(ours.frames, binary.frames):
        assert a.pose is not None and b.pose is not None and a.lens == b.lens
        np.testing.assert_allclose(a.pose.T_world_cam, b.pose.T_world_cam, atol=1e-12)
