"""A bag is played on a real graph and recorded again: the same bytes, the same timing."""
import signal
import threading
import time

from bag_files import write_walk_bag
from neo_ros.bags import BagReader, BagWriter
from neo_ros.bags.qos import LATCHED
from neo_ros.errors import BagError
from neo_ros.node import bag_recorder
from neo_ros.node.bag_player import BagPlayer, CLOCK_PERIOD_S
from neo_ros.node.bag_recorder import BagRecorder
from neo_ros.node.message_types import find_message_class
import numpy as np
import pytest
from ros_graph import WAIT_S
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image
from tiny_model import TINY_EXPANSION

IMAGE, CAMERA_INFO = '/camera/image_raw', '/camera/camera_info'
FRAMES = 8


@pytest.fixture(scope='module')
def bag(tmp_path_factory):
    """Eight frames at 10 Hz."""
    return write_walk_bag(tmp_path_factory.mktemp('bag') / 'walk', TINY_EXPANSION, FRAMES)


def cli(graph, command, *arguments):
    """Run one command of the `neo` line in a process of its own."""
    script = f'import typer; from neo_ros.cli.{command} import {command} as run; typer.run(run)'
    return graph.start('-c', script, *map(str, arguments))


def messages_of(path, topics):
    with BagReader(path) as reader:
        return [(message.topic.name, message.stamp_ns, message.cdr)
                for message in reader.messages(topics)]


def by_topic(messages):
    """Return the bytes by topic, padded to 4 bytes as the middleware does."""
    return {topic: [cdr + bytes(-len(cdr) % 4) for name, _, cdr in messages if name == topic]
            for topic in (IMAGE, CAMERA_INFO)}


def test_what_is_played_is_what_is_recorded(graph, bag, tmp_path):
    out = tmp_path / 'out'
    recorder = cli(graph, 'record', IMAGE, CAMERA_INFO, '--out', out, '--frames', FRAMES)
    player = cli(graph, 'play', bag, '--topics', IMAGE, '--topics', CAMERA_INFO,
                 '--wait-for-subscribers', 3, '--rate', 2)
    clocks = graph.collect(Clock, '/clock')
    images = graph.collect(Image, IMAGE)
    graph.spin_until(lambda: player.poll() is not None)
    assert player.returncode == 0, player.stdout.read()
    assert recorder.wait(WAIT_S) == 0, recorder.stdout.read()
    played, recorded = (messages_of(path, [IMAGE, CAMERA_INFO]) for path in (bag, out))
    assert by_topic(recorded) == by_topic(played)
    stamps = [stamp for topic, stamp, _ in recorded if topic == IMAGE]
    assert abs(stamps[0] / 1e9 - time.time()) < 60  # The time of arrival, not of the bag.
    # Of 0.1 s; a stall delays one or two.
    assert np.median(np.diff(stamps)) / 1e9 == pytest.approx(0.1 / 2, abs=0.03)
    times = [message.clock.sec * 10**9 + message.clock.nanosec for message in clocks]
    assert times == sorted(set(times)) and times[-1] == played[-1][1]
    # A tick every 25 ms, and one for each moment of the bag, however many messages it has.
    seconds = (times[-1] - times[0]) / 1e9 / 2
    assert len(times) <= seconds / CLOCK_PERIOD_S + FRAMES + 1
    assert images and images[-1].header.frame_id == 'camera_optical_frame'


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM], ids=['SIGINT', 'SIGTERM'])
def test_signal_leaves_a_complete_bag(graph, tmp_path, number):
    out = tmp_path / 'out'
    recorder = cli(graph, 'record', IMAGE, '/never', '--out', out)
    publisher = graph.node.create_publisher(Image, IMAGE, 10)
    graph.spin_until(publisher.get_subscription_count)
    for count in range(5):
        publisher.publish(Image(height=count))
    publisher.wait_for_all_acked()
    graph.spin_for(0.3)
    recorder.send_signal(number)
    assert recorder.wait(WAIT_S) == 0, recorder.stdout.read()
    with BagReader(out) as reader:
        assert reader.recovered == ''
        assert [message.read().height for message in reader.messages()] == list(range(5))
    assert '0 messages  /never' in recorder.stdout.read()


def test_looping_player_ends_on_a_signal(graph, bag):
    player = cli(graph, 'play', bag, '--loop', '--rate', 4, '--no-clock')
    images = graph.collect(Image, IMAGE)
    graph.spin_until(lambda: len(images) > FRAMES + 1)
    assert graph.node.count_publishers('/clock') == 0
    player.send_signal(signal.SIGINT)
    assert player.wait(WAIT_S) == 0
    assert player.stdout.read().count('played') >= 2


class Unheard:
    """A publisher that nobody, or so many, listen to."""

    def __init__(self, subscribers):
        self.subscribers, self.sent = subscribers, 0

    def get_subscription_count(self):
        return self.subscribers

    def publish(self, message):
        self.sent += 1

    def wait_for_all_acked(self, timeout):
        pass


@pytest.mark.parametrize('subscribers, latched, sent', [
    (0, False, 0), (0, True, 3), (1, False, 3)], ids=['nobody', 'latched', 'somebody'])
def test_what_nobody_hears_is_not_published(graph, tmp_path, subscribers, latched, sent):
    with BagWriter(tmp_path / 'bag') as writer:
        topic = writer.add_topic('/image', 'sensor_msgs/msg/Image', (LATCHED,) if latched else ())
        for stamp_ns in range(3):
            writer.write_cdr(topic, stamp_ns, bytes(64))
    with BagReader(tmp_path / 'bag') as reader:
        player = BagPlayer(graph.node, reader)
        publisher = Unheard(subscribers)
        player._publishers = dict.fromkeys(player._publishers, publisher)  # type: ignore
        assert player.play(threading.Event()).messages == 3
    assert publisher.sent == sent


def test_days_without_a_message_are_left_out(graph, tmp_path):
    """As where a robot without a battery for its clock hears the time after a minute."""
    with BagWriter(tmp_path / 'bag') as writer:
        topic = writer.add_topic('/image', 'sensor_msgs/msg/Image', (LATCHED,))
        for stamp_ns in (0, 10**8, 1_700_000_000 * 10**9, 1_700_000_000 * 10**9 + 10**8):
            writer.write_cdr(topic, stamp_ns, bytes(64))
    reports: list[str] = []
    with BagReader(tmp_path / 'bag') as reader:
        played = BagPlayer(graph.node, reader, report=reports.append).play(threading.Event())
    assert played.messages == 4 and 0.2 <= played.seconds < 10
    assert reports == ['19676 days without a message are left out: a clock was set']


def test_topics_without_an_installed_type_are_named(graph, bag):
    reports: list[str] = []
    with BagReader(bag) as reader:
        BagPlayer(graph.node, reader, report=reports.append)
    missing = find_message_class('tf2_msgs/msg/TFMessage') is None
    assert [report.split()[0] for report in reports] == (['/tf', '/tf_static'] if missing else [])


def test_player_names_the_topics_that_a_bag_lacks(graph, bag):
    with BagReader(bag) as reader:
        with pytest.raises(BagError, match='expected the topics /nothing, the bag has /camera'):
            BagPlayer(graph.node, reader, ['/nothing', IMAGE])
        with pytest.raises(BagError, match='rate: expected a number > 0'):
            BagPlayer(graph.node, reader).play(threading.Event(), rate=0)


def test_recorder_stops_when_nothing_comes_any_more(graph, tmp_path):
    publisher = graph.node.create_publisher(Image, IMAGE, 10)
    graph.executor.remove_node(graph.node)
    with BagWriter(tmp_path / 'out') as writer:
        recorder = BagRecorder(graph.node, writer, [IMAGE])

        def publish_when_heard():
            time.sleep(1.0)
            while not publisher.get_subscription_count():
                time.sleep(0.05)
            publisher.publish(Image())

        threading.Thread(target=publish_when_heard, daemon=True).start()
        started = time.monotonic()
        recorder.record(threading.Event(), seconds=WAIT_S, idle_timeout=0.3)
        assert recorder.counts == {IMAGE: 1}
        assert time.monotonic() - started > 1.2
        recorder.record(threading.Event(), seconds=0.2)


def test_recorder_ends_where_no_type_is_installed(graph, tmp_path, monkeypatch):
    graph.node.create_publisher(Image, IMAGE, 10)
    graph.executor.remove_node(graph.node)
    monkeypatch.setattr(bag_recorder, 'find_message_class', lambda msgtype: None)
    reports: list[str] = []
    with BagWriter(tmp_path / 'out') as writer:
        recorder = BagRecorder(graph.node, writer, [IMAGE], reports.append)
        with pytest.raises(BagError, match='no topic left to record'):
            recorder.record(threading.Event(), messages=10)
    assert reports == [f'{IMAGE} is left out: sensor_msgs/msg/Image is not installed']


@pytest.mark.parametrize('msgtype, expected', [
    ('sensor_msgs/msg/Image', Image), ('sensor_msgs/msg/CameraInfo', CameraInfo),
    ('sensor_msgs/msg/Nothing', None), ('no_such_msgs/msg/Image', None),
    ('sensor_msgs/Image', None), ('', None)])
def test_message_classes_by_name(msgtype, expected):
    assert find_message_class(msgtype) is expected
