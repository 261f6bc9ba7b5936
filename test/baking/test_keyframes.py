"""Keyframes for the scene memory: where they stand, and where their colours come from."""
from pathlib import Path

from box_room import BAND, cast, EXPANSION, HEIGHT, planar, SOURCE, view
import cv2
from neo_ros.baking import band_rendering, keyframes, memory_baking
from neo_ros.baking.band_rendering import mesh_depth
from neo_ros.baking.glances import glance_rotations
from neo_ros.baking.kernels import colour_from_photos, PanoramaPixels, PhotoArrays
from neo_ros.baking.keyframes import (
    BakingRules, keyframe_positions, keyframe_size, MemoryConfig, Photos, seeing_camera)
from neo_ros.baking.memory_baking import bake_memory
from neo_ros.errors import ConfigError, NeoError
from neo_ros.field.rendering import Rendering
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Band, CameraPose, Intrinsics
from neo_ros.memory.memory_checks import MOST_TEXTURE
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.scenes.pose_sampling import PoseSampler
import numpy as np
import pytest

pytestmark = pytest.mark.slow

POSITION = np.array([2.0, 2.0, HEIGHT])
SMALL = BAND.rays(44, 126)


def bake(poses: list, coarse: np.ndarray, gain: float = 1.0, shift: float = 0.0) -> np.ndarray:
    """Colour a panorama of the box room from photos at `poses`; `shift` falsifies its depth."""
    colour, depth = cast(POSITION, SMALL)
    views = [view(pose, SOURCE) for pose in poses]
    lengths = np.linalg.norm(SOURCE.pixel_rays(), axis=-1)
    out = np.empty((*depth.shape, 3), np.uint8)
    colour_from_photos(
        PanoramaPixels(POSITION.astype(np.float32), SMALL, (depth + shift).astype(np.float32),
                       coarse),
        PhotoArrays(np.stack([(image / gain).astype(np.uint8) for image, _ in views]),
                    np.stack([z * lengths for _, z in views]).astype(np.float32),
                    np.stack([pose.T_world_cam[:3, :3] for pose in poses]).astype(np.float32),
                    np.stack([pose.position for pose in poses]).astype(np.float32),
                    np.full((len(poses), 3), gain, np.float32),
                    SOURCE.fx, SOURCE.fy, SOURCE.cx, SOURCE.cy), BAND.wraps, 0.1, out)
    return out


@pytest.mark.parametrize('gain', [1.0, 1.25], ids=['same exposure', 'darker photos'])
def test_colours_come_from_the_photos(gain: float) -> None:
    truth, _ = cast(POSITION, SMALL)
    coarse = np.clip(truth + 15, 0, 255).astype(np.uint8)
    poses = [planar(2.2, 1.9, yaw) for yaw in range(0, 360, 45)]
    baked = bake(poses, coarse, gain)
    level = np.abs(np.arange(44) - 21.5) < 15
    assert np.abs(baked[level] - truth[level]).mean() < 3
    assert np.abs(coarse[level] - truth[level]).mean() > 10


def test_a_photo_is_not_blurred_when_it_is_read_between_its_pixels() -> None:
    side, focal, depth = 32, 16.0, 2.0

    def wave(x: np.ndarray) -> np.ndarray:
        return 128 + 90 * np.sin(2 * np.pi * x / 6)

    centres = np.arange(side) + 0.5
    photo = np.broadcast_to(np.rint(wave(centres))[None, :, None], (side, side, 3))
    wanted = np.arange(8, 24, 0.25)
    rays = np.stack([(wanted - 16) / focal, np.zeros(64), np.ones(64)], -1)[None]
    lengths = np.linalg.norm(rays, axis=-1)
    pixels = np.stack(np.meshgrid((centres - 16) / focal, (centres - 16) / focal), -1)
    photo_depth = depth * np.sqrt(1 + (pixels ** 2).sum(-1))
    out = np.empty((1, 64, 3), np.uint8)
    colour_from_photos(
        PanoramaPixels(np.zeros(3, np.float32), rays / lengths[..., None],
                       (depth * lengths).astype(np.float32),
                       np.repeat(wave(wanted)[None, :, None], 3, 2).astype(np.uint8)),
        PhotoArrays(photo[None].astype(np.uint8), photo_depth[None].astype(np.float32),
                    np.eye(3, dtype=np.float32)[None], np.zeros((1, 3), np.float32),
                    np.ones((1, 3), np.float32), focal, focal, 16.0, 16.0), False, 0.1, out)
    # Linear interpolation is off by 12 here.
    assert np.abs(out[0, :, 0] - wave(wanted)).max() < 5


def test_without_a_photo_the_field_keeps_its_colour() -> None:
    truth, _ = cast(POSITION, SMALL)
    coarse = np.clip(truth + 15, 0, 255).astype(np.uint8)
    baked = bake([planar(2.2, 1.9, 0)], coarse)
    behind = np.abs(np.arange(126) - 63) > 40  # the panorama's middle is azimuth 0
    assert np.array_equal(baked[:, behind], coarse[:, behind])


def test_photos_that_see_something_else_there_are_left_out() -> None:
    truth, _ = cast(POSITION, SMALL)
    coarse = np.rint(truth).astype(np.uint8)
    poses = [planar(2.2, 1.9, yaw) for yaw in range(0, 360, 45)]
    assert np.array_equal(bake(poses, coarse, shift=0.8), coarse)


def test_far_away_photos_need_not_agree_on_the_depth() -> None:
    rays = np.zeros((1, 8, 3), np.float32)
    rays[..., 2] = 1
    camera = (16.0, 16.0, 4.0, 4.0)
    photo = np.full((1, 8, 8, 3), 200, np.uint8)
    baked = {}
    for depth, seen in ((150.0, 4000.0), (8.0, 9.0), (8.0, 4000.0)):
        out = np.empty((1, 8, 3), np.uint8)
        colour_from_photos(
            PanoramaPixels(np.zeros(3, np.float32), rays, np.full((1, 8), depth, np.float32),
                           np.full((1, 8, 3), 180, np.uint8)),
            PhotoArrays(photo, np.full((1, 8, 8), seen, np.float32),
                        np.eye(3, dtype=np.float32)[None], np.zeros((1, 3), np.float32),
                        np.ones((1, 3), np.float32), *camera), False, 0.1, out)
        baked[depth, seen] = int(out[0, 4, 0])
    assert list(baked.values()) == [200, 180, 180]


def test_photos_chosen_by_number_colour_as_copies_of_them_do() -> None:
    random = np.random.default_rng(0)
    colour, depth = cast(POSITION, SMALL)
    poses = [planar(2.2, 1.9, yaw) for yaw in range(0, 360, 30)]
    views = [view(pose, SOURCE) for pose in poses]
    lengths = np.linalg.norm(SOURCE.pixel_rays(), axis=-1)
    # Noise, that another photo would be seen by.
    images = random.integers(0, 256, (12, SOURCE.height, SOURCE.width, 3), np.uint8)
    panorama = PanoramaPixels(POSITION.astype(np.float32), SMALL, depth.astype(np.float32),
                              colour.astype(np.uint8))
    chosen = np.array([1, 2, 5, 6, 7, 9, 11])
    more = (np.stack([z * lengths for _, z in views]).astype(np.float32)[chosen],
            np.stack([pose.T_world_cam[:3, :3] for pose in poses]).astype(np.float32)[chosen],
            np.stack([pose.position for pose in poses]).astype(np.float32)[chosen],
            random.uniform(0.8, 1.2, (7, 3)).astype(np.float32),
            SOURCE.fx, SOURCE.fy, SOURCE.cx, SOURCE.cy)
    copied, by_number = (np.empty((*depth.shape, 3), np.uint8) for _ in range(2))
    colour_from_photos(panorama, PhotoArrays(images[chosen], *more), BAND.wraps, 0.1, copied)
    colour_from_photos(panorama, PhotoArrays(images, *more, chosen), BAND.wraps, 0.1, by_number)
    np.testing.assert_array_equal(by_number, copied)
    assert (copied != colour.astype(np.uint8)).mean() > 0.5


def test_a_keyframe_copies_no_photos(monkeypatch: pytest.MonkeyPatch) -> None:
    poses = [planar(2.1, 1.95, yaw).T_world_cam for yaw in range(0, 360, 45)]
    photos = Photos(np.zeros((8, SOURCE.height, SOURCE.width, 3), np.uint8), SOURCE,
                    np.stack(poses))
    given: list[PhotoArrays] = []
    monkeypatch.setattr(keyframes, 'colour_from_photos',
                        lambda panorama, posed, *more: given.append(posed))
    monkeypatch.setattr(band_rendering, 'render_rays', stand_in_field)
    keyframes.bake_keyframe(
        VoxelField.empty(8, POSITION, np.ones(3), 0.2, 0, near=0.5), photos,
        np.ones((8, 4, 4), np.float32), np.ones((8, 3), np.float32), POSITION, BAND, (8, 24, 1),
        BakingRules(photos=5))
    posed, = given
    assert posed.images is photos.images
    assert posed.numbers is not None and len(posed.numbers) == len(posed.depth) == 5


def test_every_place_has_a_keyframe_near() -> None:
    grid = np.stack(np.meshgrid(np.arange(0, 3, 0.1), np.arange(0, 2, 0.1)), -1).reshape(-1, 2)
    sampler = PoseSampler(grid, (0.0, 1.0), ((0.0, 0.0), (0.0, 0.0)), (1.4, 0.0))
    photos = Photos(np.zeros((1, 4, 4, 3), np.uint8), SOURCE, np.eye(4)[None])
    chosen = keyframe_positions(sampler, photos, 0.4)
    away = np.linalg.norm(grid[:, None] - chosen[None, :, :2], axis=-1)
    assert away.min(1).max() <= 0.4
    assert len(chosen) < 30 and np.all(chosen[:, 2] == 1.4)


def test_a_hand_held_camera_gets_keyframes_where_photos_are() -> None:
    sampler = PoseSampler(np.zeros((1, 2)), (0.0, 1.0), ((0.0, 0.1), (0.0, 0.1)), (1.4, 0.2))
    T = np.tile(np.eye(4), (20, 1, 1))
    T[:, 0, 3] = np.linspace(0, 2, 20)
    chosen = keyframe_positions(sampler, Photos(np.zeros((20, 4, 4, 3), np.uint8), SOURCE, T), 0.3)
    assert {tuple(point) for point in chosen} <= {tuple(point) for point in T[:, :3, 3]}


def test_a_distance_must_be_positive() -> None:
    with pytest.raises(ConfigError, match='memory.distance'):
        MemoryConfig(distance=0)


@pytest.mark.parametrize(('block', 'expected'), [
    ([[2, 2], [4, 4]], 4), ([[4, 2], [4, 2]], 4), ([[2, 2], [2, 4]], 2), ([[0, 0], [4, 4]], 4),
    ([[0, 0], [0, 4]], 0), ([[1, 2, 9], [9, 3, 9], [1, 2, 2]], 2),
    ([[4, 4.25], [3.75, 4]], 4), ([[4, 4.25], [4, 4.25]], 4.125),
], ids=['edge', 'upright edge', 'corner', 'edge of the known', 'hardly known', 'three by three',
        'slope', 'steps of one surface'])
def test_a_vertex_lies_on_a_surface(block: list[list[float]], expected: float) -> None:
    found = mesh_depth(np.array(block, np.float32), len(block), 0.1)
    assert found.dtype == np.float32 and found.tolist() == [[expected]]


def test_a_camera_that_never_turns_has_one_heading() -> None:
    sampler = PoseSampler(np.zeros((1, 2)), (0.3, 0.0), ((0.0, 0.0), (0.0, 0.0)), (1.4, 0.0))
    rotation, = glance_rotations(sampler)
    assert np.arctan2(rotation[1, 2], rotation[0, 2]) == pytest.approx(0.3)


POST = np.array([[2.6, 1.8, 0.0], [2.9, 2.15, 2.6]])
PHOTO = Intrinsics(80, 72, SOURCE.fx, SOURCE.fy, 40.0, 36.0)
PHOTO_GAIN = 0.8


def cast_with_post(origin: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what `cast` does, in a room with a post that hides a part of the walls."""
    colour, depth = cast(origin, rays)
    with np.errstate(divide='ignore'):
        ends = np.sort((POST[:, None, None] - origin) / rays, axis=0)
    near, far = ends[0].max(-1), ends[1].min(-1)
    post = (near > 0) & (near < far)
    colour[post], depth[post] = (200, 60, 40), near[post]
    return colour, depth


def look(T_world_cam: np.ndarray, camera: Intrinsics) -> np.ndarray:
    """Return the colours, float (H, W, 3), that a camera sees in the room with the post."""
    rays = camera.pixel_rays() @ T_world_cam[:3, :3].T
    return cast_with_post(T_world_cam[:3, 3],
                          rays / np.linalg.norm(rays, axis=-1, keepdims=True))[0]


def stand_in_field(field: VoxelField, origin: np.ndarray, rays: np.ndarray) -> Rendering:
    """Render like a field with exact depth, poor colours, and no idea of what is far below."""
    assert field.near == 0.5, 'keyframes leave out what views do'
    if rays.ndim == 2:
        return Rendering(*(layer[0] for layer in stand_in_field(field, origin, rays[None])))
    colour, depth = cast_with_post(origin, rays)
    poor = 20.0 * (-1.0) ** np.floor(500 * rays[..., :1])
    return Rendering(((colour + poor) / 255).astype(np.float32), depth.astype(np.float32),
                     np.ones(depth.shape, np.float32), (rays[..., 2] > -0.8).astype(np.float32))


def bake_with_post(work: Path, person: bool = False, masked: bool = False,
                   camera: Intrinsics = PHOTO) -> SceneMemory:
    """
    Bake one keyframe of the room with the post from photos around it.

    person: most of each photo shows somebody in white; masked: and its mask says so.
    """
    poses = [planar(2.1, 1.95, yaw).T_world_cam for yaw in range(0, 360, 45)]
    images = np.stack([(PHOTO_GAIN * look(T, camera)).astype(np.uint8) for T in poses])
    usable = np.ones(images.shape[:3], bool)
    usable[:, 12:60, 15:65] = not person
    images[~usable] = 255
    photos = Photos(images, camera, np.stack(poses), usable if masked else None)
    sampler = PoseSampler(POSITION[None, :2], (-np.pi, 2 * np.pi), ((0.0, 0.0), (0.0, 0.0)),
                          (HEIGHT, 0.0))
    field = VoxelField.empty(8, POSITION, np.ones(3), 0.2, 0, near=0.5)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(band_rendering, 'render_rays', stand_in_field)
        patch.setattr(keyframes, 'render_rays', stand_in_field)
        patch.setattr(memory_baking, 'render_rays', stand_in_field)
        memory = bake_memory(field, photos, EXPANSION, sampler, MemoryConfig(), 0, work)
    return memory


@pytest.fixture(scope='module')
def baked(tmp_path_factory: pytest.TempPathFactory) -> SceneMemory:
    return bake_with_post(tmp_path_factory.mktemp('baked'))


def test_finished_keyframes_are_not_baked_again(
        baked: SceneMemory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = baked.write(tmp_path / 'whole')
    assert bake_with_post(tmp_path / 'work').write(tmp_path / 'a') == whole
    finished, = (tmp_path / 'work').iterdir()
    with monkeypatch.context() as patch:
        patch.setattr(memory_baking, 'bake_keyframe', lambda *arguments: 1 / 0)
        assert bake_with_post(tmp_path / 'work').write(tmp_path / 'b') == whole
    finished.write_bytes(finished.read_bytes()[:1000])
    assert bake_with_post(tmp_path / 'work').write(tmp_path / 'c') == whole


def test_photos_finer_than_the_field_may_have_any_size(tmp_path: Path) -> None:
    # Its height rounds otherwise by focal length (93 rows) than by width (92).
    camera = Intrinsics(150, 132, 91.0, 91.0, 75.0, 66.0)
    depth = bake_with_post(tmp_path, camera=camera).keyframe(0).depth
    assert (depth > 0).mean() > 0.8


def test_a_keyframe_that_cannot_be_kept_says_why(tmp_path: Path) -> None:
    (tmp_path / 'work').write_text('')
    with pytest.raises(NeoError, match='cannot keep the work: .* give the same command'):
        bake_with_post(tmp_path / 'work')


def test_a_baked_keyframe_has_the_depths_of_the_scene(baked: SceneMemory) -> None:
    depth = baked.keyframe(0).depth
    height, width = depth.shape
    finer = len(baked.keyframe(0).texture) // height
    rays = baked.band.rays(finer * height, finer * width)
    truth = cast_with_post(POSITION, rays)[1]
    truth[rays[..., 2] <= -0.8] = np.inf
    samples = truth.reshape(height, finer, width, finer).swapaxes(1, 2).reshape(
        height, width, finer * finer)
    nearness = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    off = np.abs(nearness[..., None] - 1 / samples).min(-1)
    assert np.quantile(off, 0.99) < 1e-3 and off.max() < 0.01  # In corners.
    assert 0.02 < (depth == 0).mean() < 0.2
    # Blocks that an edge of the post cuts in two.
    assert (np.ptp(1 / samples, axis=-1) > 0.5).sum() > 20


def test_a_baked_keyframe_has_the_colours_of_the_photos(baked: SceneMemory) -> None:
    frame = baked.keyframe(0)
    rays = baked.band.rays(*frame.texture.shape[:2])
    truth, depth = cast_with_post(POSITION, rays)
    seen = np.abs(rays[..., 2]) < 0.6
    wrong = np.abs(frame.texture - truth).mean(-1)
    assert wrong[seen].mean() < 4
    # On the post, which hides other walls from the photos, off its edges by a pixel.
    post = cv2.erode((depth < 1.2).astype(np.uint8), np.ones((5, 5))) > 0
    assert (post & seen).sum() > 500 and wrong[post & seen].mean() < 4


def test_what_a_mask_leaves_out_colours_nothing(tmp_path: Path) -> None:
    off, glances_off = [], []
    for masked in (False, True):
        memory = bake_with_post(tmp_path / str(masked), person=True, masked=masked)
        texture = memory.keyframe(0).texture
        rays = memory.band.rays(*texture.shape[:2])
        level = np.abs(rays[..., 2]) < 0.3
        off.append((texture - cast_with_post(POSITION, rays)[0])[level])
        photos = zip(memory.glances.pictures[24:], memory.glances.T_world_cam[24:])
        glances_off.append(np.mean([np.abs(picture - photo_glance(T)) for picture, T in photos]))
    # Somebody in white shifts the photos' exposure and the room's colours.
    assert np.abs(off[0]).mean() > 35 and abs(off[0].mean()) > 10
    # The field's own colours are left there, off by 20 to both sides, and photos elsewhere.
    assert np.abs(off[1]).mean() < 18 and abs(off[1].mean()) < 1
    # A small picture of a photo shows the field there, in the photo's light.
    assert glances_off[0] > 40 and glances_off[1] < 5


def photo_glance(T_world_cam: np.ndarray, gain: float = PHOTO_GAIN) -> np.ndarray:
    """Return the small picture, float (16, 16), that the empty room gives."""
    seen = (gain * look(T_world_cam, SOURCE)).astype(np.uint8)
    return cv2.resize(cv2.cvtColor(seen, cv2.COLOR_RGB2GRAY), (16, 16),
                      interpolation=cv2.INTER_AREA).astype(float)


def test_baked_glances_show_what_is_seen_from_their_poses(baked: SceneMemory) -> None:
    glances = baked.glances
    assert len(glances.pictures) == 24 + 8
    for picture, T, gain in zip(glances.pictures, glances.T_world_cam,
                                [1.0] * 24 + [PHOTO_GAIN] * 8):
        assert np.abs(picture - photo_glance(T, gain)).mean() < (6 if gain == 1 else 0.1)
    yaws = np.sort([CameraPose(T).yaw for T in glances.T_world_cam[:24]])
    assert np.degrees(np.diff(yaws)) == pytest.approx(15)


def test_a_texture_finer_than_the_depth_is_as_sharp_as_one_with_depth_for_every_pixel() -> None:
    """Depth is known of every third row and column, in photos of every second."""
    poses = [planar(2.2, 1.9, yaw) for yaw in range(0, 360, 45)]
    fine = BAND.rays(132, 378)
    truth, fine_depth = cast(POSITION, fine)
    _, depth = cast(POSITION, SMALL)
    baked = {}
    rotations = np.stack([pose.T_world_cam[:3, :3] for pose in poses]).astype(np.float32)
    for name, rays, distance, every in (('all', fine, fine_depth, 1), ('third', SMALL, depth, 2)):
        views = [view(pose, PHOTO) for pose in poses]
        lengths = np.linalg.norm(PHOTO.pixel_rays(), axis=-1)
        photo_depth = np.stack([z * lengths for _, z in views]).astype(np.float32)
        out = np.empty((132, 378, 3), np.uint8)
        colour_from_photos(
            PanoramaPixels(POSITION.astype(np.float32), rays, distance.astype(np.float32),
                           np.full((*distance.shape, 3), 128, np.uint8)),
            PhotoArrays(np.stack([image.astype(np.uint8) for image, _ in views]),
                        photo_depth[:, every // 2::every, every // 2::every],
                        rotations, np.stack([pose.position for pose in poses]).astype(np.float32),
                        np.ones((len(poses), 3), np.float32),
                        PHOTO.fx, PHOTO.fy, PHOTO.cx, PHOTO.cy), BAND.wraps, 0.1, out)
        baked[name] = out.astype(float)
    level = np.abs(np.arange(132) - 65.5) < 45
    error = {name: np.abs(image[level] - truth[level]).mean() for name, image in baked.items()}
    assert error['all'] < 4
    assert error['third'] < error['all'] + 0.5


@pytest.mark.parametrize('focal', [6000.0, 12000.0])
@pytest.mark.parametrize('top', [0.3, 0.9, np.pi / 2])
def test_a_texture_is_never_larger_than_what_reads_it_takes(focal: float, top: float) -> None:
    rows, columns, finer = keyframe_size(Band(top, -top), focal)
    assert rows == int(2 * top * 96) and columns == 603
    assert max(rows, columns) * finer < (1 << 15) - 1
    assert rows * columns * finer ** 2 <= MOST_TEXTURE
    assert rows * columns * finer ** 2 * 3 <= BakingRules.most_bytes
    # As large as it may be.
    finer += 1
    assert columns * finer > (1 << 15) - 2 or (
        rows * columns * finer ** 2 * 3 > BakingRules.most_bytes)


def test_usual_textures_are_as_fine_as_the_view_or_three_times() -> None:
    assert keyframe_size(Band(0.9, -0.9), 256.0) == (172, 603, 8)
    # From there on no finer than poses and depth are, but as the view is.
    assert keyframe_size(Band(0.9, -0.9), 554.3) == (172, 603, 8)
    assert keyframe_size(Band(0.9, -0.9), 1400.0) == (172, 603, 15)
    assert keyframe_size(Band(0.9, -0.9), 64.0) == (115, 402, 3)


@pytest.mark.parametrize('width, height, fx', [(720, 1280, 361.4), (480, 640, 333.3),
                                               (640, 480, 465.6), (64, 64, 32.0)])
def test_photos_that_were_made_small_for_the_field_are_not_made_smaller(
        width: int, height: int, fx: float) -> None:
    camera = Intrinsics(width, height, fx, fx, width / 2, height / 2)
    small = camera.scaled(min(64 / camera.fx, 1.0))
    assert seeing_camera(small, BakingRules()) == small
    assert seeing_camera(camera, BakingRules()) == small
