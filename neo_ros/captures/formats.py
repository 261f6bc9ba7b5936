"""Tell the format of a capture by the files that are there."""
from collections.abc import Callable, Iterator
from enum import Enum
from itertools import islice
from pathlib import Path

from neo_ros.bags.bag_folder import find_storage_files, STORAGE_SUFFIXES
from neo_ros.captures.capture import Capture
from neo_ros.captures.colmap import find_model, read_colmap
from neo_ros.captures.euroc import find_euroc, read_euroc
from neo_ros.captures.nerfstudio import read_transforms_capture, TRANSFORMS_FILE
from neo_ros.captures.photos import find_photos, read_photos
from neo_ros.captures.polycam import find_keyframes, read_polycam
from neo_ros.captures.record3d import find_record3d, read_record3d, SUFFIX as RECORD3D_SUFFIX
from neo_ros.captures.scannet import is_scannet, read_scannet
from neo_ros.captures.seven_scenes import is_seven_scenes, read_seven_scenes
from neo_ros.captures.trajectory import read_trajectory, TRAJECTORY_FILE
from neo_ros.captures.tum import is_tum, read_tum
from neo_ros.captures.unread import find_unread
from neo_ros.captures.video import VIDEO_SUFFIXES
from neo_ros.errors import SceneError
from neo_ros.machine.names import listed
from neo_ros.pictures.photo import list_photos, PHOTO_SUFFIXES


class CaptureFormat(str, Enum):
    """What `neo import` reads; the values are the names on the command line."""

    SCENE = 'scene'
    TRANSFORMS = 'transforms'
    COLMAP = 'colmap'
    SCANNET = 'scannet'
    SEVEN_SCENES = '7scenes'
    TUM = 'tum'
    EUROC = 'euroc'
    RECORD3D = 'record3d'
    POLYCAM = 'polycam'
    TRAJECTORY = 'trajectory'
    BAG = 'bag'
    PHOTOS = 'photos'
    VIDEO = 'video'


# Readers of folders and files; scenes are copied, bags are read in their own room, and videos,
# which take long, show their progress.
FOLDER_READERS: dict[CaptureFormat, Callable[..., Capture]] = {
    CaptureFormat.TRANSFORMS: read_transforms_capture,
    CaptureFormat.COLMAP: read_colmap,
    CaptureFormat.SCANNET: read_scannet,
    CaptureFormat.SEVEN_SCENES: read_seven_scenes,
    CaptureFormat.TUM: read_tum,
    CaptureFormat.EUROC: read_euroc,
    CaptureFormat.RECORD3D: read_record3d,
    CaptureFormat.POLYCAM: read_polycam,
    CaptureFormat.TRAJECTORY: read_trajectory,
    CaptureFormat.PHOTOS: read_photos,
}
# Which formats take which options of `neo import`; readers take them as keywords.
FOLDER_OPTIONS = {
    'images': (CaptureFormat.COLMAP,),
    'model': (CaptureFormat.COLMAP,),
    'camera_info': (CaptureFormat.TUM, CaptureFormat.EUROC, CaptureFormat.TRAJECTORY,
                    CaptureFormat.BAG, CaptureFormat.PHOTOS, CaptureFormat.VIDEO),
}
# Folders below one without a capture that are looked at.
SEARCHED = 500


def detect_format(source: Path) -> CaptureFormat:
    """
    Return the format of a file or folder.

    The order decides: nerfstudio keeps COLMAP's files beside its own, and all have photos.
    Photos come last: where something beside them looks like poses, SceneError names it. Raises
    SceneError for empty folders and for folders of nothing known.
    """
    if source.is_file():
        if source.suffix == '.json':
            return CaptureFormat.TRANSFORMS
        if source.name.endswith(STORAGE_SUFFIXES):
            return CaptureFormat.BAG
        if source.suffix.lower() in VIDEO_SUFFIXES:
            return CaptureFormat.VIDEO
        if source.suffix.lower() == RECORD3D_SUFFIX:
            return CaptureFormat.RECORD3D
        if source.suffix.lower() == '.zip':
            raise SceneError(f'{source}: expected a folder; unpack it: unzip {source}')
        if source.suffix == '.bag':
            raise SceneError(f'{source}: expected a bag of ROS 2, got one of ROS 1; convert it: '
                             f'rosbags-convert --src {source} --dst {source.stem}')
        raise SceneError(f'{source}: expected a folder, a .json, a .r3d, a bag (.mcap, .db3) or a '
                         'video '
                         f'({", ".join(VIDEO_SUFFIXES)})')
    if not source.is_dir():
        raise SceneError(f'{source}: no such file or folder (and not the word "demo")')
    format_ = _recognised(source)
    if format_ is not None:
        return format_
    unread, photos = find_unread(source), find_photos(source)
    if unread:
        raise SceneError(f'{source}: no poses that can be read, but files that look like some: '
                         f'{unread}. To compute others instead: --format photos')
    if photos:
        return CaptureFormat.PHOTOS
    if not any(source.iterdir()):
        raise SceneError(f'{source}: the folder is empty')
    below = _captures_below(source)
    if below:
        raise SceneError(f'{source}: no capture here, but below; expected one of these as '
                         f'SOURCE: {listed(below)}')
    raise SceneError(
        f'{source}: no capture found; looked for transforms_train.json, transforms.json, a COLMAP '
        'model (cameras.bin or .txt), color/ with pose/ (ScanNet), frame-*.color.png '
        '(7-Scenes), groundtruth.txt (TUM RGB-D), mav0/ (EuRoC), metadata.json (Record3D), '
        'keyframes/ (Polycam), traj.txt, a bag (.mcap, .db3) and photos ('
        f'{", ".join(PHOTO_SUFFIXES)})')


def _captures_below(source: Path) -> list[str]:
    """Name what one may have meant: folders with poses, else photos, videos and .r3d files."""
    folders = list(islice(_folders_below(source), SEARCHED))
    posed = [f'{folder} ({format_.value})' for folder in folders
             if (format_ := _recognised(folder))]
    return posed or [words for folder in (source, *folders) for words in _without_poses(folder)]


def _without_poses(folder: Path) -> Iterator[str]:
    """Name a folder with photos, and the videos and .r3d files in it."""
    if list_photos(folder):
        yield f'{folder} ({CaptureFormat.PHOTOS.value})'
    for path in sorted(folder.iterdir()):
        suffix = path.suffix.lower()
        if path.is_file() and not path.name.startswith('.') and suffix in (
                *VIDEO_SUFFIXES, RECORD3D_SUFFIX):
            format_ = (CaptureFormat.RECORD3D if suffix == RECORD3D_SUFFIX
                       else CaptureFormat.VIDEO)
            yield f'{path} ({format_.value})'


def _folders_below(source: Path) -> Iterator[Path]:
    """Yield the folders that one may have meant: an archive often holds one more."""
    for depth in range(1, 4):
        yield from (path for path in sorted(source.glob('/'.join('*' * depth))) if path.is_dir()
                    and not any(part.startswith('.') for part in path.relative_to(source).parts))


def _recognised(source: Path) -> CaptureFormat | None:
    """Return the format that the files of a folder tell, but for photos without poses."""
    return next((format_ for found, format_ in (
            ((source / 'transforms_train.json').is_file(), CaptureFormat.SCENE),
            ((source / TRANSFORMS_FILE).is_file(), CaptureFormat.TRANSFORMS),
            (find_model(source) is not None, CaptureFormat.COLMAP),
            (is_scannet(source), CaptureFormat.SCANNET),
            (is_seven_scenes(source), CaptureFormat.SEVEN_SCENES),
            (is_tum(source), CaptureFormat.TUM),
            (find_euroc(source) is not None, CaptureFormat.EUROC),
            (find_record3d(source) is not None, CaptureFormat.RECORD3D),
            (find_keyframes(source) is not None, CaptureFormat.POLYCAM),
            ((source / TRAJECTORY_FILE).is_file(), CaptureFormat.TRAJECTORY),
            (bool(find_storage_files(source)), CaptureFormat.BAG)) if found), None)
