"""A mesh or splats in the place of a fitted field: what is shown, and whether it belongs there."""
from dataclasses import replace
from pathlib import Path

from box_room import cast, HEIGHT, HIGH, planar, view
import cv2
from neo_ros.benchmark.small_room import LOW
from neo_ros.errors import ConfigError, SceneError
from neo_ros.field.config import FieldConfig
from neo_ros.field.device import read_field
from neo_ros.field.given_geometry import field_of_geometry, GivenGeometry
from neo_ros.field.rendering import render_rays, render_view, world_rays
from neo_ros.field.splat_file import basis, read_splats, Splats
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
from neo_ros.machine.progress import no_stage_progress
from neo_ros.pictures.usable import write_usable
from neo_ros.pipeline import fit_field_step
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.training.folder import claim
from neo_ros.training.run import TrainingRun
import numpy as np
import pytest
from tiny_training import TINY

CAMERA = Intrinsics.from_hfov(64, 48, 1.4)
POSES = [planar(x, y, yaw) for x, y in ((1.5, 1.5), (3.2, 2.4)) for yaw in range(0, 360, 45)]
UPRIGHT = np.eye(3)


@pytest.fixture(scope='module')
def photos(tmp_path_factory: pytest.TempPathFactory) -> PosedImages:
    """Photograph the box room."""
    folder = tmp_path_factory.mktemp('photos')
    paths = tuple(folder / f'{index}.png' for index in range(len(POSES)))
    for path, pose in zip(paths, POSES):
        cv2.imwrite(str(path), view(pose, CAMERA)[0][..., ::-1])
    return PosedImages(CAMERA, paths, tuple(POSES), tuple(range(len(POSES))), z_up=True)


def surface(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (6, n, n, 3) of the walls, their colours in 0 ... 1, and what is inward."""
    u, v = np.meshgrid(*[np.linspace(1e-4, 1 - 1e-4, across)] * 2, indexing='ij')
    points, inward = np.empty((6, across, across, 3)), np.zeros((6, 3))
    for side in range(6):
        axis, high = side // 2, side % 2
        points[side, ..., axis] = high
        points[side, ..., (axis + 1) % 3], points[side, ..., (axis + 2) % 3] = u, v
        inward[side, axis] = 1 - 2 * high
    points = LOW + points * (HIGH - LOW)
    middle = (LOW + HIGH) / 2
    rays = points - middle
    colours, _ = cast(middle, rays / np.linalg.norm(rays, axis=-1, keepdims=True))
    return points, colours / 255, inward


def write_splats(path: Path, turn: np.ndarray = UPRIGHT, across: int = 60, drop: str = '') -> Path:
    """Cover the walls with flat splats; each point x lies at turn (3, 3) @ x."""
    points, colours, inward = surface(across)
    size = np.cbrt(np.linalg.det(turn))
    names = [name for name in (
        'x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3'
    ).split() if name != drop]
    data = np.zeros(colours[..., 0].size, [(name, '<f4') for name in names])
    for name, values in zip('xyz', (points.reshape(-1, 3) @ turn.T).T):
        data[name] = values
    for channel in range(3):
        data[f'f_dc_{channel}'] = (colours[..., channel].ravel() - 0.5) / 0.28209479
    data['opacity'], data['rot_0'] = 3, 1
    thin = np.abs(inward @ np.linalg.inv(turn / size)).repeat(across ** 2, 0) > 0.5
    for axis in range(3):
        if f'scale_{axis}' in names:
            data[f'scale_{axis}'] = np.log(size * np.where(thin[:, axis], 0.002, 0.05))
    header = ''.join(f'property float {name}\n' for name in names)
    path.write_bytes(b'ply\nformat binary_little_endian 1.0\ncomment made by a test\n'
                     + f'element vertex {len(data)}\n{header}end_header\n'.encode()
                     + data.tobytes())
    return path


def write_mesh(path: Path, across: int = 40, textured: bool = False) -> Path:
    """Write the walls as triangles, coloured at their vertices or by six pictures."""
    trimesh = pytest.importorskip('trimesh', reason='the extra `mesh` is not installed')
    points, colours, _ = surface(2 if textured else across)
    pictures = surface(96)[1]
    n = points.shape[1]
    corner = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (
        corner[:-1, :-1], corner[1:, :-1], corner[:-1, 1:], corner[1:, 1:]))
    rising = np.concatenate([np.stack([a, b, c], -1), np.stack([d, c, b], -1)])
    parts = []
    for side in range(6):
        faces = rising[:, ::1 if side % 2 == 0 else -1]  # Their fronts are inside the room.
        mesh = trimesh.Trimesh(points[side].reshape(-1, 3), faces, process=False)
        if textured:
            from PIL import Image
            # v counts up from the last row.
            picture = (pictures[side].swapaxes(0, 1)[::-1] * 255).astype(np.uint8)
            mesh.visual = trimesh.visual.TextureVisuals(
                np.array([[0, 0], [0, 1], [1, 0], [1, 1]]), material=(
                    trimesh.visual.material.PBRMaterial(
                        baseColorTexture=Image.fromarray(picture))))
        else:
            mesh.visual.vertex_colors = (colours[side].reshape(-1, 3) * 255).astype(np.uint8)
        parts.append(mesh)
    whole = trimesh.Scene(parts) if textured else trimesh.util.concatenate(parts)
    whole.export(path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize('kind, psnr, centimetres', [
    ('splats.ply', 26, 4.0), ('mesh.ply', 30, 0.1), ('mesh.obj', 30, 0.1), ('mesh.glb', 30, 0.1),
])
def test_geometry_shows_the_room(photos: PosedImages, tmp_path: Path, kind: str, psnr: float,
                                 centimetres: float) -> None:
    path = tmp_path / kind
    file = (write_splats(path) if 'splats' in kind
            else write_mesh(path, textured=path.suffix == '.glb'))
    made = field_of_geometry(GivenGeometry(file), UPRIGHT, photos, FieldConfig())
    made.save(tmp_path / 'field.npz')
    field = read_field(tmp_path / 'field.npz', 'cpu')
    assert type(field) is type(made) and field.near == 0.1
    pose = planar(2.4, 1.9, 70)
    shown = render_view(field, CAMERA, pose)
    truth, z = view(pose, CAMERA)
    error = ((shown.image - truth / 255) ** 2).mean()
    assert -10 * np.log10(error) > psnr
    stretch = np.linalg.norm(CAMERA.pixel_rays(), axis=-1)
    off = np.abs(render_rays(field, *world_rays(CAMERA, pose)).depth - z * stretch)
    assert 100 * np.median(off) < centimetres
    assert shown.opacity.mean() > 0.98 and shown.coverage.mean() > 0.95
    assert field.is_matter(np.array([[HIGH[0], 2, 1], [2.5, 2, 1.3]])).tolist() == [True, False]


def test_the_back_of_a_wall_was_seen_by_no_photo(photos: PosedImages, tmp_path: Path) -> None:
    field = field_of_geometry(GivenGeometry(write_mesh(tmp_path / 'mesh.ply')), UPRIGHT, photos,
                              FieldConfig())
    outside = planar(float(HIGH[0]) + 2, 2, 180)
    shown = render_rays(field, *world_rays(CAMERA, outside))
    hit = shown.opacity > 0
    assert hit.mean() > 0.3 and shown.coverage[hit].mean() < 0.2


@pytest.mark.slow
@pytest.mark.parametrize('turn, axes', [
    (np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0.0]]), 'x,-z,y'),
    (100 * UPRIGHT, '0.01x,0.01y,0.01z'),
], ids=['y is up', 'centimetres'])
def test_geometry_elsewhere_is_refused_and_told_what_fits(
        photos: PosedImages, tmp_path: Path, turn: np.ndarray, axes: str) -> None:
    file = write_splats(tmp_path / 'splats.ply', turn)
    with pytest.raises(SceneError, match=f'likeness is .*with --geometry-axes={axes} it is 0.9'):
        field_of_geometry(GivenGeometry(file), UPRIGHT, photos, FieldConfig())
    given = GivenGeometry(file, axes)
    field = field_of_geometry(given, UPRIGHT, photos, FieldConfig())
    down = render_rays(field, np.array([2, 2, HEIGHT], np.float32), np.array([[0, 0, -1.0]]))
    assert abs(down.depth[0] - HEIGHT) < 0.05
    assert given.digest != GivenGeometry(file).digest


@pytest.mark.slow
def test_geometry_of_another_place_fits_nowhere(photos: PosedImages, tmp_path: Path) -> None:
    points, *_ = surface(60)
    file = write_splats(tmp_path / 'splats.ply')
    data = bytearray(file.read_bytes())
    begins = len(data) - 4 * 14 * points[..., 0].size
    found = np.frombuffer(data, '<f4', offset=begins).reshape(-1, 14)
    found[:, 3:6] = np.random.default_rng(0).permutation(found[:, 3:6])
    file.write_bytes(data)
    with pytest.raises(SceneError, match='no axes and no unit make it more like them'):
        field_of_geometry(GivenGeometry(file), UPRIGHT, photos, FieldConfig())


def test_colours_turn_with_their_splats() -> None:
    random = np.random.default_rng(1)
    splats = Splats(np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.full(2, 0.5),
                    random.normal(size=(2, 3, 9)).astype(np.float32))
    turn = np.array([[0, -3, 0], [3, 0, 0], [0, 0, 3.0]])
    d = random.normal(size=(20, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    turned = splats.transformed(turn).harmonics @ basis(d @ turn.T / 3, 9).T
    np.testing.assert_allclose(turned, splats.harmonics @ basis(d, 9).T, atol=1e-5)


@pytest.mark.parametrize('drop, cut, message', [
    ('rot_3', 0, 'without compression; it has no rot_3'),
    ('', 100, 'expected 21600 splats, got 21598; is the file truncated'),
])
def test_broken_splats_are_refused(tmp_path: Path, drop: str, cut: int, message: str) -> None:
    file = write_splats(tmp_path / 'splats.ply', drop=drop)
    file.write_bytes(file.read_bytes()[:len(file.read_bytes()) - cut])
    with pytest.raises(SceneError, match=message):
        read_splats(file)


def test_surfels_have_no_third_axis(tmp_path: Path) -> None:
    splats = read_splats(write_splats(tmp_path / 'surfels.ply', drop='scale_2'))
    assert np.linalg.norm(splats.axes[..., 2], axis=-1).max() < 1e-5


def test_files_that_show_nothing_are_refused(photos: PosedImages, tmp_path: Path) -> None:
    pytest.importorskip('trimesh', reason='the extra `mesh` is not installed')
    (tmp_path / 'grey.obj').write_text('v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n')
    (tmp_path / 'points.ply').write_text(
        'ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n'
        'property float z\nend_header\n0 0 0\n')
    (tmp_path / 'room.splat').write_bytes(b'')
    for name, message in (('grey.obj', 'a texture or colours'), ('points.ply', 'with faces'),
                          ('room.splat', 'save it as one'), ('none.ply', 'cannot read')):
        with pytest.raises(SceneError, match=message):
            field_of_geometry(GivenGeometry(tmp_path / name), UPRIGHT, photos, FieldConfig())


@pytest.mark.slow
@pytest.mark.parametrize('wanted, near', [(None, 0.1), (0.3, 0.3), (0.02, 0.02)])
def test_views_of_it_begin_where_the_settings_say(
        photos: PosedImages, tmp_path: Path, wanted: float | None, near: float) -> None:
    given = GivenGeometry(write_splats(tmp_path / 'splats.ply'))
    field = field_of_geometry(given, UPRIGHT, photos, FieldConfig(near=wanted))
    assert field.near == pytest.approx(near)


@pytest.mark.slow
def test_what_masks_leave_out_saw_nothing(photos: PosedImages, tmp_path: Path) -> None:
    file = write_mesh(tmp_path / 'room.ply')
    camera = photos.intrinsics
    usable = np.zeros((camera.height, camera.width), bool)
    usable[:, :camera.width // 2] = True
    write_usable(tmp_path / 'mask.png', usable)
    one = photos.subset([0])
    masked = replace(one, mask_paths=(tmp_path / 'mask.png',))
    seen = [field_of_geometry(GivenGeometry(file), UPRIGHT, some, FieldConfig()).seen.sum()
            for some in (one, masked)]
    assert 0 < seen[1] < 0.8 * seen[0]


@pytest.mark.slow
def test_a_run_takes_its_field_from_the_file(photos: PosedImages, tmp_path: Path) -> None:
    scene = Scene('room', photos, None, None, None, turn=UPRIGHT)
    given = GivenGeometry(write_splats(tmp_path / 'splats.ply'))
    run = TrainingRun(scene, TINY, tmp_path / 'out', no_stage_progress, geometry=given)
    run.out.mkdir()
    claim(run.out, scene, TINY, given)
    with pytest.raises(ConfigError, match='choose another folder'):
        claim(run.out, scene, TINY)  # Its field would be fitted.
    field = fit_field_step(run)
    assert isinstance(field, VoxelField) and field.grid.shape[1] == 4
    claim(run.out, scene, TINY)
    other = GivenGeometry(write_splats(tmp_path / 'other.ply', across=20))
    with pytest.raises(ConfigError, match='choose another folder'):
        claim(run.out, scene, TINY, other)


@pytest.mark.parametrize('axes', ['x,y', 'x,y,y', 'x,y,2z', '-x,y,z', 'x,y,z,', 'a,b,c', ''])
def test_axes_that_are_no_turn_are_refused(axes: str) -> None:
    with pytest.raises(ConfigError, match='--geometry-axes: expected .* no mirror image'):
        GivenGeometry(Path('room.ply'), axes).turn  # noqa: B018
