"""What looks like poses of photos and is not read: it is named before poses are computed anew."""
from collections.abc import Callable, Iterator
import json
from pathlib import Path

from neo_ros.machine.names import listed

_NERFSTUDIO = 'export it to COLMAP, or to a transforms.json with ns-process-data'
# So much of a file tells what it is.
_HEAD_BYTES = 4096


def find_unread(source: Path) -> str:
    """
    Name the files in a folder that look like poses no reader takes, and what helps.

    Empty where there are none.
    """
    found = []
    for what, find, advice in _KINDS:
        files = sorted(path.relative_to(source).as_posix() for path in find(source))
        if files:
            found.append(f'{what} ({listed(files, 3)}): {advice}')
    return '; '.join(found)


def _named(*patterns: str) -> Callable[[Path], Iterator[Path]]:
    return lambda source: (path for pattern in patterns for path in source.glob(pattern)
                           if path.is_file())


def _holding(*words: str, suffix: str) -> Callable[[Path], Iterator[Path]]:
    """Find files with an ending whose beginning holds one of the words, in small letters."""
    def find(source: Path) -> Iterator[Path]:
        for path in source.glob(f'*{suffix}'):
            head = _head(path)
            if any(word in head for word in words):
                yield path

    return find


def _head(path: Path) -> str:
    try:
        with path.open('rb') as file:
            return file.read(_HEAD_BYTES).decode('utf-8', 'ignore').lower()
    except OSError:
        return ''


def _json_with_poses(source: Path) -> Iterator[Path]:
    for path in source.glob('*.json'):
        try:
            content = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        first = content[0] if isinstance(content, list) and content else content
        keys = {str(key).lower() for key in first} if isinstance(first, dict) else set()
        if keys & {'poses', 'pose', 'extrinsics', 'transform_matrix', 'frames', 'camera_to_world',
                   'c2w', 'rotation', 'shots', 'views'}:
            yield path


_KINDS: tuple[tuple[str, Callable[[Path], Iterator[Path]], str], ...] = (
    ('Metashape cameras', _holding('<document', '<chunk', suffix='.xml'),
     f'{_NERFSTUDIO} metashape'),
    ('RealityCapture cameras', _holding('heading,pitch,roll', '#name,x,y', suffix='.csv'),
     f'{_NERFSTUDIO} realitycapture'),
    ('RealityCapture cameras', _holding('xcr:', suffix='.xmp'), f'{_NERFSTUDIO} realitycapture'),
    ('Polycam', _named('mesh_info.json', '*cameras*/*.json'),
     'expected keyframes/images and keyframes/cameras: export raw data, in its developer mode'),
    ('TUM RGB-D', _named('groundtruth.txt', 'rgb.txt'),
     'expected groundtruth.txt, rgb.txt and the folder rgb/'),
    ('LLFF poses', _named('poses_bounds.npy'), 'the COLMAP model it was made of is read'),
    ('Bundler or VisualSFM cameras', _named('*.nvm', 'bundle.out', 'bundle/bundle.out'),
     'colmap model_converter reads them'),
    ('Stray Scanner', _named('odometry.csv'), f'{_NERFSTUDIO}'),
    ('poses', _json_with_poses, 'write them as transforms.json, as nerfstudio has it'),
    ('poses', _named('poses.txt', 'trajectory.txt', 'traj*.txt', '*poses*.csv', '*.tum',
                     'pose/*.txt', 'poses/*.txt', 'cam/*.cam'),
     'write them as traj.txt, 16 numbers a line, or as TUM RGB-D'),
)
