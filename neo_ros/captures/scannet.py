"""
ScanNet as its SensReader exports it: color/, pose/, intrinsic/ and perhaps depth/.

color/N.jpg, pose/N.txt (4x4 camera to world, OpenCV axes, metres, z up, -inf where tracking was
lost) and intrinsic/intrinsic_color.txt (4x4). depth/N.png is in millimetres, of the camera in
intrinsic_depth.txt; without that file it shows what the colour image shows.
"""
from pathlib import Path

from neo_ros.captures.capture import Capture, CapturedFrame, DepthSource
from neo_ros.captures.pose_files import pose_or_lost, read_matrix
from neo_ros.errors import GeometryError, SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.geometry.lens import Lens
from neo_ros.machine.names import listed
from neo_ros.pictures.photo import first_photo_size, list_photos


def is_scannet(source: Path) -> bool:
    """Whether the folders of the export are there."""
    return (source / 'color').is_dir() and (source / 'pose').is_dir()


def read_scannet(source: Path) -> Capture:
    """Read the export; frames without a pose, or with a lost one, are counted and left out."""
    photos = list_photos(source / 'color')
    if not photos:
        raise SceneError(f'{source / "color"}: expected images, there are none')
    lens = Lens(_intrinsics(source / 'intrinsic' / 'intrinsic_color.txt',
                            *first_photo_size(photos, source / 'color')))
    depths = {path.stem: path for path in list_photos(source / 'depth')}
    depth_lens = _depth_lens(source / 'intrinsic' / 'intrinsic_depth.txt', list(depths.values()))
    frames, lost, without = [], [], []
    for photo in photos:
        file = source / 'pose' / f'{photo.stem}.txt'
        if not file.is_file():
            without.append(photo.name)
            continue
        pose = pose_or_lost(read_matrix(file), str(file))
        if pose is None:
            lost.append(photo.name)
            continue
        depth = depths.get(photo.stem)
        frames.append(CapturedFrame(
            f'images/{photo.name}', pose, lens, file=photo,
            depth=None if depth is None else DepthSource(0.001, depth, lens=depth_lens)))
    notes = []
    if lost:
        notes.append(f'{len(lost)} frames whose pose was lost (-inf) are left out: {listed(lost)}')
    if without:
        notes.append(f'{len(without)} images have no file in pose/ and are left out: '
                     f'{listed(without)}')
    if not frames:
        raise SceneError(f'{source}: none of the {len(photos)} images has a pose: '
                         f'{len(lost)} lost, {len(without)} without a file in pose/')
    return Capture(tuple(frames), tuple(notes), z_up=True)


def _depth_lens(path: Path, depths: list[Path]) -> Lens | None:
    if not depths or not path.is_file():
        return None
    return Lens(_intrinsics(path, *first_photo_size(depths, path.parent)))


def _intrinsics(path: Path, width: int, height: int) -> Intrinsics:
    matrix = read_matrix(path)
    fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
    # The file describes a camera's full size, exported images are often smaller.
    if abs(cx / width - 0.5) > 0.15 or abs(cy / height - 0.5) > 0.15:
        raise SceneError(
            f'{path}: expected the camera of the {width}x{height} images, got the '
            f'optical centre ({cx:.1f}, {cy:.1f}); scale its first two rows to their size')
    try:
        return Intrinsics(width, height, fx, fy, cx, cy)
    except GeometryError as error:
        raise SceneError(f'{path}: {error}') from error
