"""
7-Scenes: frame-NNNNNN.color.png with frame-NNNNNN.pose.txt, in one folder or in seq-NN/.

Poses are 4x4 camera to world with OpenCV axes in metres. All scenes have the same camera, which
its authors give as 585 pixels at 640x480, centred; sequences become path ids. Depth
(frame-NNNNNN.depth.png, millimetres, 65535 = unknown) is taken as the colour camera's: its
authors did not calibrate the two to one another.
"""
from pathlib import Path

from neo_ros.captures.capture import Capture, CapturedFrame, DepthSource
from neo_ros.captures.pose_files import pose_or_lost, read_matrix
from neo_ros.errors import SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed, natural_key
from neo_ros.pictures.photo import first_photo_size

CAMERA = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)


def is_seven_scenes(source: Path) -> bool:
    """Whether the names of 7-Scenes are there."""
    return bool(_sequences(source))


def read_seven_scenes(source: Path) -> Capture:
    """Read one or more sequences; frames without a pose, or with a lost one, are left out."""
    sequences = _sequences(source)
    if not sequences:
        raise SceneError(f'{source}: expected frame-000000.color.png here or in seq-01/')
    photos = [photo for sequence in sequences for photo in _photos(sequence)]
    width, height = first_photo_size(photos, source)
    if width * CAMERA.height != height * CAMERA.width:
        raise SceneError(f'{source}: expected 640x480 images or a scaled copy of them, '
                         f'got {width}x{height}')
    lens = Lens(CAMERA.scaled(width / CAMERA.width))
    frames, left_out = [], []
    for path_id, sequence in enumerate(sequences):
        for photo in _photos(sequence):
            file = photo.with_name(photo.name.replace('.color.png', '.pose.txt'))
            pose = pose_or_lost(read_matrix(file), str(file)) if file.is_file() else None
            if pose is None:
                left_out.append(photo.relative_to(source))
                continue
            name = f'images/{photo.relative_to(source).as_posix()}'
            depth = photo.with_name(photo.name.replace('.color.png', '.depth.png'))
            frames.append(CapturedFrame(
                name, pose, lens, path_id, file=photo,
                depth=DepthSource(0.001, depth, invalid=65535) if depth.is_file() else None))
    if not frames:
        raise SceneError(f'{source}: none of the {len(photos)} images has a pose')
    notes = ((f'{len(left_out)} frames have no pose and are left out: {listed(left_out)}',)
             if left_out else ())
    return Capture(tuple(frames), notes)


def _sequences(source: Path) -> list[Path]:
    folders = [source, *sorted((path for path in source.glob('seq-*') if path.is_dir()),
                               key=lambda path: natural_key(path.name))]
    return [folder for folder in folders if next(folder.glob('frame-*.color.png'), None)]


def _photos(sequence: Path) -> list[Path]:
    return sorted(sequence.glob('frame-*.color.png'), key=lambda path: natural_key(path.name))
