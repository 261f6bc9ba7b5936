"""Protocols, frozen splits and suites."""
from dataclasses import replace
import json

from neo_ros.benchmark.protocols import (
    check_own_split, check_split, choose_view, fitting_network, OWN_SPLIT, scale_within,
    split_checksums, split_walks)
from neo_ros.benchmark.suites import (
    config_folder, merged, prepare_demo, read_suite, SPLITS_FILE, suite_jobs)
from neo_ros.benchmark.workbench import Job, Workbench
from neo_ros.captures.held_out_runs import middle_columns
from neo_ros.errors import ConfigError, NeoError, SceneError
from neo_ros.experiment import Experiment, ViewConfig
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.progress import no_stage_progress
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.outpaint.networks import check_network, shrunk_expansion
from neo_ros.scenes.scene import Scene
from neo_ros.scenes.transforms_json import read_transforms, write_transforms
import pytest
from scene_files import write_capture


def scene_of(folder, camera, count=3):
    photos = write_capture(folder, count, camera)
    return Scene('room', photos, None, None, None)


@pytest.mark.parametrize('size, protocol, scale, source, target', [
    ((320, 240), 'horizontal', 1.0, (160, 240), (320, 240)),
    ((320, 240), 'horizontal', 0.5, (160, 240), (320, 240)),
    ((320, 240), 'horizontal', 0.25, (160, 240), (320, 240)),
    ((1296, 968), 'horizontal', 0.25, (640, 960), (1280, 960)),
    ((256, 256), 'square', 0.25, (256, 256), (512, 512)),
    ((640, 480), 'square', 0.5, (480, 480), (960, 960)),
    ((100, 90), 'square', 1.0, (88, 88), (176, 176)),
], ids=['redkitchen', 'half', 'quarter', 'scannet', 'paper', 'wide photo', 'odd'])
def test_views_of_the_protocols(tmp_path, size, protocol, scale, source, target):
    camera = Intrinsics.from_hfov(size[0], size[1], 1.5)
    scene = scene_of(tmp_path, camera, 1)
    view = choose_view(scene, protocol, scale)
    assert view == ViewConfig(source, target)
    experiment = Experiment(scale=scale, view=view)
    expansion = experiment.expansion(camera, None)
    network = fitting_network(experiment, expansion)
    cell = network.patch * 2 ** (network.depth - 1)
    assert cell >= 4
    assert not (expansion.source.width % cell or expansion.left % cell)


def test_a_shrunk_network_has_a_grid_of_the_shrunk_view():
    # 240 and 160 are multiples of 16, the half of 240 is not.
    camera = Intrinsics.from_hfov(160, 240, 1.0)
    expansion = ViewExpansion.to_size(camera, 320, 240)
    for shrink in (1, 2):
        experiment = Experiment(network=NetworkConfig(shrink=shrink))
        network = fitting_network(experiment, expansion)
        assert network.shrink == shrink
        check_network(shrunk_expansion(expansion, network), network)


def test_stated_views_are_taken_as_they_are(tmp_path):
    camera = Intrinsics.from_hfov(64, 64, 1.5)
    photos = write_capture(tmp_path, 1, camera)
    stated = ViewExpansion.to_size(camera, 128, 128)
    scene = Scene('room', photos, photos, stated, None)
    assert choose_view(scene, 'square', 1.0) is None
    assert choose_view(scene, 'horizontal', 1.0) == ViewConfig((32, 64), (64, 64))
    # Of photos 1080 pixels wide the middle is 568, which has no cells at a quarter of that.
    wide = write_capture(tmp_path / 'phone', 1, Intrinsics.from_hfov(1080, 64, 1.0))
    scene = Scene('phone', wide, wide, middle_columns(wide.intrinsics), None)
    assert choose_view(scene, 'horizontal', 1.0) is None
    assert choose_view(scene, 'horizontal', 0.25) == ViewConfig((512, 64), (1024, 64))


@pytest.mark.parametrize('protocol, size, message', [
    ('round', (64, 64), 'square or horizontal'), ('square', (6, 6), 'too small')])
def test_impossible_protocols(tmp_path, protocol, size, message):
    scene = scene_of(tmp_path, Intrinsics.from_hfov(size[0], size[1], 1.5), 1)
    with pytest.raises(ConfigError, match=message):
        choose_view(scene, protocol, 1.0)


@pytest.fixture
def split(tmp_path):
    camera = Intrinsics.from_hfov(32, 32, 1.5)
    photos = write_capture(tmp_path, 3, camera)
    test = write_capture(tmp_path, 2, camera.grown(16, 16, 16, 16), 'transforms_test.json',
                         'test')
    return photos, test, ViewExpansion.to_size(camera, 64, 64)


def test_a_frozen_split_is_known_again_and_any_change_is_named(split, tmp_path):
    photos, test, stated = split
    frozen = tmp_path / 'splits.json'
    checksums = split_checksums(photos, test, stated)
    frozen.write_text(json.dumps({'room': checksums}))
    check_split('room', checksums, frozen)
    # Written again, it is still the same split.
    write_transforms(tmp_path / 'again.json', photos)
    check_split('room', split_checksums(read_transforms(tmp_path / 'again.json'), test, stated),
                frozen)
    moved = split_checksums(photos, test, ViewExpansion(stated.source, 15, 17, 16, 16))
    fewer = split_checksums(photos.subset([0, 1]), test, stated)
    content = photos.image_paths[0].read_bytes()
    photos.image_paths[0].write_bytes(content + b' ')
    repainted = split_checksums(photos, test, stated)
    for found, words in ((moved, 'test frames'), (fewer, 'training photos'),
                         (repainted, 'pixels')):
        with pytest.raises(SceneError, match=f'{words}.*cannot be compared'):
            check_split('room', found, frozen)
    with pytest.raises(SceneError, match='one of the frozen scenes room'):
        check_split('hall', checksums, frozen)


def test_a_folder_notes_the_split_it_was_first_scored_on(split, tmp_path):
    photos, test, stated = split
    shipped = tmp_path / 'splits.json'
    checksums = split_checksums(photos, test, stated)
    shipped.write_text(json.dumps({tmp_path.name: checksums}))
    check_own_split(tmp_path, checksums, shipped)
    assert not (tmp_path / OWN_SPLIT).exists()  # It is a shipped one.
    shipped.write_text('{}')
    check_own_split(tmp_path, checksums, shipped)
    assert json.loads((tmp_path / OWN_SPLIT).read_text()) == checksums
    check_own_split(tmp_path, checksums, shipped)
    fewer = split_checksums(photos.subset([0, 1]), test, stated)
    with pytest.raises(SceneError, match='training photos.*split.json.*cannot be compared'):
        check_own_split(tmp_path, fewer, shipped)
    (tmp_path / OWN_SPLIT).unlink()
    (tmp_path / OWN_SPLIT).mkdir()
    with pytest.raises(NeoError, match='split.json: cannot write'):
        check_own_split(tmp_path, checksums, shipped)


def test_a_suite_of_every_scene_takes_what_it_is_given(tmp_path):
    suite = read_suite('real')
    for place, width in (('a/hall', 640), ('a/yard', 6000), ('b/kitchen', 320)):
        camera = Intrinsics.from_hfov(width, 8, 1.0)
        write_capture(tmp_path / place, 1, camera)
        write_capture(tmp_path / place, 1, camera, 'transforms_test.json', 'test')
    (tmp_path / 'a/notes').mkdir()
    jobs = suite_jobs(suite, [tmp_path / 'b/kitchen', tmp_path / 'a'])
    assert list(jobs) == ['kitchen', 'hall', 'yard']
    assert [job.scale for job in jobs.values()] == ['full', 'half', 'eighth']
    assert {(job.protocol, job.minutes, job.settings) for job in jobs.values()} == {
        ('horizontal', 10, None)}
    with pytest.raises(ConfigError, match='got hall, yard, hall, yard in'):
        suite_jobs(suite, [tmp_path / 'a', tmp_path / 'a'])
    with pytest.raises(ConfigError, match='got none in .*neo import'):
        suite_jobs(suite, [tmp_path / 'a/notes'])
    (tmp_path / 'a/yard/transforms_test.json').unlink()
    with pytest.raises(ConfigError, match='yard: .*--test-runs 3'):
        suite_jobs(suite, [tmp_path / 'a'])


def test_rooms_that_no_constant_was_chosen_on_are_scored_by_the_defaults(tmp_path):
    suite = read_suite('unseen')
    camera = Intrinsics.from_hfov(128, 128, 1.0)
    write_capture(tmp_path / 'rooms', 1, camera)
    write_capture(tmp_path / 'rooms', 1, camera, 'transforms_test.json', 'test')
    job = suite_jobs(suite, [tmp_path])['rooms']
    assert (job.protocol, job.scale, job.settings) == ('square', 'full', None)
    assert {'relocalized', 'guided', 'oracle'} <= set(suite.methods)


@pytest.mark.parametrize('width, height, longest, scale', [
    (320, 240, 320, 'full'), (240, 321, 320, 'half'), (8000, 9000, 100, 'eighth')])
def test_the_largest_scale_within_so_many_pixels(width, height, longest, scale):
    assert scale_within(Intrinsics.from_hfov(width, height, 1.0), longest) == scale


@pytest.mark.parametrize('name, scale, frames', [
    ('quarter', 'quarter', None), ('full', 'full', 50)])
def test_the_shipped_suites_name_frozen_scenes(tmp_path, name, scale, frames):
    suite = read_suite(name)
    frozen = json.loads((config_folder() / SPLITS_FILE).read_text())
    assert suite.scenes.keys() <= frozen.keys()
    for scene in suite.scenes:
        write_capture(tmp_path / scene, 1)
    jobs = suite_jobs(suite, [tmp_path])
    assert [job.scene for job in jobs.values()] == [str(tmp_path / n) for n in suite.scenes]
    assert jobs['redkitchen'].protocol == 'horizontal'
    fields = {name: (job.settings or {})['field'] for name, job in jobs.items()}
    assert fields['redkitchen']['exposure'] is True
    assert fields['living_room']['voxels'] > 0
    assert (jobs['living_room'].scale, jobs['living_room'].most_frames) == (scale, frames)


def test_missing_scenes_are_named_at_once(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ConfigError, match='living_room, redkitchen, staircase are in none'):
        suite_jobs(read_suite('quarter'), [])


def test_another_scene_under_a_frozen_name_is_refused(tmp_path, split):
    photos, test, stated = split
    with pytest.raises(SceneError, match='living_room: .*frozen split'):
        check_split('living_room', split_checksums(photos, test, stated),
                    config_folder() / SPLITS_FILE)


def test_a_scene_without_truth_is_refused_and_another_folder_may_hold_it(tmp_path):
    camera = Intrinsics.from_hfov(32, 32, 1.5)
    write_capture(tmp_path / 'train', 30, camera)
    job = Job(str(tmp_path / 'train'), 'horizontal', 'full', 1.0)
    with pytest.raises(ConfigError, match='--test-scene'):
        Workbench(job, tmp_path / 'a', no_stage_progress)
    write_capture(tmp_path / 'walk', 4, camera)
    job = Job(str(tmp_path / 'train'), 'horizontal', 'full', 1.0, str(tmp_path / 'walk'))
    bench = Workbench(job, tmp_path / 'b', no_stage_progress)
    assert len(bench.frames) == 4
    assert bench.frames.read(0)[0].shape == (32, 16, 3)


def test_photos_that_are_trained_on_are_no_truth(tmp_path):
    camera = Intrinsics.from_hfov(32, 32, 1.5)
    write_capture(tmp_path / 'train', 30, camera)
    (tmp_path / 'link').symlink_to(tmp_path / 'train')
    job = Job(str(tmp_path / 'train'), 'horizontal', 'full', 1.0, str(tmp_path / 'link'))
    with pytest.raises(ConfigError, match='not trained on, got 30'):
        Workbench(job, tmp_path / 'a', no_stage_progress)
    write_capture(tmp_path / 'train', 2, camera, 'transforms_test.json', 'test')
    with pytest.raises(ConfigError, match='train has transforms_test.json'):
        Workbench(job, tmp_path / 'a', no_stage_progress)


def test_a_capture_without_walks_is_split_where_it_jumps(tmp_path):
    photos = write_capture(tmp_path, 12)
    poses = [CameraPose.from_planar(0.1 * i + 3 * (i > 4) + 3 * (i > 8), 0, 1.5, 0.02 * i)
             for i in range(12)]
    one = replace(photos, poses=tuple(poses), path_ids=(0,) * 12)
    assert split_walks(one).path_ids == (0,) * 5 + (1,) * 4 + (2,) * 3
    assert split_walks(photos) is photos


def test_settings_are_laid_over_one_another():
    assert merged({'a': {'b': 1, 'c': 2}, 'd': 3}, {'a': {'c': 4}, 'e': 5}) == {
        'a': {'b': 1, 'c': 4}, 'd': 3, 'e': 5}


@pytest.mark.parametrize('changed, field', [
    ({'scale': 'tenth'}, 'scale'), ({'minutes': 0.0}, 'budget-minutes')])
def test_jobs_are_checked(changed, field):
    with pytest.raises(ConfigError, match=field):
        Job(**{'scene': '.', 'protocol': 'square', 'scale': 'full', 'minutes': 1.0, **changed})


def test_the_demo_flat_is_rendered_where_it_is_missing(tmp_path, monkeypatch):
    from neo_ros.benchmark import suites
    seen: list[tuple] = []

    def write(folder, image_size, progress):
        seen.append((folder, image_size))
        progress(1, 2)

    monkeypatch.setattr(suites, 'write_demo_scene', write)
    jobs = {name: Job(str(tmp_path / name), 'square', 'half', 1.0)
            for name in ('living_room', 'demo_flat', 'demo_flat_256')}

    def prepare(suite):
        prepare_demo(read_suite(suite), jobs,
                     lambda stage, done, total, note='': seen.append((stage, done, total)))
        return seen

    assert prepare('real') == []  # It takes folders as they are, whatever their names.
    assert prepare('quarter') == [(tmp_path / 'demo_flat', 128), ('demo flat', 1, 2)]
    seen.clear()
    assert prepare('full') == [(tmp_path / 'demo_flat_256', 256), ('demo flat', 1, 2)]
