"""
The paper's two protocols on any scene, and splits that are frozen by checksum.

square      3-DoF: photos of 90 degrees are the camera's view, grown to twice their size (4.1)
horizontal  hand-held: the middle half of a photo's columns, grown to the photo (ScanNet, 4.1)
"""
from dataclasses import replace
import json
from pathlib import Path

from neo_ros.errors import ConfigError, SceneError
from neo_ros.evaluation.evaluate import protocol_of
from neo_ros.experiment import Experiment, ViewConfig
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.machine.files import write_bytes
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.outpaint.networks import check_network, shrunk_expansion
from neo_ros.scenes.digests import files_digest, list_digest
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
import numpy as np

PROTOCOLS = ('square', 'horizontal')
OWN_SPLIT = 'split.json'  # of a scene folder: the split that it was first scored on
# Relative to the scene's photos.
SCALES = {'full': 1.0, 'half': 0.5, 'quarter': 0.25, 'eighth': 0.125}
# (patch, depth) of the network's grid, best first; sizes must be multiples of the coarsest cell.
_GRIDS = ((16, 2), (8, 2), (8, 1), (4, 2), (2, 2), (4, 1), (2, 1), (1, 1))
_LEAST_CELL = 4  # pixels
_LARGE = 256  # from this width of the wide view on, cells of 16 pixels are fine enough


def choose_view(scene: Scene, protocol: str, scale: float) -> ViewConfig | None:
    """
    Return source and target of a protocol, in pixels at the photos' resolution.

    None: as the scene's test frames state. Where sizes do not divide into cells, a few pixels at
    the photos' rim are left out. Raises ConfigError for a protocol that the photos are too small
    for.
    """
    if protocol not in PROTOCOLS:
        raise ConfigError(f'protocol: expected {" or ".join(PROTOCOLS)}, got {protocol!r}')
    photo = scene.train.intrinsics
    stated = scene.expansion
    if stated is not None and protocol_of(stated) == protocol and all(
            size % (_LEAST_CELL / scale) == 0 for size in (
                stated.source.width, stated.source.height, stated.left, stated.right, stated.top,
                stated.bottom)):
        return None
    if protocol == 'horizontal':
        # Half the width, a quarter at each side, and two levels of cells.
        width, height = _floor(photo.width, 16 / scale), _floor(photo.height, 4 / scale)
        view = ViewConfig((width // 2, height), (width, height))
    else:
        side = _floor(min(photo.width, photo.height), 8 / scale)
        view = ViewConfig((side, side), (2 * side, 2 * side))
    if min(view.source) < 1:
        raise ConfigError(f'scale: photos of {photo.width}x{photo.height} pixels are too small '
                          f'for the {protocol} protocol at {scale}; choose a larger scale')
    return view


def scale_within(photo: Intrinsics, longest: int) -> str:
    """Return the largest scale that leaves a photo's longer side at most so many pixels."""
    side = max(photo.width, photo.height)
    return next((name for name, scale in SCALES.items() if side * scale <= longest),
                list(SCALES)[-1])


def split_walks(test: PosedImages) -> PosedImages:
    """
    Give the runs of a capture that knows no walks a path id each: they end where it jumps.

    A jump is a step (metres and radians added) of more than ten times the median.
    """
    if len(set(test.path_ids)) > 1 or len(test) < 3:
        return test
    T_world_cam = test.T_world_cam
    moved = np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1)
    cosine = (np.einsum('nij,nij->n', T_world_cam[1:, :3, :3], T_world_cam[:-1, :3, :3]) - 1) / 2
    step = moved + np.arccos(np.clip(cosine, -1, 1))
    jumps = step > 10 * max(float(np.median(step)), 1e-3)
    return replace(test, path_ids=(0, *np.cumsum(jumps).tolist()))


def fitting_network(experiment: Experiment, expansion: ViewExpansion) -> NetworkConfig:
    """Return the experiment's network with the best grid that the image sizes allow."""
    for patch, depth in _GRIDS:
        if patch == 16 and expansion.target.width < _LARGE:
            continue
        # The coarsest cells, which the middle sees, have as many channels in every grid.
        coarse = experiment.network.width * 2 ** experiment.network.depth
        network = replace(experiment.network, patch=patch, depth=depth, width=coarse // 2 ** depth)
        try:
            check_network(shrunk_expansion(expansion, network), network)
        except ConfigError as error:
            refused = error
            continue
        return network
    raise refused  # Cells of one pixel fit every size: it is another setting.


def split_checksums(photos: PosedImages, test: PosedImages,
                    stated: ViewExpansion | None) -> dict[str, str]:
    """
    Return a checksum (sha256) of the training list, of the test list and of all image files.

    Lists count by content: names, poses to a micrometre, camera, path ids, and the source
    window; so a scene may be written again by `neo import` and stays the same split.
    """
    return {'train': list_digest(photos), 'test': list_digest(test, stated),
            'images': files_digest((*photos.image_paths, *test.image_paths))}


def check_split(scene_name: str, found: dict[str, str], frozen_file: Path) -> None:
    """
    Compare a split with the frozen one of its scene.

    `images` may be missing from the frozen one: the demo flat is rendered anew on every machine.
    Raises SceneError for a scene that is not frozen, and for one that differs.
    """
    frozen = json.loads(frozen_file.read_text())
    if scene_name not in frozen:
        raise SceneError(f'{scene_name}: expected one of the frozen scenes '
                         f'{", ".join(sorted(frozen))} of {frozen_file.name}')
    _compare(scene_name, found, frozen[scene_name], frozen_file)


def check_own_split(scene: Path, found: dict[str, str], frozen_file: Path) -> None:
    """
    Compare a split with that of the scene folder's own note, split.json, or freeze it there.

    A folder without a note may hold one of the shipped splits (frozen_file), and needs none.
    Raises SceneError for a split that differs from the note, NeoError where none can be written.
    """
    note = scene / OWN_SPLIT
    if note.is_file():
        _compare(scene.name, found, json.loads(note.read_text()), note)
    elif json.loads(frozen_file.read_text()).get(scene.name) != found:
        write_bytes(note, (json.dumps(found, indent=1) + '\n').encode())


def _compare(scene_name: str, found: dict[str, str], frozen: dict[str, str],
             frozen_file: Path) -> None:
    wrong = [part for part, digest in frozen.items() if found.get(part) != digest]
    if wrong:
        words = {'train': 'the training photos or their poses',
                 'test': 'the test frames, their poses or the input window',
                 'images': 'the pixels of the images'}
        raise SceneError(
            f'{scene_name}: {" and ".join(words[part] for part in wrong)} are not those of the '
            f'frozen split ({frozen_file.name}); scores on another split cannot be compared: '
            'bring the original scene folder, or benchmark this one with --scene')


def _floor(size: float, unit: float) -> int:
    """Round down to a multiple of `unit`; scales are powers of two, so units are whole."""
    return int(size // unit * unit)
