"""Replay of sections, of compressed and of other cameras, with its threads and its video."""
from collections import Counter
import json
import math
from pathlib import Path

import av
from bag_files import START_NS, walk_frames, write_walk_bag
import box_room
from camera_bags import CameraBag
from neo_ros.bags import BagReader, replay, Section
from neo_ros.bags.bag_info import read_bag_info
from neo_ros.bags.camera_choice import CameraChoice, find_camera
from neo_ros.bags.camera_topics import CAMERA_INFO, find_truth_topic
from neo_ros.bags.demo_bag import write_demo_bag
from neo_ros.bags.qos import LATCHED
from neo_ros.cli.main import app
from neo_ros.errors import BagError, ConfigError, NeoError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.messages import image_fields, read_image
from neo_ros.replaying.bag_replayer import BagReplayer, ReplayOptions
from neo_ros.reports.side_by_side import SideBySide
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest
from tiny_model import write_tiny_model
from typer.testing import CliRunner

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
IMAGE = '/camera/image_raw'
FRAMES = 10


@pytest.fixture(scope='module')
def extrapolator(tmp_path_factory) -> FovExtrapolator:
    path = tmp_path_factory.mktemp('model') / 'm.onnx'
    return FovExtrapolator.load(write_tiny_model(path, EXPANSION), threads=1)


@pytest.fixture(scope='module')
def walk_bag(tmp_path_factory) -> Path:
    """Ten frames at 10 Hz, /tf_static at the start."""
    return write_walk_bag(tmp_path_factory.mktemp('bag') / 'walk', EXPANSION, FRAMES)


def _counts(path: Path) -> Counter[str]:
    with BagReader(path) as bag:
        return Counter(message.topic.name for message in bag.messages())


def _stamps(path: Path, topic: str) -> list[float]:
    with BagReader(path) as bag:
        return [(message.stamp_ns - START_NS) / 1e9 for message in bag.messages([topic])]


def test_a_section_keeps_its_stamps_and_what_is_latched(tmp_path, walk_bag, extrapolator) -> None:
    steps: list[tuple[int, int]] = []
    result = replay(walk_bag, extrapolator, tmp_path / 'out', section=Section(0.25, 0.6),
                    on_progress=lambda *step: steps.append(step))
    assert result.frames == 3
    for topic in (IMAGE, '/camera/wide/image', '/tf'):
        assert _stamps(tmp_path / 'out', topic) == pytest.approx([0.3, 0.4, 0.5])
    # Whoever starts to listen needs it, though it was sent before the section.
    assert _stamps(tmp_path / 'out', '/tf_static') == [0.25]
    assert steps[-1][0] == steps[-1][1] and all(done <= total for done, total in steps)


def test_the_calibration_before_a_section_still_holds(tmp_path, extrapolator) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/camera/camera_info', 0, Intrinsics.from_hfov(32, 24, 1.0))
        for stamp in range(4):
            bag.log_ns = stamp * 1_000_000_000
            bag.image(IMAGE, stamp, np.zeros((24, 32, 3), np.uint8))
    result = replay(tmp_path / 'bag', extrapolator, tmp_path / 'out', section=Section(1.5))
    assert (result.frames, result.rejected) == (0, {'camera': 2})


def test_a_latched_calibration_before_a_section_comes_once(tmp_path, extrapolator) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        topic = bag.add_topic('/camera/camera_info', CAMERA_INFO, (LATCHED,))
        for stamp in range(2):
            bag.info(topic.name, stamp, Intrinsics.from_hfov(32, 24, 1.0))
        bag.log_ns = 2_000_000_000
        bag.image(IMAGE, 2, np.zeros((24, 32, 3), np.uint8))
    result = replay(tmp_path / 'bag', extrapolator, tmp_path / 'out', section=Section(1.5))
    assert result.rejected == {'camera': 1}
    assert _counts(tmp_path / 'out')['/camera/camera_info'] == 1


def test_every_nth_image_is_widened_and_all_are_copied(tmp_path, walk_bag, extrapolator) -> None:
    result = replay(walk_bag, extrapolator, tmp_path / 'out', section=Section(every=4))
    assert result.frames == 3
    assert _stamps(tmp_path / 'out', '/camera/wide/image') == pytest.approx([0, 0.4, 0.8])
    counts = _counts(tmp_path / 'out')
    assert counts[IMAGE] == FRAMES and counts['/camera/wide/mask'] == 3


@pytest.mark.parametrize(('values', 'message'), [
    ((-1.0,), 'start, end: expected 0 <= start < end'), ((2.0, 1.0), 'start < end'),
    ((0.0, None, 0), 'every: expected a number >= 1')], ids=['before', 'empty', 'every 0'])
def test_sections_that_are_none_are_refused(values: tuple, message: str) -> None:
    with pytest.raises(BagError, match=message):
        Section(*values)


def test_a_section_behind_the_end_is_refused(tmp_path, walk_bag, extrapolator) -> None:
    with pytest.raises(BagError, match=r'expected less than the 0.900 s of the bag, got 5'):
        replay(walk_bag, extrapolator, tmp_path / 'out', section=Section(5.0))
    assert not (tmp_path / 'out').exists()


def test_compressed_images_are_widened_like_raw_ones(tmp_path, extrapolator) -> None:
    images = [EXPANSION.crop(wide) for _, wide, _ in walk_frames(EXPANSION, 3)]
    for compressed, topic in ((False, IMAGE), (True, f'{IMAGE}/compressed')):
        with CameraBag(tmp_path / f'bag{compressed}') as bag:
            bag.info('/camera/camera_info', 0, EXPANSION.source)
            for stamp, image in enumerate(images):
                bag.image(topic, stamp, image, compressed=compressed)
            if compressed:  # One that is cut off.
                bag.send(topic, 'sensor_msgs/msg/CompressedImage', 9, format='png',
                         header=bag.header(9, ''), data=np.frombuffer(b'\x89PNG\r\n', np.uint8))
        result = replay(tmp_path / f'bag{compressed}', extrapolator,
                        tmp_path / f'out{compressed}')
        assert (result.frames, result.rejected) == (
            3, {'encoding': 1} if compressed else {})
    outs = []
    for compressed in (False, True):
        with BagReader(tmp_path / f'out{compressed}') as bag:
            outs.append([read_image(m.read()) for m in bag.messages(['/camera/wide/image'])])
    np.testing.assert_array_equal(outs[0], outs[1])


def test_raw_images_are_taken_before_compressed_ones(tmp_path, extrapolator) -> None:
    image = np.zeros((24, 32, 3), np.uint8)
    with CameraBag(tmp_path / 'bag') as bag:
        bag.image(IMAGE, 1, image)
        bag.image(f'{IMAGE}/compressed', 1, image, compressed=True)
    with BagReader(tmp_path / 'bag') as reader:
        assert find_camera(reader, EXPANSION.source).image.name == IMAGE
        found = find_camera(reader, EXPANSION.source, CameraChoice(f'{IMAGE}/compressed'))
        assert (found.image.name, found.wide) == (f'{IMAGE}/compressed', '/camera/wide')


def test_truth_is_found_by_its_size_but_not_in_what_a_model_made(
        tmp_path, walk_bag, extrapolator) -> None:
    replay(walk_bag, extrapolator, tmp_path / 'out')
    with BagReader(tmp_path / 'out') as reader:
        camera = find_camera(reader, EXPANSION.source).image
        truth = find_truth_topic(reader, camera,
                                 (EXPANSION.target.width, EXPANSION.target.height))
        assert truth is not None and truth.name == '/camera/wide/image_raw'


def test_what_a_model_made_is_no_truth_without_its_mask(tmp_path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.image(IMAGE, 1, np.zeros((24, 32, 3), np.uint8))
        bag.image('/camera/wide/image', 1, np.zeros((48, 64, 3), np.uint8))
    with BagReader(tmp_path / 'bag') as reader:
        camera = find_camera(reader, EXPANSION.source).image
        assert find_truth_topic(reader, camera, (64, 48)) is None
    # A camera that is called wide is one.
    with CameraBag(tmp_path / 'other') as bag:
        bag.image('/front/wide/image', 1, np.zeros((24, 32, 3), np.uint8))
    with BagReader(tmp_path / 'other') as reader:
        assert find_camera(reader, EXPANSION.source).image.name == '/front/wide/image'


@pytest.mark.parametrize(('frame', 'late_ns', 'found'), [
    ('optical', 0, True), ('/optical', 0, True), ('rear', 0, False), ('optical', 1, False)],
    ids=['its own', 'of ROS 1', 'of another camera', 'other stamps'])
def test_truth_has_frame_and_stamps_of_the_camera(
        tmp_path: Path, frame: str, late_ns: int, found: bool) -> None:
    expansion = ViewExpansion.to_size(Intrinsics.from_hfov(64, 64, math.pi / 2), 128, 128)
    with CameraBag(tmp_path / 'bag') as bag:
        for stamp in (10, 20, 30):
            bag.image(IMAGE, stamp, np.zeros((64, 64, 3), np.uint8))
            for compressed in (False, True)[:1 + found]:  # A copy is no second truth.
                bag.image('/any/image' + '/compressed' * compressed, stamp + late_ns,
                          np.zeros((128, 128, 3), np.uint8), frame, compressed)
    with BagReader(tmp_path / 'bag') as reader:
        truth = find_truth_topic(reader, find_camera(reader, expansion.source).image,
                                 (128, 128))
    assert (truth.name if truth is not None else None) == ('/any/image' if found else None)
    info = read_bag_info(tmp_path / 'bag', Path('m.onnx'), expansion)
    assert info.next.endswith('--truth-topic /any/image' if found else '--score')
    replayer = BagReplayer(write_tiny_model(tmp_path / 'm.onnx', expansion))
    replayed = replayer.replay(tmp_path / 'bag', tmp_path / 'out', ReplayOptions(score=True))
    assert replayed.scores is not None and len(replayed.scores.rows) == 3
    assert (replayed.truth_topic is not None) == found


def test_an_error_of_a_callback_ends_the_replay(tmp_path, walk_bag, extrapolator) -> None:
    def fail(stamp_ns: int, image: np.ndarray, wide_image: np.ndarray) -> None:
        raise NeoError('disk full')

    with pytest.raises(NeoError, match='disk full'):
        replay(walk_bag, extrapolator, tmp_path / 'out', on_frame=fail)


def test_the_video_shows_camera_and_wide_view_in_time(tmp_path, walk_bag, extrapolator) -> None:
    path = tmp_path / 'new' / 'walk.mp4'
    with SideBySide(path, EXPANSION) as video:
        replay(walk_bag, extrapolator, tmp_path / 'out', section=Section(every=3),
               on_frame=video.add)
    with av.open(str(path)) as file:
        frames = list(file.decode(video=0))
    assert [frame.time for frame in frames] == pytest.approx([0, 0.3, 0.6, 0.9], abs=1e-3)
    picture = frames[1].to_ndarray(format='rgb24').astype(int)
    assert picture.shape == (48, 128, 3)
    truth = walk_frames(EXPANSION, FRAMES)[3][1]
    seen = EXPANSION.crop(truth)[4:-4, 4:-4].astype(int)  # Away from the drawn outline.
    for left in (0, 64):
        shown = EXPANSION.crop(picture[:, left:left + 64])[4:-4, 4:-4]
        # Colours are stored at half the resolution.
        assert np.abs(shown.mean(axis=2) - seen.mean(axis=2)).mean() < 12


def test_stamps_that_go_back_do_not_stop_the_video(tmp_path) -> None:
    image = np.zeros((24, 32, 3), np.uint8)
    wide = np.full((48, 64, 3), 200, np.uint8)
    with SideBySide(tmp_path / 'a.mp4', EXPANSION) as video:
        for stamp in (5_000_000_000, 4_000_000_000, 4_000_000_000, 6_000_000_000):
            video.add(stamp, image, wide)
    with av.open(str(tmp_path / 'a.mp4')) as file:
        assert len(list(file.decode(video=0))) == 4
    with SideBySide(tmp_path / 'none.mp4', EXPANSION):
        pass
    assert not (tmp_path / 'none.mp4').exists()
    with pytest.raises(NeoError, match='cannot write the video'):
        SideBySide(tmp_path / 'a.mp4' / 'b.mp4', EXPANSION)


def test_a_wider_camera_is_resampled_to_the_models(tmp_path, extrapolator) -> None:
    larger = Intrinsics.from_hfov(64, 48, 1.8)
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/camera/camera_info', 0, larger)
        bag.send(IMAGE, 'sensor_msgs/msg/Image', 1, header=bag.header(1, 'eye'),
                 **image_fields(np.full((48, 64, 3), 90, np.uint8)))
    frames: list[np.ndarray] = []
    result = replay(tmp_path / 'bag', extrapolator, tmp_path / 'out',
                    on_frame=lambda stamp_ns, image, wide: frames.append(image))
    assert (result.frames, result.rejected) == (1, {})
    assert frames[0].shape == (24, 32, 3) and (frames[0] == 90).all()


def test_a_calibration_that_is_not_beside_the_images_may_be_named(
        tmp_path, extrapolator) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/eye/info', 0, Intrinsics.from_hfov(64, 48, 1.8))
        bag.send(IMAGE, 'sensor_msgs/msg/Image', 1, header=bag.header(1, 'eye'),
                 **image_fields(np.full((48, 64, 3), 90, np.uint8)))
    alone = replay(tmp_path / 'bag', extrapolator, tmp_path / 'a', CameraChoice(IMAGE))
    assert not alone.frames
    found = replay(tmp_path / 'bag', extrapolator, tmp_path / 'b',
                   CameraChoice(IMAGE, '/eye/info'))
    assert (found.frames, found.rejected) == (1, {})
    assert '/eye/wide/image' in _counts(tmp_path / 'b')
    with pytest.raises(BagError, match='--info-topic: expected a .*CameraInfo on /none'):
        replay(tmp_path / 'bag', extrapolator, tmp_path / 'c', CameraChoice(IMAGE, '/none'))


CALIBRATION = """
image_width: 64
image_height: 48
camera_name: eye
camera_matrix: {rows: 3, cols: 3, data: [25.4, 0, 31.5, 0, 25.4, 23.5, 0, 0, 1]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.02, 0, 0, 0, 0]}
"""


def test_a_calibration_may_come_from_a_file(tmp_path, extrapolator) -> None:
    """It also stands instead of a camera_info that is wrong."""
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/camera/camera_info', 0, Intrinsics.from_hfov(64, 48, 0.3))
        bag.send(IMAGE, 'sensor_msgs/msg/Image', 1, header=bag.header(1, 'eye'),
                 **image_fields(np.full((48, 64, 3), 90, np.uint8)))
    file = tmp_path / 'eye.yaml'
    file.write_text(CALIBRATION)
    found = [replay(tmp_path / 'bag', extrapolator, tmp_path / f'{rectify}',
                    CameraChoice(camera_info=file, rectify=rectify)) for rectify in (False, True)]
    assert [one.frames for one in found] == [0, 1]
    assert 'distortion [-0.02' in found[0].words['camera_info']
    assert '/camera/wide/image' in _counts(tmp_path / 'True')
    file.write_text('image_width: 64\n')
    with pytest.raises(ConfigError, match='--camera-info .*eye.yaml: expected camera_calib.*got '
                                          'image_width'):
        replay(tmp_path / 'bag', extrapolator, tmp_path / 'out', CameraChoice(camera_info=file))
    assert not (tmp_path / 'out').exists()
    with pytest.raises(ConfigError, match='expected one of them, got both'):
        CameraChoice(info_topic='/camera/camera_info', camera_info=file)


def test_a_replay_that_is_refused_leaves_the_video_of_the_last_one(
        tmp_path, walk_bag) -> None:
    model_file = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    video = tmp_path / 'walk.mp4'
    arguments = ['replay', str(walk_bag), '--model', str(model_file), '--out',
                 str(tmp_path / 'out'), '--side-by-side', str(video)]
    assert CliRunner().invoke(app, arguments).exit_code == 0
    content = video.read_bytes()
    assert CliRunner().invoke(app, arguments).exit_code != 0
    assert video.read_bytes() == content and not list(tmp_path.glob('*.partial'))


def test_a_video_does_not_lie_in_the_new_bag(tmp_path, walk_bag) -> None:
    model_file, out = write_tiny_model(tmp_path / 'm.onnx', EXPANSION), tmp_path / 'out'
    result = CliRunner().invoke(app, [
        'replay', str(walk_bag), '--model', str(model_file), '--out', str(out),
        '--side-by-side', str(out / 'video' / 'walk.mp4')])
    assert '--side-by-side: expected a file outside of' in str(result.exception)
    assert not out.exists()


def test_the_share_that_the_memory_guided_is_told(tmp_path) -> None:
    poses = box_room.box_walk(3)
    wide = [box_room.view(pose, box_room.EXPANSION.target)[0] for pose in poses]
    # The last image is of elsewhere.
    wide[2] = np.random.default_rng(0).integers(0, 256, wide[2].shape, np.uint8)
    write_demo_bag(tmp_path / 'bag', zip([START_NS, START_NS + 1, START_NS + 2], wide, poses),
                   box_room.EXPANSION)
    model_file = box_room.write_box_model(tmp_path)
    result = CliRunner().invoke(app, [
        'replay', str(tmp_path / 'bag'), '--model', str(model_file), '--score', '--out',
        str(tmp_path / 'out')])
    assert result.exit_code == 0, result.output
    assert 'guided: the memory knew 67% of the frames' in result.output
    assert json.loads((tmp_path / 'out' / 'scores.json').read_text())['guided'] == 0.6667


def test_a_model_without_a_memory_says_nothing_of_it(tmp_path, walk_bag) -> None:
    model_file = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    result = CliRunner().invoke(app, ['replay', str(walk_bag), '--model', str(model_file),
                                      '--score', '--out', str(tmp_path / 'out')])
    assert result.exit_code == 0, result.output
    assert 'guided' not in result.output
    assert json.loads((tmp_path / 'out' / 'scores.json').read_text())['guided'] is None


def test_depth_images_are_no_camera(tmp_path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.image('/cam/color/image_raw', 0, np.zeros((24, 32, 3), np.uint8))
        bag.send('/cam/aligned_depth/image_raw', 'sensor_msgs/msg/Image', 0, height=24, width=32,
                 header=bag.header(0, 'optical'), encoding='16UC1', is_bigendian=0, step=64,
                 data=np.zeros(24 * 64, np.uint8))
        for name in ('color', 'aligned_depth'):
            bag.info(f'/cam/{name}/camera_info', 0, EXPANSION.source)
    with BagReader(tmp_path / 'bag') as reader:
        assert find_camera(reader, EXPANSION.source).image.name == '/cam/color/image_raw'
        named = find_camera(reader, EXPANSION.source,
                            CameraChoice('/cam/aligned_depth/image_raw'))
        assert named.image.name == '/cam/aligned_depth/image_raw'
