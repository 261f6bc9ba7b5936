"""`neo bag-info`: rates, gaps, cameras, roles and the next command, on bags of several kinds."""
import json
import math
from pathlib import Path
import shlex

from bag_files import START_NS, write_walk_bag
from camera_bags import CameraBag
from mcap.writer import Writer as McapWriter
from neo_ros.bags import BagReader, BagWriter
from neo_ros.bags.bag_info import BagInfo, read_bag_info, TopicInfo
from neo_ros.bags.camera_topics import find_image_topic
from neo_ros.captures.bag import BagOptions, read_bag_capture
from neo_ros.cli.main import app
from neo_ros.errors import BagError
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
import numpy as np
import pytest
from tiny_model import write_tiny_model
from typer.testing import CliRunner

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
IMAGE, TRUTH = '/camera/image_raw', '/camera/wide/image_raw'


@pytest.fixture(scope='module')
def walk_bag(tmp_path_factory) -> Path:
    return write_walk_bag(tmp_path_factory.mktemp('bags') / 'walk', EXPANSION, 11)


def _topic(info: BagInfo, name: str) -> TopicInfo:
    found, = [topic for topic in info.topics if topic.name == name]
    return found


def test_a_recorded_walk_is_described(walk_bag: Path) -> None:
    info = read_bag_info(walk_bag)
    assert (info.start_ns, info.messages, info.damages, info.notes) == (START_NS, 56, [], [])
    assert info.seconds == pytest.approx(1.0)
    image = _topic(info, IMAGE)
    assert (image.count, image.rate_hz, image.longest_gap_s) == (
        11, pytest.approx(10), pytest.approx(0.1))
    assert image.content == '32x24 rgb8, frame camera_optical_frame'
    assert 11 * 32 * 24 * 3 < image.bytes < 11 * (32 * 24 * 3 + 200)
    assert _topic(info, '/camera/camera_info').content.startswith('32x24 pinhole, 90.0 x 73.7 deg')
    assert _topic(info, '/odom').content == 'base_link in odom'
    assert {topic.name: topic.roles for topic in info.topics if topic.roles} == {
        IMAGE: ['image'], TRUTH: ['image', 'truth'], '/tf': ['pose']}
    assert _topic(info, '/tf_static').rate_hz is None


@pytest.mark.slow
def test_the_next_command_is_one_that_exists(walk_bag: Path, tmp_path: Path) -> None:
    plain = shlex.split(read_bag_info(walk_bag).next)
    assert plain == ['neo', 'import', str(walk_bag), 'out/scenes/walk', '--image-topic', IMAGE]
    model = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    with_model = shlex.split(read_bag_info(walk_bag, model, EXPANSION).next)
    assert with_model[:6] == ['neo', 'replay', str(walk_bag), '--model', str(model), '--out']
    assert with_model[-2:] == ['--truth-topic', TRUTH]
    with_model[6] = str(tmp_path / 'out')
    result = CliRunner().invoke(app, with_model[1:])
    assert result.exit_code == 0, result.output
    assert (tmp_path / 'out' / 'scores.csv').is_file()


def test_a_gap_and_a_lack_of_poses_are_told(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        for stamp in (0, 100, 200, 1700, 1800):
            bag.log_ns = stamp * 1_000_000
            bag.image(IMAGE, stamp, np.zeros((24, 32, 3), np.uint8), compressed=True)
    info = read_bag_info(tmp_path / 'bag')
    assert _topic(info, IMAGE).longest_gap_s == pytest.approx(1.5)
    assert _topic(info, IMAGE).rate_hz == pytest.approx(4 / 1.8)
    assert _topic(info, IMAGE).content == '32x24 png, frame optical'
    assert ['no camera_info' in note or 'no poses' in note for note in info.notes] == [True] * 2


@pytest.mark.parametrize('zeros', [
    {'k': np.zeros(9), 'p': np.zeros(12)}, {'width': 0, 'height': 0}], ids=['matrix', 'size'])
def test_a_camera_info_of_zeros_is_told_and_not_proposed(
        tmp_path: Path, zeros: dict[str, object]) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        for stamp in range(3):
            bag.info('/eye/camera_info', stamp, EXPANSION.source, **zeros)
            bag.image('/eye/image', stamp, np.zeros((24, 32, 3), np.uint8))
            bag.pose('/slam/pose', stamp, np.eye(4))
    info = read_bag_info(tmp_path / 'bag')
    assert _topic(info, '/eye/camera_info').content == 'not calibrated'
    assert info.notes == ['/eye/camera_info is not calibrated: an import with poses and a replay '
                          'need a calibration; give a file with --camera-info; an import without '
                          'poses estimates the camera']
    assert info.next.endswith('out/scenes/bag --pose-topic none')
    words = shlex.split(info.next)
    read = read_bag_capture(Path(words[2]), BagOptions(pose_topic=words[-1]))
    assert not read.posed and read.frames[0].lens is None


def test_transforms_that_do_not_reach_the_camera_are_told(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        for stamp in range(3):
            bag.image('/eye/image', stamp, np.zeros((24, 32, 3), np.uint8))
            bag.tf('/tf', stamp, 'odom', 'base_link', CameraPose.from_planar(
                stamp, 0, 0, 0).T_world_cam)
    assert '/tf moves base_link; expected /tf_static' in read_bag_info(tmp_path / 'bag').notes[-1]


def test_several_pose_topics_are_named_in_the_command(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/eye/camera_info', 0, EXPANSION.source)
        for stamp in range(3):
            bag.image('/eye/image', stamp, np.zeros((24, 32, 3), np.uint8))
            bag.pose('/slam/pose', stamp, np.eye(4))
        bag.pose('/goal', 5, np.eye(4))
    info = read_bag_info(tmp_path / 'bag')
    assert _topic(info, '/slam/pose').roles == ['pose'] and _topic(info, '/goal').roles == []
    assert info.next.endswith('out/scenes/bag --pose-topic /slam/pose')


def test_a_frame_with_two_parents_is_told_and_another_topic_chosen(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/eye/camera_info', 0, EXPANSION.source)
        for stamp, parent in enumerate(('map', 'odom')):
            bag.image('/eye/image', stamp, np.zeros((24, 32, 3), np.uint8))
            bag.tf('/tf', stamp, parent, 'optical', np.eye(4))
            bag.odometry('/odom', stamp, 'optical', np.eye(4))
    info = read_bag_info(tmp_path / 'bag')
    assert info.notes[0].startswith(
        "/tf: expected one parent of the frame 'optical', got 'map' and 'odom'")
    assert info.next.endswith('out/scenes/bag --pose-topic /odom')


@pytest.mark.parametrize(('topic', 'rectifies'), [('image_raw', True), ('image_rect', False)])
def test_a_replay_of_a_distorted_camera_takes_the_distortion_out(
        tmp_path: Path, topic: str, rectifies: bool) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/eye/camera_info', 0, EXPANSION.source, d=np.array([-0.05, 0, 0, 0, 0]))
        bag.image(f'/eye/{topic}', 1, np.zeros((24, 32, 3), np.uint8))
    model = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    command = shlex.split(read_bag_info(tmp_path / 'bag', model, EXPANSION).next)
    assert ('--rectify' in command) == rectifies
    command[command.index('--out') + 1] = str(tmp_path / 'out')
    assert command.pop() == '--score'  # These images are too small for it.
    result = CliRunner().invoke(app, command[1:])
    assert 'rejected' not in result.output and result.exit_code == 0, result.output


def test_damage_is_counted_and_the_rest_described(walk_bag: Path, tmp_path: Path) -> None:
    file = tmp_path / 'cut.mcap'
    content = next(walk_bag.glob('*.mcap')).read_bytes()
    file.write_bytes(content[:len(content) // 2])
    info = read_bag_info(file)
    assert 0 < info.messages < 56
    assert info.damages[0].startswith(f'cut.mcap: {info.messages} messages recovered, an unknown')
    assert _topic(info, IMAGE).roles == ['image']


def test_bags_without_messages_or_images(tmp_path: Path) -> None:
    with BagWriter(tmp_path / 'empty') as writer:
        writer.add_topic('/text', 'std_msgs/msg/String')
    with pytest.raises(BagError, match='expected messages'):
        read_bag_info(tmp_path / 'empty')
    with CameraBag(tmp_path / 'blind') as bag:
        bag.pose('/pose', 0, np.eye(4))
    info = read_bag_info(tmp_path / 'blind')
    assert info.next == '' and 'no images' in info.notes[0]


def test_the_command_prints_a_table_or_json(walk_bag: Path) -> None:
    result = CliRunner().invoke(app, ['bag-info', str(walk_bag)])
    assert result.exit_code == 0, result.output
    for text in (IMAGE, '10.0', 'image, truth', 'Next: neo import'):
        assert text in result.output
    result = CliRunner().invoke(app, ['bag-info', str(walk_bag), '--json'])
    assert json.loads(result.output)['messages'] == 56


@pytest.mark.parametrize('frame, option', [
    ('optical', ['--info-topic', '/eye/camera_info_rect']),
    ('elsewhere', ['--pose-topic', 'none'])])
def test_a_calibration_that_is_not_beside_the_images_is_proposed_where_its_frame_fits(
        tmp_path: Path, frame: str, option: list[str]) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/eye/camera_info_rect', 0, EXPANSION.source)
        for stamp in range(3):
            bag.image('/eye/image_rect', stamp, np.zeros((24, 32, 3), np.uint8), frame)
            bag.pose('/slam/pose', stamp, CameraPose.from_planar(stamp, 0, 1, 0).T_world_cam)
    info = read_bag_info(tmp_path / 'bag')
    assert '/eye/camera_info_rect' in info.notes[0] and '--camera-info' in info.notes[0]
    command = shlex.split(info.next)
    assert command[-2:] == option
    if frame == 'optical':
        command[3] = str(tmp_path / 'scene')
        result = CliRunner().invoke(app, command[1:])
        assert result.exit_code == 0, result.output


def test_a_replay_is_proposed_with_the_calibration_that_was_found(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'drive_2024.05.01') as bag:
        bag.info('/eye/info_raw', 0, Intrinsics.from_hfov(64, 48, 2.0), d=np.full(5, 1e-3))
        bag.image('/eye/image_raw', 1, np.zeros((48, 64, 3), np.uint8))
    model = write_tiny_model(tmp_path / 'm.onnx', EXPANSION)
    command = shlex.split(read_bag_info(tmp_path / 'drive_2024.05.01', model, EXPANSION).next)
    assert command[5:-1] == [
        '--out', 'out/drive_2024.05.01_wide', '--image-topic', '/eye/image_raw', '--info-topic',
        '/eye/info_raw', '--rectify']
    command[6] = str(tmp_path / 'out')
    assert command.pop() == '--score'  # These images are too small for it.
    result = CliRunner().invoke(app, command[1:])
    assert result.exit_code == 0, result.output


def test_two_drives_of_one_month_become_two_scenes(tmp_path: Path) -> None:
    for day in ('01', '02'):
        with CameraBag(tmp_path / f'drive_2024.05.{day}') as bag:
            bag.image(IMAGE, 1, np.zeros((24, 32, 3), np.uint8))
        for path in (bag.path, bag.path / f'{bag.path.name}.mcap'):
            assert f'out/scenes/drive_2024.05.{day} ' in read_bag_info(path).next + ' '


def test_depth_is_told_by_its_encoding_not_by_a_name(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        for stamp in range(2):
            bag.image('/depth_camera/image_raw', stamp, np.zeros((24, 32, 3), np.uint8))
            for name, encoding, size in (('/a', '16UC1', 2), ('/b', '32FC1', 4)):
                bag.send(name, 'sensor_msgs/msg/Image', stamp, header=bag.header(stamp, 'optical'),
                         height=24, width=32, encoding=encoding, is_bigendian=0, step=32 * size,
                         data=np.zeros(24 * 32 * size, np.uint8))
            bag.send('/c/compressedDepth', 'sensor_msgs/msg/CompressedImage', stamp,
                     header=bag.header(stamp, 'optical'), format='16UC1; compressedDepth png',
                     data=np.zeros(20, np.uint8))
    info = read_bag_info(tmp_path / 'bag')
    # Raw comes before compressed, and one topic is enough.
    assert {topic.name: topic.roles for topic in info.topics if topic.roles} == {
        '/depth_camera/image_raw': ['image'], '/a': ['depth']}
    assert '32x24 32FC1 depth, frame optical' in [topic.content for topic in info.topics]
    assert '--image-topic' not in info.next


@pytest.mark.parametrize('encoding', ['json', 'ros1', 'protobuf'])
def test_images_that_cannot_be_read_are_named_where_they_are_wanted(
        tmp_path: Path, encoding: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('neo_ros.bags.topic.has_protobuf', lambda: False)
    name = 'foxglove.CompressedImage' if encoding == 'protobuf' else 'sensor_msgs/Image'
    with (tmp_path / 'a.mcap').open('wb') as file:
        writer = McapWriter(file)
        writer.start()
        channel = writer.register_channel(
            '/eye', encoding, writer.register_schema(name, 'any', b''))
        writer.add_message(channel, 1, b'{}', 1)
        writer.finish()
    advice = {'json': "only Foxglove's images", 'ros1': 'rosbags-convert',
              'protobuf': r"pip install 'neo_ros\[foxglove\]'"}[encoding]
    for topic in (None, '/eye'):
        with pytest.raises(BagError, match=f'/eye .{name} as {encoding}.*not read: .*{advice}'):
            read_bag_capture(tmp_path / 'a.mcap', BagOptions(topic))


def test_what_a_model_made_is_proposed_as_no_camera(tmp_path: Path) -> None:
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/camera/wide/camera_info', 0, EXPANSION.target)
        for stamp in range(3):
            bag.image('/camera/image_raw', stamp, np.zeros((24, 32, 3), np.uint8))
            bag.image('/camera/wide/image', stamp, np.zeros((48, 64, 3), np.uint8))
            for name in ('mask', 'confidence'):
                bag.image(f'/camera/wide/{name}', stamp, np.zeros((48, 64), np.uint8))
    info = read_bag_info(tmp_path / 'bag')
    assert {topic.name: topic.roles for topic in info.topics if topic.roles} == {
        '/camera/image_raw': ['image']}
    content = {topic.name: topic.content for topic in info.topics}
    assert content['/camera/wide/mask'] == content['/camera/wide/image'] == 'made by a model'
    with BagReader(tmp_path / 'bag') as reader:
        assert find_image_topic(reader, None).name == '/camera/image_raw'
        # Whoever names one gets it.
        assert find_image_topic(reader, '/camera/wide/mask').name == '/camera/wide/mask'
