"""Posed renders with a traj.txt: walks in folders of their own."""
from capture_files import demo_photos, write_trajectory
from neo_ros.benchmark.protocols import split_walks
from neo_ros.captures.scene_writing import write_capture
from neo_ros.captures.trajectory import read_trajectory
from neo_ros.scenes.scene import read_scene
import numpy as np


def test_folders_of_images_are_walks(tmp_path):
    photos = demo_photos()
    source = write_trajectory(tmp_path / 'source', photos)
    # Natural order of the folders; names come again in another walk.
    for walk, first, end in (('walk2', 0, 2), ('walk10', 2, 5)):
        (source / 'rgb' / walk).mkdir()
        for index in range(first, end):
            for kind in ('frame', 'depth'):
                (source / f'rgb/{kind}{index}.png').rename(
                    source / f'rgb/{walk}/{kind}{index - first}.png')
    write_capture(read_trajectory(source), tmp_path / 'scene')
    found = read_scene(tmp_path / 'scene').train
    assert found.path_ids == (0, 0, 1, 1, 1)
    assert split_walks(found) is found
    np.testing.assert_allclose(found.T_world_cam, [pose.T_world_cam for pose in photos.poses],
                               atol=1e-6)
    np.testing.assert_array_equal(found.read_images(), photos.images)
