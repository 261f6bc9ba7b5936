"""Replay: the extrapolator's pixels beside everything that was in the bag."""
import math
from pathlib import Path

from bag_files import START_NS, walk_frames, write_walk_bag
from neo_ros.bags import BagReader, BagWriter, replay
from neo_ros.bags.camera_choice import CameraChoice
from neo_ros.errors import BagError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.messages import camera_info_fields, image_fields, read_camera_info, read_image
from neo_ros.runtime import FovExtrapolator
import numpy as np
import pytest
from tiny_model import write_tiny_model

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
IMAGE, TRUTH = '/camera/image_raw', '/camera/wide/image_raw'
WIDE = {'/camera/wide/image', '/camera/wide/mask', '/camera/wide/confidence',
        '/camera/wide/camera_info'}
TOLD = {'/camera/wide/status', '/diagnostics'}
IMAGE_TYPE, INFO_TYPE = 'sensor_msgs/msg/Image', 'sensor_msgs/msg/CameraInfo'


@pytest.fixture(scope='module')
def extrapolator(tmp_path_factory) -> FovExtrapolator:
    path = tmp_path_factory.mktemp('model') / 'm.onnx'
    return FovExtrapolator.load(write_tiny_model(path, EXPANSION), threads=1)


@pytest.fixture(scope='module')
def walk_bag(tmp_path_factory) -> Path:
    return write_walk_bag(tmp_path_factory.mktemp('bag') / 'walk', EXPANSION, 6)


def _contents(path: Path) -> dict[str, list[tuple[int, bytes]]]:
    contents: dict[str, list[tuple[int, bytes]]] = {}
    with BagReader(path) as bag:
        for message in bag.messages():
            contents.setdefault(message.topic.name, []).append((message.stamp_ns, message.cdr))
    return contents


def _read(path: Path, topic: str) -> list:
    with BagReader(path) as bag:
        return [(message.stamp_ns, message.read()) for message in bag.messages([topic])]


def _write_images(path: Path, images, topic: str = IMAGE, infos=()) -> Path:
    """Write (stamp, fields of an Image) and (stamp, fields of a CameraInfo)."""
    with BagWriter(path) as writer:
        types = writer.typestore.types
        topics = {IMAGE_TYPE: writer.add_topic(topic, IMAGE_TYPE)}
        if infos:
            name = topic.rpartition('/')[0] + '/camera_info'
            topics[INFO_TYPE] = writer.add_topic(name, INFO_TYPE)
        roi = types['sensor_msgs/msg/RegionOfInterest'](0, 0, 0, 0, False)
        for stamp, msgtype, fields in sorted(
                [(stamp, INFO_TYPE, fields) for stamp, fields in infos]
                + [(stamp, IMAGE_TYPE, fields) for stamp, fields in images],
                key=lambda entry: entry[:2]):
            if msgtype == INFO_TYPE:
                fields = {'binning_x': 0, 'binning_y': 0, 'roi': roi, **fields}
            time = types['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9))
            header = types['std_msgs/msg/Header'](stamp=time, frame_id='eye')
            writer.write(topics[msgtype], stamp, types[msgtype](header=header, **fields))
    return path


def _good(seed: int) -> dict:
    image = np.random.default_rng(seed).integers(0, 256, (24, 32, 3), np.uint8)
    return image_fields(image)


@pytest.mark.slow
def test_output_has_the_wide_view_and_everything_that_was_there(
        tmp_path, walk_bag, extrapolator) -> None:
    result = replay(walk_bag, extrapolator, tmp_path / 'out')
    assert (result.image_topic, result.frames, result.rejected) == (IMAGE, 6, {})
    before, after = _contents(walk_bag), _contents(tmp_path / 'out')
    assert set(after) == set(before) | WIDE | TOLD
    assert {name: after[name] for name in before} == before
    mask = EXPANSION.extrapolated_mask
    inputs = _read(walk_bag, IMAGE)
    for i, (stamp_ns, source) in enumerate(inputs):
        expected = extrapolator.expand(read_image(source))
        for name in WIDE:
            log_ns, message = _read(tmp_path / 'out', name)[i]
            assert log_ns == stamp_ns
            assert message.header.stamp == source.header.stamp
            assert message.header.frame_id == source.header.frame_id
            if name.endswith('camera_info'):
                assert read_camera_info(message) == EXPANSION.target
            elif name.endswith('mask'):
                assert message.encoding == 'mono8'
                np.testing.assert_array_equal(
                    message.data.reshape(mask.shape), np.where(mask, 255, 0))
            elif name.endswith('confidence'):
                np.testing.assert_array_equal(
                    message.data.reshape(mask.shape), expected.confidence)
            else:
                np.testing.assert_array_equal(read_image(message), expected.wide_image)


def test_two_replays_are_bit_identical(tmp_path, walk_bag, extrapolator) -> None:
    replay(walk_bag, extrapolator, tmp_path / 'first')
    replay(walk_bag, extrapolator, tmp_path / 'second')
    assert _contents(tmp_path / 'first') == _contents(tmp_path / 'second')


def test_without_copy_only_the_wide_topics_are_written(tmp_path, walk_bag, extrapolator) -> None:
    replay(walk_bag, extrapolator, tmp_path / 'out', copy=False)
    assert set(_contents(tmp_path / 'out')) == WIDE | TOLD


def test_a_replay_of_a_replay_replaces_the_wide_topics(tmp_path, walk_bag, extrapolator) -> None:
    replay(walk_bag, extrapolator, tmp_path / 'first')
    replay(tmp_path / 'first', extrapolator, tmp_path / 'second')
    assert _contents(tmp_path / 'first') == _contents(tmp_path / 'second')


def test_pairs_are_truth_and_prediction_of_one_stamp(tmp_path, walk_bag, extrapolator) -> None:
    pairs: list[tuple[int, np.ndarray, np.ndarray]] = []
    steps: list[tuple[int, int]] = []
    result = replay(walk_bag, extrapolator, tmp_path / 'out', truth_topic=TRUTH,
                    on_pair=lambda *pair: pairs.append(pair),
                    on_progress=lambda *step: steps.append(step))
    frames = walk_frames(EXPANSION, 6)
    assert result.pairs == len(pairs) == len(frames)
    for (stamp_ns, truth, wide_image), frame in zip(pairs, frames):
        assert stamp_ns == frame[0]
        np.testing.assert_array_equal(truth, frame[1])
        np.testing.assert_array_equal(EXPANSION.crop(wide_image), EXPANSION.crop(frame[1]))
        assert (wide_image != truth).any()
    assert steps == [(i, 31) for i in range(1, 32)]  # 6 frames of 5 messages and /tf_static


def test_rejected_images_are_counted_by_reason_and_the_rest_goes_on(
        tmp_path, extrapolator) -> None:
    good = _good(0)
    bad = [{**good, 'encoding': '16UC1'}, {**good, 'step': 5}, {**good, 'step': 5},
           {**good, 'data': good['data'][:0]}, image_fields(np.zeros((24, 40, 3), np.uint8))]
    images = [(START_NS + i, fields) for i, fields in enumerate([good, *bad, _good(1)])]
    bag = _write_images(tmp_path / 'bag', images)
    result = replay(bag, extrapolator, tmp_path / 'out')
    assert result.frames == 2
    assert result.rejected == {'encoding': 1, 'step': 2, 'empty': 1, 'size': 1}
    stamps = [stamp for stamp, _ in _read(tmp_path / 'out', '/camera/wide/image')]
    assert stamps == [START_NS, START_NS + 6]
    assert len(_contents(tmp_path / 'out')[IMAGE]) == 7


def test_a_broken_message_is_counted(tmp_path, extrapolator) -> None:
    bag = _write_images(tmp_path / 'bag', [(START_NS, _good(0))])
    with BagReader(bag) as reader, BagWriter(tmp_path / 'broken') as writer:
        message, = reader.messages()
        writer.copy_topic(message.topic)
        writer.write_cdr(message.topic, START_NS, message.cdr)
        writer.write_cdr(message.topic, START_NS + 1, message.cdr[:50])
    result = replay(tmp_path / 'broken', extrapolator, tmp_path / 'out')
    assert (result.frames, result.rejected, set(result.words)) == (1, {'cdr': 1}, {'cdr'})


def test_images_of_another_camera_are_rejected_until_it_is_the_right_one(
        tmp_path, extrapolator) -> None:
    narrow = camera_info_fields(Intrinsics.from_hfov(32, 24, 1.0))
    right = camera_info_fields(EXPANSION.source)
    bag = _write_images(
        tmp_path / 'bag', [(START_NS + i, _good(i)) for i in range(5)],
        infos=[(START_NS, narrow), (START_NS + 3, right)])
    result = replay(bag, extrapolator, tmp_path / 'out')
    assert (result.frames, result.rejected) == (2, {'camera': 3})


def test_images_before_the_first_camera_info_are_of_its_camera(tmp_path, extrapolator) -> None:
    narrow = camera_info_fields(Intrinsics.from_hfov(32, 24, 1.0))
    bag = _write_images(tmp_path / 'bag', [(START_NS, _good(0)), (START_NS + 2, _good(1))],
                        infos=[(START_NS + 1, narrow)])
    result = replay(bag, extrapolator, tmp_path / 'out')
    assert (result.frames, result.rejected) == (0, {'camera': 2})


def test_rectified_images_beside_the_camera_info_of_the_raw_ones_are_taken(
        tmp_path, extrapolator) -> None:
    straight = camera_info_fields(EXPANSION.source)
    info = camera_info_fields(Intrinsics(32, 24, 20, 20, 15, 13)) | {
        'd': np.full(5, 0.1), 'r': np.diag([1.0, -1, -1]).reshape(-1), 'p': straight['p']}
    for topic, rejected in (('image_rect', {}), ('image_raw', {'camera_info': 1})):
        bag = _write_images(tmp_path / topic, [(START_NS + 1, _good(0))], f'/camera/{topic}',
                            [(START_NS, info)])
        result = replay(bag, extrapolator, tmp_path / f'{topic}_wide')
        assert result.rejected == rejected
        assert 'rectify' in result.words.get('camera_info', 'rectify')
    (_, wide), = _read(tmp_path / 'image_rect_wide', '/camera/wide/camera_info')
    for name, value in camera_info_fields(EXPANSION.target).items():
        assert np.array_equal(getattr(wide, name), value), name


def test_without_camera_info_the_wide_camera_is_the_models(tmp_path, extrapolator) -> None:
    bag = _write_images(tmp_path / 'bag', [(START_NS, _good(0))], topic='/picture')
    replay(bag, extrapolator, tmp_path / 'out')
    (_, info), = _read(tmp_path / 'out', '/wide/camera_info')
    assert read_camera_info(info) == EXPANSION.target
    assert info.header.frame_id == 'eye'


def test_truth_of_another_size_is_counted_and_not_paired(tmp_path, extrapolator) -> None:
    bag = _write_images(tmp_path / 'bag', [(START_NS, _good(0))])
    result = replay(bag, extrapolator, tmp_path / 'out', truth_topic=IMAGE)
    assert (result.frames, result.pairs, result.rejected) == (1, 0, {'truth_size': 1})


def test_a_truncated_bag_is_replayed_up_to_the_cut(tmp_path, walk_bag, extrapolator) -> None:
    content = next(walk_bag.glob('*.mcap')).read_bytes()
    cut = tmp_path / 'cut.mcap'
    cut.write_bytes(content[:len(content) // 2])
    result = replay(cut, extrapolator, tmp_path / 'out')
    assert 0 < result.frames < 6
    damage, = result.damages
    assert damage.lost is None and damage.place.startswith('byte ')
    whole = _read_wide(walk_bag, extrapolator, tmp_path)
    assert _contents(tmp_path / 'out')['/camera/wide/image'] == whole[:result.frames]


def _read_wide(bag: Path, extrapolator: FovExtrapolator,
               folder: Path) -> list[tuple[int, bytes]]:
    replay(bag, extrapolator, folder / 'whole')
    return _contents(folder / 'whole')['/camera/wide/image']


@pytest.mark.parametrize(('options', 'message'), [
    ({'choice': CameraChoice('/nowhere')}, r'/nowhere.*the bag has .*/camera/image_raw'),
    ({'choice': CameraChoice('/odom')}, 'expected images on /odom, the bag has /camera'),
    ({'truth_topic': '/nowhere'}, 'expected images on /nowhere'),
], ids=['image', 'wrong type', 'truth'])
def test_missing_topics_are_refused_before_anything_is_written(
        tmp_path, walk_bag, extrapolator, options, message) -> None:
    with pytest.raises(BagError, match=message):
        replay(walk_bag, extrapolator, tmp_path / 'out', **options)
    assert not (tmp_path / 'out').exists()


def test_image_topics_that_do_not_fit_or_are_two_are_listed(tmp_path, extrapolator) -> None:
    small = image_fields(np.zeros((10, 20, 3), np.uint8))
    bag = _write_images(tmp_path / 'small', [(START_NS, small)])
    with pytest.raises(BagError, match=r'one image topic of 32x24.*image_raw \(20x10\)'):
        replay(bag, extrapolator, tmp_path / 'out')
    with BagWriter(tmp_path / 'two') as writer:
        for name in ('/left', '/right'):
            bag = _write_images(tmp_path / name[1:], [(START_NS, _good(0))], name)
            with BagReader(bag) as one:
                message, = one.messages()
                writer.copy_topic(message.topic)
                writer.write_cdr(message.topic, message.stamp_ns, message.cdr)
    with pytest.raises(BagError, match=r'/left \(32x24\), /right \(32x24\)'):
        replay(tmp_path / 'two', extrapolator, tmp_path / 'out')
    assert replay(tmp_path / 'two', extrapolator, tmp_path / 'out',
                  CameraChoice('/left')).frames == 1


def test_outputs_that_cannot_be_written_are_refused(tmp_path, walk_bag, extrapolator) -> None:
    (tmp_path / 'file').write_text('x')
    with pytest.raises(BagError, match='cannot write the bag'):
        replay(walk_bag, extrapolator, tmp_path / 'file' / 'out')
    with pytest.raises(BagError, match='exists already'):
        replay(walk_bag, extrapolator, walk_bag)
