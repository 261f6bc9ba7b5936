from neo_ros.flat.demo_flat import build_demo_flat, sample_training_poses, walking_paths
from neo_ros.flat.shapes import paint, SolidBuilder
from neo_ros.flat.walks import DOORWAY, obstacle_distance
import numpy as np
import pytest


@pytest.fixture(scope='module')
def flat():
    return build_demo_flat()


def _places(poses):
    return np.array([pose.position[:2] for pose in poses])


def test_free_floor_keeps_clear_of_everything(flat):
    walkable = flat.walkable()
    assert (walkable.resolution, walkable.clearance, walkable.camera_height) == (0.05, 0.25, 1.5)
    points = walkable.sample(np.random.default_rng(0), 2000)
    assert obstacle_distance(flat.solids, points).min() >= 0.25


def test_free_floor_reaches_both_rooms(flat):
    centres = flat.walkable().centres()
    assert (centres[:, 0] < 5.5).sum() * 0.05 ** 2 > 5
    assert (centres[:, 0] > 6.5).sum() * 0.05 ** 2 > 2
    assert flat.walkable().contains(np.array([DOORWAY[:2]])).all()


@pytest.mark.parametrize('xy, metres', [
    ((2.0, 0.0), 1.0), ((1.3, 1.4), 0.5), ((0.5, 0.5), 0.0), ((5.0, 2.0), 1.5),
    ((10.0, 0.0), 1.0 - np.sqrt(0.5)), ((-5.0, 0.0), 4.0)],
    ids=['beside a box', 'off its corner', 'inside', 'round', 'turned', 'flat and high ones'])
def test_obstacle_distance(xy, metres):
    builder, grey = SolidBuilder(), paint('808080')
    builder.box((-1, -1, 0), (1, 1, 1), grey)
    builder.frustum(5, 4, (0, 1), (0.5, 0.1), grey)
    builder.at(9, 0, 45).box((-0.5, -0.5, 0), (0.5, 0.5, 1), grey)
    builder.box((-6, -1, 0), (-4, 1, 0.08), grey)  # a rug
    builder.box((-6, -1, 1.8), (-4, 1, 2), grey)  # a lamp
    assert obstacle_distance(builder.build(), np.array([xy]))[0] == pytest.approx(metres)


def test_training_poses_are_level_and_cover_floor_and_headings(flat):
    poses = sample_training_poses(flat, 600, seed=2)
    assert all(pose.position[2] == 1.5 for pose in poses)
    assert max(abs(pose.forward[2]) for pose in poses) < 1e-12
    assert flat.walkable().contains(_places(poses)).all()
    yaws = np.array([pose.yaw for pose in poses])
    counts = np.histogram(yaws, bins=6, range=(-np.pi, np.pi))[0]
    assert counts.min() > 65
    centre = flat.walkable().centres().mean(axis=0)
    np.testing.assert_allclose(_places(poses).mean(axis=0), centre, atol=0.3)


def test_training_poses_follow_the_seed(flat):
    first, again, other = (_places(sample_training_poses(flat, 20, seed)) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize('seed, n_frames', [(0, 25), (1, 25), (2, 60)], ids=str)
def test_walks_stay_on_free_floor_and_are_smooth(flat, seed, n_frames):
    walks = walking_paths(flat, 3, n_frames, seed)
    assert [len(walk) for walk in walks] == [n_frames] * 3
    for walk in walks:
        places = _places(walk)
        assert flat.walkable().contains(places).all()
        steps = np.hypot(*np.diff(places, axis=0).T)
        assert steps.max() < 0.11 and steps.mean() > 0.04
        yaws = np.unwrap([pose.yaw for pose in walk])
        assert np.abs(np.diff(yaws)).max() < np.radians(25)
        # Between two frames the walk does not cut a corner either.
        middle = (places[:-1] + places[1:]) / 2
        assert obstacle_distance(flat.solids, middle).min() > 0.22


def test_the_first_walk_goes_through_the_doorway(flat):
    for seed in range(4):
        x = _places(walking_paths(flat, 1, 25, seed)[0])[:, 0]
        assert x.min() < DOORWAY[0] - 0.2 and x.max() > DOORWAY[0] + 0.2


def test_walks_look_mostly_where_they_go(flat):
    for walk in walking_paths(flat, 3, 25, 0):
        way = np.diff(_places(walk), axis=0)
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        ahead = np.array([pose.forward[:2] for pose in walk[:-1]])
        assert np.median((way * ahead).sum(axis=1)) > 0.85
