"""
A scene that somebody has already, as a mesh or as splats, in the place of a fitted field.

Whether it lies in the world of the photos, and at its scale, is told by their colours: what it
shows at their poses has to look like them.
"""
from collections.abc import Iterator
from dataclasses import dataclass
import hashlib
from itertools import permutations, product
from pathlib import Path
import re

from neo_ros.errors import ConfigError, SceneError
from neo_ros.field.config import FieldConfig, FIT_NEAR
from neo_ros.field.mesh_field import MeshField
from neo_ros.field.mesh_file import ColouredMesh, ENDINGS, read_mesh
from neo_ros.field.rendering import render_rays, world_rays
from neo_ros.field.splat_field import splat_field
from neo_ros.field.splat_file import is_splat_file, read_splats, Splats
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.evenly import evenly
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

Geometry = ColouredMesh | Splats
AS_IT_IS = 'x,y,z'
_AXIS = re.compile(r'([+-]?[0-9.]*(?:e[+-]?[0-9]+)?)\*?([xyz])')


@dataclass(frozen=True)
class GivenGeometry:
    """A file, and what x, y and z of the photos' world are in its axes: '0.01x,-0.01z,0.01y'."""

    path: Path
    axes: str = AS_IT_IS

    @property
    def digest(self) -> str:
        """Twelve hex digits that change with the file and its axes."""
        try:
            with self.path.open('rb') as file:
                digest = hashlib.file_digest(file, 'sha256')
        except OSError as error:
            raise SceneError(f'{self.path}: cannot read: {error.strerror}') from error
        if self.axes != AS_IT_IS:
            digest.update(self.axes.encode())
        return digest.hexdigest()[:12]

    @property
    def turn(self) -> np.ndarray:
        """The matrix (3, 3), a rotation times a scale, from the file's points to the world's."""
        rows = [_AXIS.fullmatch(part.strip()) for part in self.axes.split(',')]
        turn = np.zeros((3, 3))
        try:
            for row, found in zip(turn, rows, strict=False):
                factor = found.group(1)  # type: ignore[union-attr]
                row['xyz'.index(found.group(2))] = float(  # type: ignore[union-attr]
                    factor + '1' if factor in ('', '+', '-') else factor)
            scale = np.cbrt(np.linalg.det(turn)) if len(rows) == 3 else 0.0
            if scale > 0 and np.allclose(np.abs(turn).sum(0), scale):
                return turn
        except (AttributeError, ValueError):
            pass
        raise ConfigError(
            '--geometry-axes: expected what x, y and z of the world of the photos are in the axes '
            'of the file, each once, all as long, and no mirror image, such as x,-z,y or '
            f'0.01x,0.01y,0.01z; got {self.axes!r}')


@dataclass(frozen=True)
class FitRules:
    """When geometry belongs to photos; measured on rendered rooms."""

    photos: int = 16          # that are looked at, evenly chosen
    few_photos: int = 4       # where a place is looked for
    pixels_across: int = 24   # of each
    marked_across: int = 96   # pixels of every photo, to tell from which side
    least_likeness: float = 0.5
    better: float = 0.1       # likeness by which another place in the world must not be better
    scales: tuple[float, ...] = (1.0, 0.001, 0.01, 0.1, 10.0, 100.0, 1000.0, 0.0254, 0.3048)


def field_of_geometry(given: GivenGeometry, world: np.ndarray, photos: PosedImages,
                      config: FieldConfig, rules: FitRules = FitRules()
                      ) -> VoxelField | MeshField:
    """
    Return what takes the place of a field that is fitted to the photos.

    world (3, 3): what turned the photos' world since they were imported. Raises NeoError for
    files that are no mesh with colours and no splats, and for geometry that does not show what
    the photos show; the message says which axes would.
    """
    turn = given.turn
    geometry = _read(given.path)
    _check_place(given, geometry, world, photos, rules)
    geometry = geometry.transformed(world @ turn)
    near = FIT_NEAR if config.near is None else config.near
    if isinstance(geometry, Splats):
        # All of it counts as seen: it is made of what photos saw.
        return splat_field(geometry, *_inner_box(geometry, photos, config.margin), config.shell,
                           near)
    field = MeshField(geometry, near)
    scale = min(1.0, rules.marked_across / photos.intrinsics.width)
    field.mark_seen(_rays(photos, scale))
    return field


def _read(path: Path) -> Geometry:
    if path.suffix.lower() not in ENDINGS:
        raise SceneError(f'{path}: expected a mesh ({", ".join(ENDINGS)}) or splats (.ply); '
                         'save it as one of them')
    return read_splats(path) if is_splat_file(path) else read_mesh(path)


def _rays(photos: PosedImages, scale: float) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the rays of each photo's pixels that show the scene."""
    camera = photos.intrinsics.scaled(scale)
    for index, pose in enumerate(photos.poses):
        origin, directions = world_rays(camera, pose)
        usable = photos.read_usable(index, scale)
        directions = directions.reshape(-1, 3) if usable is None else directions[usable]
        yield np.broadcast_to(origin, directions.shape).copy(), directions


def _inner_box(splats: Splats, photos: PosedImages, margin: float
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return centre and half extent (3,) of what lies around the cameras, as a fit has them."""
    positions = photos.T_world_cam[:, :3, 3]
    low, high = positions.min(0), positions.max(0)
    near = ((splats.centres > low - margin) & (splats.centres < high + margin)).all(-1)
    if near.any():
        low = np.minimum(low, np.percentile(splats.centres[near], 2, axis=0))
        high = np.maximum(high, np.percentile(splats.centres[near], 98, axis=0))
    return (low + high) / 2, (high - low) / 2 + 0.04 * (high - low).max()


def _check_place(given: GivenGeometry, geometry: Geometry, world: np.ndarray,
                 photos: PosedImages, rules: FitRules) -> None:
    """Raise SceneError where another place in the world fits better, or none fits well."""
    trial: VoxelField | MeshField
    if isinstance(geometry, ColouredMesh):
        trial = MeshField(geometry, 0.0)
    else:
        low, high = np.percentile(geometry.centres, (2, 98), axis=0)
        trial = splat_field(geometry, (low + high) / 2, np.maximum((high - low) / 2, 1e-3),
                            FieldConfig.shell, 0.0, 1_000_000)

    def likeness(axes: str, count: int) -> float:
        turn = world @ GivenGeometry(given.path, axes).turn
        return float(np.median([_likeness(trial, photos, index, turn, rules)
                                for index in evenly(len(photos), count)]))

    best = max((axes for axes in _other_axes(rules) if axes != given.axes),
               key=lambda axes: likeness(axes, rules.few_photos))
    found, other = likeness(given.axes, rules.photos), likeness(best, rules.photos)
    least = max(rules.least_likeness, other - rules.better)
    if found >= least:
        return
    fits = other >= rules.least_likeness
    advice = (f'with --geometry-axes={best} it is {other:.2f}' if fits else
              'no axes and no unit make it more like them: was it made of the same capture, and '
              'in its world? Import the capture with the poses that the geometry was made with')
    raise SceneError(f'{given.path}: expected what the photos show at their poses, but the '
                     f'likeness is {found:.2f} (1 = alike; at least {least:.2f}); {advice}')


def _other_axes(rules: FitRules) -> Iterator[str]:
    """Yield the 24 ways to turn axes into one another, at each scale."""
    for scale in rules.scales:
        unit = '' if scale == 1 else f'{scale:g}'
        for order in permutations(range(3)):
            for signs in product((1, -1), repeat=3):
                if np.linalg.det(np.eye(3)[list(order)] * np.array(signs)[:, None]) > 0:
                    yield ','.join(f'{"-" if sign < 0 else ""}{unit}{"xyz"[axis]}'
                                   for axis, sign in zip(order, signs))


def _likeness(field: VoxelField | MeshField, photos: PosedImages, index: int, turn: np.ndarray,
              rules: FitRules) -> float:
    """
    Return how a photo and what is shown at its pose correlate, less where little is shown.

    The geometry stays where it is, and the camera moves by the inverse of `turn`.
    """
    camera = photos.intrinsics.scaled(min(1.0, rules.pixels_across / photos.intrinsics.width))
    _, directions = world_rays(camera, photos.poses[index])
    size, back = np.cbrt(np.linalg.det(turn)), np.linalg.inv(turn)
    shown = render_rays(field, (back @ photos.poses[index].position).astype(np.float32),
                        (directions @ back.T * size).astype(np.float32))
    photo, usable = photos.read_shown(index, camera.width / photos.intrinsics.width)
    hit = (shown.opacity > 0.5) & usable
    if hit.sum() < 10:
        return 0.0
    a, b = shown.image[hit], photo[hit] / 255
    a, b = a - a.mean(0), b - b.mean(0)
    spread = np.sqrt((a ** 2).sum() * (b ** 2).sum())
    return float((a * b).sum() / max(spread, 1e-9) * min(1, 2 * hit.sum() / usable.sum()))
