"""Speed of the radiance field: rays, wide views, steps of the fit. Needs the train extra."""
from collections.abc import Callable, Iterator
import itertools
import math

from neo_ros.field.config import FieldConfig, FIT_NEAR
from neo_ros.field.device import field_trainer, on_device
from neo_ros.field.fitting import FieldTrainer, STAGES
from neo_ros.field.grid_points import packed
from neo_ros.field.panorama import render_panorama, view_band
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.view_cutting import view_cutter
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.machine.host import Machine
from neo_ros.speed.record import Effort, Record, time_calls, Work
from neo_ros.speed.stream import measure_stream
import numpy as np

SEED = 0
# The paper's wide view, at quarter scale, and its narrow one.
WIDE = Intrinsics.from_hfov(128, 128, 2 * math.atan(2))
NARROW = Intrinsics.from_hfov(64, 64, math.pi / 2)
YAWS = 72  # views per position in the paper
PHOTOS = 24
# Raw density of matter above the field's shift, mean and variation: see `box_room`.
SOFT, SPREAD = 0.4, 1.2
# Per sample at least: position, 8 trilinear weights, density and colour from 8 corners (multiply
# and add of 4 values), opacity and compositing; and the corners' row number and 4 float32 from
# memory.
SAMPLE_FLOPS = 12 + 8 * 4 + 8 * 4 * 2 + 12
SAMPLE_BYTES = 8 * 5 * 4
# A step goes back through every sample, too: gradients are read and written.
BACKWARD = 3


def measure_field(machine: Machine, effort: Effort, device: str = 'cpu',
                  wide: Intrinsics = WIDE) -> Iterator[Record]:
    """
    Time rendering and fitting in a furnished box; floors count samples on surfaces only.

    device: cpu, cuda, or torch, see `on_device`.
    """
    field = box_room(effort.voxels)
    trainer = trainer_in(field, effort)
    trainer.train_step()
    samples = float(trainer.slopes.counts.mean())
    if device != 'cpu':
        trainer = trainer_in(field, effort, device)
    shown = on_device(field, device)
    times = time_calls(trainer.train_step, effort.seconds)
    size = f'{wide.width}x{wide.height}'

    def work(rays: int, passes: int = 1) -> Work:
        count = rays * samples * passes
        return Work(count * SAMPLE_FLOPS, count * SAMPLE_BYTES,
                    min(count * SAMPLE_BYTES, field.grid.nbytes + field.row_of.nbytes))

    rays = trainer.config.rays_per_step
    yield _with_rays(Record.of('field', 'step of the fit', times, {
        'voxels': len(field.row_of), 'samples_per_ray': samples}), rays).with_floor(
            work(rays, BACKWARD), machine, 0)
    # The trainer has its own copy of the grid: what is rendered is the room as it was built.
    poses = room_poses(16)
    for supersample in (1, 2):
        views = itertools.cycle(poses)
        times = time_calls(
            lambda: render_view(shown, wide, next(views), supersample), effort.seconds)
        rays = wide.width * wide.height * supersample ** 2
        yield _with_rays(Record.of(
            'field', f'wide view {size}, rays: {supersample ** 2} per pixel', times), rays
        ).with_floor(work(rays), machine, 0)
    yield from _measure_panorama(shown, wide, work, machine, effort)
    yield from measure_stream(shown, poses, wide, work, machine, effort)


def _measure_panorama(field: RadianceField, wide: Intrinsics, work: Callable[[int], Work],
                      machine: Machine, effort: Effort) -> Iterator[Record]:
    poses, size = room_poses(16), f'{wide.width}x{wide.height}'
    band = view_band(wide, np.stack([pose.T_world_cam[:3, :3] for pose in poses]),
                     (-np.pi, 2 * np.pi))
    views = itertools.cycle(poses)
    panorama = render_panorama(field, poses[0].position, wide, band)
    times = time_calls(
        lambda: render_panorama(field, next(views).position, wide, band), effort.seconds)
    rays = panorama.image.shape[0] * panorama.image.shape[1]
    whole = _with_rays(Record.of('field', f'panorama for wide views {size}', times), rays
                       ).with_floor(work(rays), machine, 0)
    yield whole
    cut_view = view_cutter(field, wide)
    times = time_calls(lambda: int(cut_view(
        panorama, next(views).T_world_cam[:3, :3])[-1, -1, 3]), effort.seconds)
    pixels = wide.width * wide.height
    cut = Record.of('field', f'wide view {size} cut from a panorama', times).with_floor(
        Work(None, 8 * pixels), machine, 1)
    assert whole.mean_ms is not None and cut.mean_ms is not None
    cut.details |= {'views_per_position': YAWS, 'views_per_s_with_panorama':
                    1e3 * YAWS / (whole.mean_ms + YAWS * cut.mean_ms)}
    yield cut


def box_room(voxels: int, seed: int = SEED) -> VoxelField:
    """
    Build a field of a room of about 5.4 x 4.4 x 2.1 m with boxes in it.

    Its matter is as soft as a fit leaves it: with surfaces that are opaque at once a ray has 6
    samples and is three times as fast as in fitted fields of 2 to 3 million voxels, where it has
    20 to 25 (a tenth of the rays under 8, a tenth above 40).
    """
    half = np.array([3.0, 2.5, 1.35])
    # Shell and near distance are those of a fit with default settings.
    field = VoxelField.empty(voxels, np.array([0, 0, 1.35]), half, FieldConfig.shell, 0,
                             near=FIT_NEAR)
    points = field.world_points().reshape(-1, 3)
    solid = (np.abs(points - field.centre) > half - 0.3).any(-1)
    random = np.random.default_rng(seed)
    for _ in range(8):
        # Along the walls, so that the cameras in the middle stand free.
        angle = random.uniform(0, 2 * np.pi)
        middle = np.array([2.4 * np.cos(angle), 1.9 * np.sin(angle), 0])
        size = random.uniform([0.2, 0.2, 0.4], [0.5, 0.5, 1.8])
        solid |= (np.abs(points - middle) < size).all(-1)
    waves = random.normal(0, 3, (3, 4))
    softness, *colours = np.sin(points @ waves + random.uniform(0, 6, 4)).T
    field.grid[:, 0] = np.where(solid, SOFT + SPREAD * softness - field.shift, -5)
    field.grid[:, 1:] = 4 * np.stack(colours, -1)
    field.update_occupancy()
    return field


def room_poses(count: int, seed: int = SEED) -> list[CameraPose]:
    """Return cameras in the middle of the room, 1.5 m high, looking anywhere around."""
    random = np.random.default_rng([seed, 1])
    return [CameraPose.from_planar(x, y, 1.5, yaw) for x, y, yaw in random.uniform(
        [-0.8, -0.8, -np.pi], [0.8, 0.8, np.pi], (count, 3)).tolist()]


def trainer_in(field: VoxelField, effort: Effort, device: str = 'cpu') -> FieldTrainer:
    """Return a trainer in its last stage, which takes most of a fit, with this field so far."""
    poses = room_poses(PHOTOS)
    photos = np.stack([to_uint8(render_view(field, NARROW, pose, 1).image) for pose in poses])
    config = FieldConfig(voxels=effort.voxels, device=device)
    trainer = field_trainer(photos, NARROW, np.stack([pose.T_world_cam for pose in poses]),
                            config, SEED)
    trainer.restore(trainer.state() | {
        'step': config.steps * 3 // 4 + 1, 'stage': len(STAGES) - 1,
        'grid': field.grid.copy(), 'shape': field.shape, 'kept': packed(field.row_of),
        'skip': field.skip, 'centre': field.centre, 'half_extent': field.half_extent,
        'first': np.zeros_like(field.grid), 'second': np.zeros_like(field.grid),
        'updates': np.zeros(len(field.grid), np.int32)})
    return trainer


def _with_rays(record: Record, rays: int) -> Record:
    assert record.mean_ms is not None
    record.details |= {'rays': rays, 'rays_per_s': 1e3 * rays / record.mean_ms}
    return record
