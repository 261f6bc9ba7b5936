"""Depth of every format comes into the scene in millimetres, where its photo shows the same."""
from collections.abc import Callable
from dataclasses import replace
import json
from pathlib import Path
from typing import Any

from capture_files import CAMERA, demo_photos, write_image
from depth_files import (
    true_depth, write_polycam_depth, write_r3d_depth, write_record3d_depth, write_replica_depth,
    write_scaled_depth, write_scannet_depth, write_seven_scenes_depth, write_transforms_depth,
    write_tum_depth, write_unpacked_r3d_depth)
from neo_ros.captures import record3d_depth
from neo_ros.captures.capture import Capture, DepthSource
from neo_ros.captures.formats import CaptureFormat, detect_format, FOLDER_READERS
from neo_ros.captures.importing import import_capture, ImportOptions
from neo_ros.captures.nerfstudio import read_transforms_capture
from neo_ros.captures.record3d import read_record3d
from neo_ros.captures.record3d_depth import decode_depth
from neo_ros.captures.scene_copying import import_transforms
from neo_ros.captures.scene_writing import write_capture
from neo_ros.errors import ConfigError, SceneError
from neo_ros.machine.progress import no_stage_progress
from neo_ros.scenes.scene import read_scene
import numpy as np
from phone_files import write_camera_info
import pytest

# Writer, format, and how many pixels of the photo one of the depth is, across and down.
FORMATS: dict[str, tuple[Callable[..., Path], CaptureFormat, int]] = {
    'tum': (write_tum_depth, CaptureFormat.TUM, 1),
    '7scenes': (write_seven_scenes_depth, CaptureFormat.SEVEN_SCENES, 1),
    'scannet': (write_scannet_depth, CaptureFormat.SCANNET, 2),
    'polycam': (write_polycam_depth, CaptureFormat.POLYCAM, 2),
    'record3d, exr': (write_record3d_depth, CaptureFormat.RECORD3D, 2),
    'r3d': (write_r3d_depth, CaptureFormat.RECORD3D, 2),
    'r3d, unpacked': (write_unpacked_r3d_depth, CaptureFormat.RECORD3D, 2),
    'nerfstudio': (write_transforms_depth, CaptureFormat.TRANSFORMS, 1),
    'replica': (write_replica_depth, CaptureFormat.TRAJECTORY, 1),
    'scale of the camera file': (write_scaled_depth, CaptureFormat.TRAJECTORY, 1),
}


def depths_of(scene: Path) -> np.ndarray:
    found = read_scene(scene).train.read_depths()
    assert found is not None
    return found


@pytest.mark.parametrize('write, format_, each', FORMATS.values(), ids=FORMATS.keys())
def test_every_format_gives_the_same_depth(tmp_path: Path, write: Callable[..., Path],
                                           format_: CaptureFormat, each: int) -> None:
    if format_ == CaptureFormat.RECORD3D:
        for package in ('OpenEXR', 'lzfse'):
            pytest.importorskip(package, reason=f'needs {package} (the record3d extra)')
    source = write(tmp_path / 'source', demo_photos())
    assert detect_format(source) == format_
    options = ({'camera_info': write_camera_info(tmp_path / 'camera.yaml')}
               if format_ == CaptureFormat.TUM else {})
    notes = write_capture(FOLDER_READERS[format_](source, **options), tmp_path / 'scene')
    expected = (true_depth() * 1000)[:, ::each, ::each].repeat(each, 1).repeat(each, 2)
    np.testing.assert_allclose(depths_of(tmp_path / 'scene'), expected, atol=1)
    known = (expected > 0).mean()
    note, = [note for note in notes if 'have a depth map' in note]
    assert f'5 of 5 photos have a depth map, which covers {known:.0%} of the picture' in note


@pytest.mark.parametrize('package, write', [
    ('OpenEXR', write_record3d_depth), ('lzfse', write_r3d_depth)])
def test_depth_whose_package_is_missing_says_what_to_install(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str,
        write: Callable[..., Path]) -> None:
    pytest.importorskip(package, reason=f'needs {package} (the record3d extra)')
    source = write(tmp_path / 'source', demo_photos())
    monkeypatch.setattr(record3d_depth, 'find_spec', lambda name: None)
    notes = write_capture(read_record3d(source), tmp_path / 'scene')
    assert "depth maps are not read; they need: pip install '.[record3d]' in a checkout" in notes
    assert read_scene(tmp_path / 'scene').train.read_depths() is None


def test_depth_of_record3d_that_is_damaged_is_named(tmp_path: Path) -> None:
    lzfse = pytest.importorskip('lzfse', reason='needs lzfse (the record3d extra)')
    pytest.importorskip('OpenEXR', reason='needs OpenEXR (the record3d extra)')
    whole = lzfse.compress(np.ones(32 * 24, np.float32).tobytes())
    trust = lzfse.compress(np.array([0, 1, 2] * 256, np.uint8).tobytes())
    trusted = decode_depth(whole, trust, (64, 48))
    assert trusted is not None and trusted.mean() == pytest.approx(2 / 3)
    for depth, confidence in ((whole[:20], None), (b'', trust), (None, None), (whole, trust[:9]),
                              (lzfse.compress(bytes(28)), None)):
        assert decode_depth(depth, confidence, (64, 48)) is None
    source = write_record3d_depth(tmp_path / 'source', demo_photos())
    (source / 'depth/3.exr').write_bytes(b'no exr')
    notes = write_capture(read_record3d(source), tmp_path / 'scene')
    assert f'1 depth maps cannot be read and are left out: {source}/depth/3.exr' in notes


def test_depth_is_straightened_as_its_photo_is(tmp_path: Path) -> None:
    source = write_transforms_depth(tmp_path / 's', demo_photos(), k1=-0.2, p1=0.01)
    # The same ramp as a photo and as depth: what both show must stay the same.
    ramp = np.add.outer(np.arange(CAMERA.height), 2 * np.arange(CAMERA.width)) + 40
    for index in range(5):
        write_image(source / f'images/{index}.png', np.repeat(ramp[..., None], 3, 2).astype(
            np.uint8))
        write_image(source / f'depths/{index}.png', (10 * ramp).astype(np.uint16))
    write_capture(read_transforms_capture(source), tmp_path / 'scene')
    photo = read_scene(tmp_path / 'scene').train.read_image(0)[..., 0]
    assert np.abs(photo.astype(int) - ramp).max() > 4  # so it was bent
    np.testing.assert_allclose(depths_of(tmp_path / 'scene')[0] / 10, photo, atol=2)


def test_what_the_depth_camera_does_not_see_is_unknown(tmp_path: Path) -> None:
    capture = read_transforms_capture(write_transforms_depth(tmp_path / 's', demo_photos()))
    lens = capture.frames[0].lens
    assert lens is not None
    narrow = replace(lens, intrinsics=CAMERA.cropped(16, 12, 32, 24))
    for index, depth in enumerate(true_depth()):
        write_image(tmp_path / f's/depths/{index}.png',
                    (depth[12:36, 16:48] * 1000).round().astype(np.uint16))
    write_capture(with_depth(capture, lens=narrow), tmp_path / 'scene')
    expected = np.zeros_like(true_depth())
    expected[:, 12:36, 16:48] = 1000 * true_depth()[:, 12:36, 16:48]
    np.testing.assert_allclose(depths_of(tmp_path / 'scene'), expected, atol=0.6)


def with_depth(capture: Capture, **changed: Any) -> Capture:
    return replace(capture, frames=tuple(
        replace(frame, depth=replace(frame.depth or DepthSource(1), **changed))
        for frame in capture.frames))


@pytest.mark.parametrize('unit, advice', [
    (1.0, r'got 3.34e\+03 m, as one step .* 1 m; --depth-unit 0.001 would make it 3.3 m'),
    (1e-6, r'got 0.00\d+ m'),
], ids=['metres', 'micrometres'])
def test_a_unit_that_cannot_be_is_refused(tmp_path: Path, unit: float, advice: str) -> None:
    source = write_transforms_depth(tmp_path / 's', demo_photos())
    capture = with_depth(read_transforms_capture(source), unit=unit)
    with pytest.raises(SceneError, match=f'depth: expected a median between .*{advice}.*'
                                         '--depth-unit 0 leaves the depth out'):
        write_capture(capture, tmp_path / 'scene')
    assert not (tmp_path / 'scene/transforms_train.json').exists()


def test_the_unit_of_the_user_counts_also_after_a_refusal(tmp_path: Path) -> None:
    source, scene = write_transforms_depth(tmp_path / 's', demo_photos()), tmp_path / 'scene'

    def imported(unit: float | None) -> list[str]:
        return import_capture(source, scene, CaptureFormat.TRANSFORMS,
                              ImportOptions(depth_unit=unit), no_stage_progress)

    with pytest.raises(SceneError, match='depth: expected a median'):
        imported(1.0)
    imported(0.002)
    np.testing.assert_allclose(depths_of(scene), 2000 * true_depth(), atol=1)
    imported(None)
    np.testing.assert_allclose(depths_of(scene), 1000 * true_depth(), atol=1)
    assert not [note for note in imported(0) if 'depth' in note]
    assert read_scene(scene).train.read_depths() is None


def test_a_unit_is_for_captures_with_depth(tmp_path: Path) -> None:
    source = write_replica_depth(tmp_path / 's', demo_photos())
    for file in source.glob('results/depth*'):
        file.unlink()
    with pytest.raises(SceneError, match='--depth-unit: expected a capture with depth'):
        import_capture(source, tmp_path / 'scene', CaptureFormat.TRAJECTORY,
                       ImportOptions(depth_unit=0.001), no_stage_progress)
    with pytest.raises(ConfigError, match='--depth-unit: expected metres > 0'):
        ImportOptions(depth_unit=-1)


def test_depth_that_cannot_be_read_is_named_and_its_photo_stays(tmp_path: Path) -> None:
    source = write_transforms_depth(tmp_path / 's', demo_photos())
    (source / 'depths/1.png').write_bytes(b'no picture')
    write_image(source / 'depths/2.png', demo_photos().images[0])
    (source / 'depths/4.png').unlink()
    notes = write_capture(read_transforms_capture(source), tmp_path / 'scene')
    assert '1 listed depth maps are missing: depths/4.png' in notes
    assert any('2 depth maps cannot be read' in note and 'depths/1.png' in note for note in notes)
    found = read_scene(tmp_path / 'scene').train
    assert [path is not None for path in found.depth_paths] == [True, False, False, True, False]
    assert len(found) == 5


def test_a_scale_that_nobody_states_is_no_unit(tmp_path: Path) -> None:
    source = write_scaled_depth(tmp_path / 's', demo_photos())
    camera = json.loads((source / 'camera.json').read_text())
    for scale, message in ((None, '5 depth maps are not read, as their unit is not known'),
                           ('a lot', 'camera.json: scale: expected the steps')):
        camera['camera'] = {**camera['camera'], 'scale': scale}
        if scale is None:
            del camera['camera']['scale']
        (source / 'camera.json').write_text(json.dumps(camera))
        try:
            said = ' '.join(FOLDER_READERS[CaptureFormat.TRAJECTORY](source).notes)
        except SceneError as error:
            said = str(error)
        assert message in said


def test_an_import_that_was_broken_off_goes_on_with_its_depth(tmp_path: Path) -> None:
    source, scene = write_transforms_depth(tmp_path / 's', demo_photos()), tmp_path / 'scene'

    def stop(done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    capture = read_transforms_capture(source)
    with pytest.raises(KeyboardInterrupt):
        write_capture(capture, scene, depth_progress=stop)
    assert len(list((scene / 'depth').iterdir())) == 3
    counts: list[int] = []
    write_capture(capture, scene, depth_progress=lambda done, total: counts.append(done))
    assert counts == [3, 4, 5]
    np.testing.assert_allclose(depths_of(scene), 1000 * true_depth(), atol=1)


def test_a_scene_is_copied_with_its_depth(tmp_path: Path) -> None:
    source = write_transforms_depth(tmp_path / 's', demo_photos())
    write_capture(read_transforms_capture(source), tmp_path / 'scene')
    import_transforms(tmp_path / 'scene', tmp_path / 'copy')
    np.testing.assert_array_equal(depths_of(tmp_path / 'copy'), depths_of(tmp_path / 'scene'))
    write_image(tmp_path / 'scene/depth/3.png', demo_photos().images[0])
    with pytest.raises(SceneError, match='depth/3.png: expected a depth map'):
        import_transforms(tmp_path / 'scene', tmp_path / 'again')
