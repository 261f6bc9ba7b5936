"""A bag as the viewer's source: as it is, or widened on the way; without any ROS."""
import math
from pathlib import Path
import re
import subprocess
import sys
import threading
from typing import Any

from bag_files import STRING, string_cdr, walk_frames, write_walk_bag
from camera_bags import CameraBag
from neo_ros.bags import BagReader, BagWriter, replay
from neo_ros.bags.camera_choice import CameraChoice
from neo_ros.errors import BagError, ConfigError
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.messages import read_image
from neo_ros.messages.stamps import NS_PER_S
from neo_ros.runtime import FovExtrapolator
from neo_ros.viewer.bag_moments import Companion
from neo_ros.viewer.bag_source import BagSource, LATE_S
from neo_ros.viewer.hub import Wanted
from neo_ros.viewer.timeline import read_timeline, Timeline
import numpy as np
from picture_collector import collect, Collector
import pytest
from tiny_model import write_tiny_model
from viewer_server import WAIT_S

EXPANSION = ViewExpansion.to_size(Intrinsics.from_hfov(32, 24, math.pi / 2), 64, 48)
FRAMES = 6
ROOT = Path(__file__).parents[2]
SEEN = (0.25, 0.25, 0.5, 0.5)


@pytest.fixture(scope='module')
def model(tmp_path_factory) -> Path:
    return write_tiny_model(tmp_path_factory.mktemp('model') / 'm.onnx', EXPANSION)


@pytest.fixture(scope='module')
def walk_bag(tmp_path_factory) -> Path:
    return write_walk_bag(tmp_path_factory.mktemp('bag') / 'walk', EXPANSION, FRAMES)


@pytest.fixture(scope='module')
def wide_bag(walk_bag, model, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp('bag') / 'wide'
    replay(walk_bag, FovExtrapolator.load(model), path)
    return path


def test_a_replayed_bag_is_shown_as_it_is(wide_bag, model):
    hub = collect(BagSource(wide_bag, Path('no model is needed')), FRAMES)
    with BagReader(wide_bag) as reader:
        for name, attribute in (('image', 'image'), ('confidence', 'confidence')):
            recorded = [read_image(message.read()) for message in
                        reader.messages([f'/camera/wide/{name}'])]
            for picture, image in zip(hub.pictures, recorded, strict=True):
                shown = getattr(picture, attribute)
                assert np.array_equal(shown, image if name == 'image' else image[..., 0])
    assert {picture.seen for picture in hub.pictures} == {SEEN}
    assert hub.states[0].name == 'wide /camera/wide/image'


def test_a_camera_is_widened_as_the_replay_does(walk_bag, wide_bag, model):
    widened = collect(BagSource(walk_bag, model), FRAMES)
    recorded = collect(BagSource(wide_bag, model), FRAMES)
    for one, other in zip(widened.pictures, recorded.pictures, strict=True):
        assert np.array_equal(one.image, other.image) and one.seen == other.seen == SEEN
        assert np.array_equal(one.confidence, other.confidence)
    for picture, (_, truth, _) in zip(widened.pictures, walk_frames(EXPANSION, FRAMES)):
        assert np.array_equal(EXPANSION.crop(picture.image), EXPANSION.crop(truth))


def test_truth_that_comes_before_its_picture_is_found_wherever_the_bag_is(tmp_path):
    first_ns, step_ns = 1_700_000_000 * NS_PER_S, NS_PER_S // 10
    with CameraBag(tmp_path / 'truth') as bag:
        for number in range(40):
            stamp_ns = first_ns + number * step_ns
            bag.log_ns = stamp_ns - 150_000_000
            bag.image('/truth', stamp_ns, np.full((24, 32, 3), number, np.uint8))
    with BagReader(tmp_path / 'truth') as reader:
        companion = Companion(reader, '/truth', exact=True)
        for number in range(0, 40, 10):
            # Nearly a second on, what is read next is older than what is kept.
            log_ns = first_ns + number * (step_ns - 10)
            found = companion.at(log_ns, first_ns + number * step_ns)
            assert found is not None and np.unique(found) == number


def test_topics_of_another_type_are_left_out(wide_bag, model, tmp_path):
    """Others may publish under these names: a PoseStamped as pose, a text as diagnostics."""
    bag = tmp_path / 'other'
    names = [f'/camera/wide/{name}' for name in ('pose', 'status', 'mask', 'confidence')]
    with BagReader(wide_bag) as reader, BagWriter(bag) as writer:
        image = writer.add_topic('/camera/wide/image', 'sensor_msgs/msg/Image')
        others = [writer.add_topic(name, STRING) for name in (*names, '/diagnostics')]
        for message in reader.messages(['/camera/wide/image']):
            for other in others:
                writer.write_cdr(other, message.stamp_ns, string_cdr('something else'))
            writer.write_cdr(image, message.stamp_ns, message.cdr)
    hub = collect(BagSource(bag, model), FRAMES)
    assert len(hub.pictures) == FRAMES and not any(state.message for state in hub.states)
    timeline = Timeline(hub.playback.span_ns)
    read_timeline(bag, {'/camera/wide/image': timeline}, None, threading.Event())
    assert timeline.done


def test_timing_by_the_clock_and_once_more(wide_bag, model):
    hub = collect(BagSource(wide_bag, model, rate=2.0), 2 * FRAMES, again=True)
    # 10 Hz twice as fast.
    for times in (hub.times[:FRAMES], hub.times[FRAMES:]):
        assert np.allclose(np.diff(times), 0.05)
    assert all(picture.timed for picture in hub.pictures)
    assert [picture.captured for picture in hub.pictures] == hub.times


def test_pictures_that_would_come_late_are_left_out(wide_bag, model):
    hub: Any = Collector(4, again=True)
    hub.work_s = 0.35  # of what comes every 0.1 s
    BagSource(wide_bag, model).run(hub, hub.stop)
    late = [shown - picture.captured for picture, shown in zip(hub.pictures, hub.times)]
    assert all(0 <= seconds <= LATE_S for seconds in late)
    assert [round((picture.captured - hub.pictures[0].captured) / 0.1)
            for picture in hub.pictures[:2]] == [0, 2]


def test_a_bag_that_is_read_slower_than_it_plays_is_shown_now_and_then(
        wide_bag, model, monkeypatch):
    hub: Any = Collector(8, again=True)
    messages = BagReader.messages

    def slowly(reader, *arguments):
        for message in messages(reader, *arguments):
            hub.clock.turn(0.2)
            yield message

    monkeypatch.setattr(BagReader, 'messages', slowly)
    BagSource(wide_bag, model).run(hub, hub.stop)
    assert max(hub.numbers) > 0.25  # Of half a second.


def test_what_a_bag_has_lost_is_told(wide_bag, model, tmp_path, caplog):
    file, = wide_bag.glob('*.mcap')
    content = file.read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(content[:len(content) * 2 // 3])
    BagSource(tmp_path / 'cut.mcap', model)
    message, = caplog.messages
    assert re.search(r'cut\.mcap: \d+ messages recovered, an unknown number lost', message)


def test_nothing_is_widened_while_nobody_watches(walk_bag, model, monkeypatch):
    source = BagSource(walk_bag, model, rate=20.0)
    monkeypatch.setattr(FovExtrapolator, 'expand', lambda *_: pytest.fail('was widened'))
    hub: Any = Collector(1)
    hub.wanted = Wanted()
    hub.clock.at(0.9, hub.stop.set)
    source.run(hub, hub.stop)
    assert hub.pictures == []


def test_who_jumps_gets_what_the_camera_said_at_the_beginning(model, tmp_path):
    wider = ViewExpansion.to_size(Intrinsics.from_hfov(64, 48, math.radians(100)), 128, 96)
    bag, infos = tmp_path / 'once', 0
    with BagReader(write_walk_bag(tmp_path / 'walk', wider, FRAMES)) as reader, (
            BagWriter(bag)) as writer:
        topics = {name: writer.add_topic(f'/camera/{name}', f'sensor_msgs/msg/{kind}')
                  for name, kind in (('image_raw', 'Image'), ('camera_info', 'CameraInfo'))}
        for message in reader.messages([f'/camera/{name}' for name in topics]):
            name = message.topic.name.rpartition('/')[2]
            infos += name == 'camera_info'
            if name == 'image_raw' or infos == 1:
                writer.write_cdr(topics[name], message.stamp_ns, message.cdr)
    source = BagSource(bag, model)
    hub: Any = Collector(1)
    hub.clock.at(0.0, lambda: hub.playback.command({'seek': 0.3}))
    source.run(hub, hub.stop)
    assert hub.pictures[0].image.shape == (48, 64, 3)
    assert not any(state.message for state in hub.states)


def test_a_bag_waits_for_its_first_viewer(wide_bag, model):
    hub: Any = Collector(1)
    hub.wanted = Wanted()
    hub.clock.at(7.0, lambda: setattr(hub, 'wanted', Wanted(True)))
    BagSource(wide_bag, model).run(hub, hub.stop)
    assert hub.numbers == [0.0] and hub.times[0] - 1000 == pytest.approx(7.0, abs=0.1)


@pytest.mark.parametrize('rate', [0.0, math.inf, math.nan, 1000.0])
def test_a_rate_that_no_viewer_could_ask_for_is_refused(wide_bag, model, rate):
    with pytest.raises(ConfigError, match='rate: expected 0.001 to 100, got'):
        BagSource(wide_bag, model, rate)


def test_what_cannot_be_shown_is_named(walk_bag, model, tmp_path):
    with pytest.raises(BagError, match='no such bag'):
        BagSource(tmp_path / 'missing', model)
    with pytest.raises(BagError, match='/front'):
        BagSource(walk_bag, model, choice=CameraChoice('/front'))
    with pytest.raises(ConfigError, match='rate'):
        BagSource(walk_bag, model, rate=0)
    with CameraBag(tmp_path / 'bare') as bag:
        bag.image('/eye/image_raw', 0, np.zeros((24, 32, 3), np.uint8))
    with pytest.raises(BagError, match='--rectify: expected a camera_info beside /eye/image_raw'):
        BagSource(tmp_path / 'bare', model, choice=CameraChoice(rectify=True))


def test_a_calibration_that_is_not_beside_the_images_is_named(model, tmp_path):
    with CameraBag(tmp_path / 'bag') as bag:
        bag.info('/eye/info', 0, Intrinsics.from_hfov(64, 48, 2.0), d=np.full(5, 1e-3))
        bag.image('/eye/image_raw', 1, np.full((48, 64, 3), 90, np.uint8))
    source = BagSource(tmp_path / 'bag', model, choice=CameraChoice(
        '/eye/image_raw', '/eye/info', rectify=True))
    picture, = collect(source, 1).pictures
    assert picture.image.shape == (48, 64, 3) and (EXPANSION.crop(picture.image) == 90).all()
    with pytest.raises(BagError, match='--info-topic: expected a .*CameraInfo on /none'):
        BagSource(tmp_path / 'bag', model, choice=CameraChoice('/eye/image_raw', '/none'))


def test_a_bag_is_shown_without_ros():
    code = ('import sys, neo_ros.viewer.bag_source, neo_ros.viewer.server, neo_ros.cli.view; '
            'print(*[name for name in ("rclpy", "torch", "sensor_msgs") if name in sys.modules])')
    result = subprocess.run([sys.executable, '-c', code], cwd=ROOT, text=True,
                            capture_output=True, check=True)
    assert result.stdout.split() == []


def test_the_command_prints_its_address_and_ends_cleanly(walk_bag, model):
    process = subprocess.Popen(
        [sys.executable, '-m', 'neo_ros.cli.main', 'view', '--bag', walk_bag, '--model', model,
         '--port', '0'], cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith('Viewer: http://127.0.0.1:')
    port = line.strip().rstrip('/').rpartition(':')[-1]
    taken = subprocess.run(
        [sys.executable, '-m', 'neo_ros.cli.main', 'view', '--bag', walk_bag, '--model', model,
         '--port', port], cwd=ROOT, text=True, capture_output=True, timeout=WAIT_S)
    assert taken.returncode == 2 and 'cannot listen on 127.0.0.1' in taken.stderr
    process.terminate()
    assert process.wait(WAIT_S) == 0 and process.communicate()[1] == ''
