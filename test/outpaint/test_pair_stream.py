import math

from neo_ros.errors import SceneError
from neo_ros.field.device import on_device
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.outpaint.pair_stream import PairStream, StreamRules
from neo_ros.outpaint.panorama_pool import covered
from neo_ros.scenes.pose_sampling import PoseSampler
import numpy as np
from plain_field import CENTRE, room_field, WALLS
import pytest

VIEW = Intrinsics.from_hfov(16, 16, 1.6)
LEVEL = ((0.0, 0.0), (0.0, 0.0))
FIRST = StreamRules().first


@pytest.fixture(scope='module')
def field() -> VoxelField:
    result = room_field(30_000)
    result.update_occupancy()
    inside = np.abs(result.world_points() - CENTRE) < WALLS + 2 * result.voxel
    result.seen = inside.all(-1).astype(np.uint8).ravel()
    return result


def sampler(*offsets: tuple[float, float],
            yaw_range: tuple[float, float] = (-math.pi, 2 * math.pi)) -> PoseSampler:
    places = CENTRE[:2] + np.array(offsets or [(x, y) for x in (-0.5, 0, 0.5) for y in (0, 0.4)])
    return PoseSampler(places, yaw_range, LEVEL, (float(CENTRE[2]), 0.0))


@pytest.mark.slow
def test_a_batch_is_the_same_however_the_training_came_to_it(field: VoxelField) -> None:
    through = PairStream(field, sampler(), VIEW, 50, seed=4)
    batches = [through.batch(step, 3) for step in range(6)]
    resumed = PairStream(field, sampler(), VIEW, 50, seed=4)
    np.testing.assert_array_equal(resumed.batch(5, 3), batches[5])
    np.testing.assert_array_equal(resumed.batch(2, 3), batches[2])
    assert not np.array_equal(batches[4], batches[5])
    other = PairStream(field, sampler(), VIEW, 50, seed=5)
    assert not np.array_equal(other.batch(5, 3), batches[5])


def test_batches_are_wide_views_with_their_coverage(field: VoxelField) -> None:
    batch = PairStream(field, sampler(), VIEW, 4, seed=0).batch(0, 8).numpy()
    assert batch.shape == (8, 16, 16, 4) and batch.dtype == np.uint8
    assert batch[..., 3].min() > 240
    assert batch[..., :3].std(axis=0).mean() > 10, 'the views differ'


def test_positions_come_as_training_goes_on(field: VoxelField) -> None:
    stream = PairStream(field, sampler(), VIEW, FIRST + 4, seed=0)
    assert not stream.pool.panoramas
    counts = []
    every = stream.steps_per_panorama
    # A level camera's panoramas are a few views each, narrow views' are many.
    narrow = Intrinsics.from_hfov(16, 16, 0.5)
    assert 4 <= every < 10 < PairStream(field, sampler(), narrow, 1, seed=0).steps_per_panorama
    for step in (0, every - 1, every, 10 * every):
        stream.batch(step, 1)
        counts.append(len(stream.pool.panoramas))
    assert counts == [FIRST, FIRST, FIRST + 1, FIRST + 4]
    few = PairStream(field, sampler(), VIEW, 3, seed=0)
    few.batch(0, 2)
    assert len(few.pool.panoramas) == 3


def test_views_look_where_the_sampler_says(field: VoxelField) -> None:
    stream = PairStream(field, sampler((0.3, 0.1), yaw_range=(1.0, 0.0)), VIEW, 1, seed=0)
    found = stream.batch(0, 1)[0].numpy()
    pose = np.eye(4)
    pose[:3, :3] = stream.pool.sampler.draw_rotation(np.random.default_rng(0))
    pose[:3, 3] = CENTRE + [0.3, 0.1, 0]
    expected = to_uint8(render_view(field, VIEW, CameraPose(pose)).image)
    assert np.abs(found[..., :3].astype(int) - expected).mean() < 3


def test_what_no_photo_saw_is_marked() -> None:
    field = room_field(8000)
    field.update_occupancy()
    # Seen: all but the corner at the right of what the camera looks at.
    field.seen = (field.world_points()[..., 1] > CENTRE[1] - 0.5).astype(np.uint8).ravel()
    view = PairStream(field, sampler((0, 0), yaw_range=(0.0, 0.0)), VIEW, 1, 0).batch(0, 1)[0]
    assert view[:, :7, 3].min() > 240 and view[:, 13:, 3].max() < 15


def test_positions_inside_matter_are_passed_over(field: VoxelField) -> None:
    inside_wall = (float(WALLS[0]) + 0.9, 0.0)
    stream = PairStream(field, sampler((0, 0), inside_wall), VIEW, 12, seed=0)
    stream.batch(0, 1)
    assert stream.pool.refused['in matter'] > 0 and len(stream.pool.panoramas) == 12
    assert {tuple(panorama.position[:2]) for panorama in stream.pool.panoramas} == {
        tuple(CENTRE[:2])}


def test_views_of_which_no_photo_saw_half_are_drawn_again() -> None:
    field = room_field(8000)
    field.update_occupancy()
    field.seen = (field.world_points()[..., 0] > CENTRE[0]).astype(np.uint8).ravel()
    batch = PairStream(field, sampler((0, 0)), VIEW, 1, seed=0).batch(0, 24)
    assert all(covered(view) for view in batch)
    assert min(view[..., 3].float().mean() for view in batch) < 200, 'not only views of seen parts'


@pytest.mark.slow
def test_a_scene_that_no_photo_saw_is_an_error() -> None:
    field = room_field(4000)
    field.update_occupancy()
    field.seen[:] = 0
    with pytest.raises(SceneError, match='does the floor map belong to this scene'):
        PairStream(field, sampler(), VIEW, 2, seed=0).batch(0, 1)


def test_views_are_cut_where_the_field_is() -> None:
    """On a torch device as by OpenCV, in the same order, and left there."""
    batches, cutters = {}, []
    for device in ('cpu', 'torch'):
        field = room_field(30_000)
        field.update_occupancy()
        field.seen[:] = 1
        stream = PairStream(on_device(field, device), sampler(), VIEW, 4, seed=0)
        batches[device] = stream.batch(3, 8)
        cutters.append(stream.pool.cut_view.__qualname__)
    assert batches['torch'].device == stream.pool.device
    # OpenCV counts in 32nds of a pixel, on some processors.
    assert (batches['cpu'].int() - batches['torch'].int()).abs().float().mean() < 0.5
    assert 'ViewCutter' not in cutters[0] and 'ViewCutter' in cutters[1]
