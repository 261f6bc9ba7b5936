"""A scene folder: training photos, and where there are any, wide test truth and a floor map."""
from dataclasses import dataclass, field
from itertools import count, takewhile
import logging
from pathlib import Path

from neo_ros.errors import SceneError
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.names import listed
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.transforms_json import read_input_crop, read_transforms
from neo_ros.scenes.walkable import read_walkable, WalkableMap
import numpy as np

logger = logging.getLogger(__name__)
# What a scene of the demo flat was rendered with; no other scene has this file.
DEMO_NOTE = 'demo_scene.json'
_STALE = 'out_of_date'


@dataclass(frozen=True)
class Scene:
    """
    What `read_scene` finds in a folder.

    train      photos the field is fitted to (`transforms_train.json` or `transforms.json`)
    test       wide truth along walking paths (`transforms_test.json`), for the last scoring only
    expansion  source window of the test frames (`input_crop`), at the test frames' resolution
    walkable   where the robot can be (`walkable.json`), for 3-DoF scenes
    upper      the same of other storeys: `walkable_1.json` and so on
    turn       rotation (3, 3) of its world since it was read, see `upright.stood_up`
    """

    name: str
    train: PosedImages
    test: PosedImages | None
    expansion: ViewExpansion | None
    walkable: WalkableMap | None
    turn: np.ndarray = field(default_factory=lambda: np.eye(3), compare=False)
    upper: tuple[WalkableMap, ...] = ()


def read_scene(folder: Path) -> Scene:
    """Read a scene folder; raises SceneError that says which file is missing or wrong."""
    folder = Path(folder)
    if not folder.is_dir():
        raise SceneError(f'{folder}: expected a scene folder, there is none')
    candidates = [folder / 'transforms_train.json', folder / 'transforms.json']
    train_file = next((path for path in candidates if path.is_file()), None)
    if train_file is None:
        raise SceneError(f'{folder}: expected transforms_train.json or transforms.json; '
                         'make one with: neo import SOURCE SCENE')
    test_file = folder / 'transforms_test.json'
    has_test = test_file.is_file()
    walkable_file = floor_file(folder, 0)
    train = read_transforms(train_file)
    test = read_transforms(test_file) if has_test else None
    if test is not None:
        shared = sorted(set(train.image_paths) & set(test.image_paths))
        if shared:
            raise SceneError(
                f'{test_file}: expected test frames that are not trained on, got {len(shared)} '
                f'that {train_file.name} has, too ({listed([path.name for path in shared])}); '
                'import the capture again')
    return Scene(
        name=folder.resolve().name, train=train, test=test,
        expansion=read_input_crop(test_file) if has_test else None,
        walkable=read_walkable(walkable_file) if walkable_file.is_file() else None,
        upper=tuple(map(read_walkable, upper_floors(folder))))


def upper_floors(folder: Path) -> list[Path]:
    """Return the floor maps of a scene folder's other storeys, as far as they count on."""
    if not floor_file(folder, 0).is_file():
        return []
    return list(takewhile(Path.is_file, (floor_file(folder, storey) for storey in count(1))))


def floor_file(folder: Path, storey: int) -> Path:
    """Return where the floor map of a storey lies, 0: the first one."""
    return folder / ('walkable.json' if storey == 0 else f'walkable_{storey}.json')


def stale_file(photo: Path) -> Path:
    """
    Return where it lies what an update found out of date in a photo, if it found something.

    Beside the masks, which are black there: white where only an update has left pixels out.
    """
    return photo.parent.parent / _STALE / f'{photo.stem}.png'


def clear_earlier_import(folder: Path, has_floor: bool = False) -> None:
    """
    Take what an earlier import left away, before another training list is written.

    Test frames are deleted, as the new list may hold the same photos, the note of a demo scene,
    and what an update found out of date. Floor maps, unless the new import has some, are set
    aside: they belong to the world of the earlier one. The log says so. Raises SceneError where
    the folder cannot be changed.
    """
    test_file, floor = folder / 'transforms_test.json', floor_file(folder, 0)
    demo = folder / DEMO_NOTE
    try:
        if demo.exists():
            demo.unlink()
        for stale in (folder / _STALE).glob('*.png'):
            stale.unlink()
        if test_file.exists():
            test_file.unlink()
            logger.warning('%s of an earlier import is deleted', test_file)
        for upper in upper_floors(folder):
            upper.unlink() if has_floor else upper.replace(upper.with_suffix('.old.json'))
        if floor.exists() and not has_floor:
            floor.replace(folder / 'walkable.old.json')
            logger.warning('%s of an earlier import is set aside as walkable.old.json; if the '
                           'world is still the same, rename it back, else run neo floor', floor)
    except OSError as error:
        raise SceneError(f'{folder}: cannot remove what an earlier import left: '
                         f'{error.strerror}; choose another scene folder') from error
