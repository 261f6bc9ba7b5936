"""A bag as engineers play it: pause, step, seek, speed, the end, truth, cameras, the time line."""
from pathlib import Path
import threading
from typing import Any

from bag_files import write_box_bags
from box_room import box_walk, EXPANSION
from neo_ros.bags import BagReader, BagWriter
from neo_ros.messages import read_image
from neo_ros.viewer.bag_source import BagSource
from neo_ros.viewer.hub import Wanted
from neo_ros.viewer.pictures import CAMERAS, EncodedPicture, TRUTH
from neo_ros.viewer.playback import Jump, Playback
from neo_ros.viewer.timeline import PIECES, read_timeline, ring_psnr, Timeline
import numpy as np
from picture_collector import Collector
import pytest
from viewer_server import run, running, split_all, watching

FRAMES, STEP_S = 20, 0.1
LAST = (FRAMES - 1) * STEP_S
TOPIC = '/camera/wide/image'


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Give `camera`, `wide` (its replay), and `two` (the same under two names)."""
    path = tmp_path_factory.mktemp('playback')
    write_box_bags(path, FRAMES, STEP_S)
    with BagReader(path / 'wide') as reader, BagWriter(path / 'two') as writer:
        names = {topic.name: topic for topic in reader.topics if '/wide/' in topic.name}
        for camera in ('front', 'rear'):
            topics = {name: writer.add_topic(name.replace('/camera', f'/{camera}'), topic.msgtype)
                      for name, topic in names.items()}
            for message in reader.messages(names):
                writer.write_cdr(topics[message.topic.name],
                                 message.stamp_ns + 10**7 * (camera == 'rear'), message.cdr)
    return path


def play(source: BagSource, count: int, commands: dict[float, dict[str, Any]],
         wanted: Wanted = Wanted(True, True), seconds: float = 60.0) -> Any:
    """Play until so many pictures came or the time is over, with commands at times in seconds."""
    hub: Any = Collector(count)
    hub.wanted = wanted
    for at, command in commands.items():
        hub.clock.at(at, lambda command=command: hub.playback.command(command))
    hub.clock.at(seconds, hub.stop.set)
    source.run(hub, hub.stop)
    return hub


def wide(folder: Path) -> BagSource:
    return BagSource(folder / 'wide', folder / 'box.onnx')


CASES: dict[str, tuple[dict[float, dict[str, Any]], list[float]]] = {
    'pause and go on': ({0.25: {'play': False}, 5.0: {'play': True}}, [0, .1, .2, .3, .4]),
    'seek': ({0.25: {'seek': 1.0}}, [0, .1, .2, 1.0, 1.1]),
    'seek between two pictures': ({0.25: {'seek': 1.07}}, [0, .1, .2, 1.0, 1.1]),
    'seek beyond the end': ({0.25: {'seek': 99}}, [0, .1, .2, LAST]),
    'seek while paused shows one picture': (
        {0.05: {'play': False}, 1.0: {'seek': 1.2}}, [0, 1.2]),
    'a step pauses': ({0.25: {'step': 1}}, [0, .1, .2, .3]),
    'three steps at once': ({0.15: {'play': False}, 1.0: {'step': 1}, 1.001: {'step': 1},
                             1.002: {'step': 1}}, [0, .1, .2, .3, .4]),
    'steps back': ({0.35: {'step': -1}, 1.0: {'step': -1}}, [0, .1, .2, .3, .2, .1]),
    'back and forth at once': (
        {0.35: {'step': -1}, 0.351: {'step': 1}}, [0, .1, .2, .3, .2, .3]),
    'no step before the start': ({0.05: {'step': -1}}, [0, 0]),
    'again after the end': ({0.05: {'seek': 1.8}, 2.0: {'play': True}, 2.15: {'play': False}},
                            [0, 1.8, LAST, 0, .1]),
    'a step back from the end': ({0.05: {'seek': 1.8}, 2.0: {'step': -1}}, [0, 1.8, LAST, 1.8]),
}


@pytest.mark.parametrize('name', CASES)
def test_commands(folder: Path, name: str) -> None:
    commands, expected = CASES[name]
    hub = play(wide(folder), 50, commands, seconds=8.0)
    assert hub.numbers[:len(expected)] == pytest.approx(expected)
    paused = any('step' in command or command.get('play') is False
                 for command in commands.values())
    if paused and name != 'pause and go on':
        assert len(hub.numbers) == len(expected)


def test_it_stops_at_the_end_and_says_so(folder: Path) -> None:
    hub = play(wide(folder), 99, {}, seconds=20.0)
    assert len(hub.pictures) == FRAMES
    assert hub.states[-1].playback['ended'] and not hub.states[-1].playback['playing']
    ended = [state.playback['ended'] for state in hub.states]
    assert ended == sorted(ended) and not ended[0]


def test_years_in_which_a_clock_was_set_are_not_waited_for(folder: Path, tmp_path: Path) -> None:
    with BagReader(folder / 'wide') as reader, BagWriter(tmp_path / 'set') as writer:
        first_ns, _ = reader.span_ns
        for message in reader.messages():
            writer.copy_topic(message.topic)
            late = message.stamp_ns > first_ns + 10 ** 9
            writer.copy(message, message.stamp_ns + 10 ** 18 * late)
    hub = play(BagSource(tmp_path / 'set', folder / 'box.onnx'), 99, {}, seconds=20.0)
    assert len(hub.pictures) == FRAMES
    assert hub.times[-1] - hub.times[0] < LAST + 1


@pytest.mark.parametrize('rate', [0.5, 4.0])
def test_speed_changes_on_the_way(folder: Path, rate: float) -> None:
    hub = play(wide(folder), 12, {0.45: {'rate': rate}})
    assert np.diff(hub.times[:5]) == pytest.approx(4 * [STEP_S])
    assert np.diff(hub.times[6:]) == pytest.approx(5 * [STEP_S / rate])


def test_what_is_said_of_a_picture_is_known_while_it_stands(folder: Path) -> None:
    hub = play(wide(folder), 50, {0.05: {'play': False}, 1.0: {'seek': 1.2}}, seconds=3.0)
    assert hub.states[-1].recognised is True
    place = hub.where.last
    assert place is not None and hub.where.stands == place.captured
    truth = box_walk(FRAMES)[12]
    assert np.linalg.norm(place.pose.position - truth.position) < 0.03


def test_who_comes_while_it_is_paused_sees_the_picture(folder: Path) -> None:
    hub: Any = Collector(3)
    hub.clock.at(0.15, lambda: hub.playback.command({'play': False}))
    hub.clock.at(5.0, lambda: setattr(hub, 'changes', 7))
    hub.clock.at(9.0, hub.stop.set)
    wide(folder).run(hub, hub.stop)
    assert hub.numbers == pytest.approx([0, .1, .1])
    assert hub.pictures[2].captured == pytest.approx(1005.0, abs=0.1), 'not an old picture'
    assert hub.where.last.captured == hub.pictures[2].captured, 'nor an old place'


def test_a_camera_that_is_widened_can_be_wound_back(folder: Path) -> None:
    source = BagSource(folder / 'camera', folder / 'box.onnx')
    hub = play(source, 50, {0.55: {'seek': 0.2}, 0.6: {'play': False}}, seconds=3.0)
    assert hub.numbers == pytest.approx([0, .1, .2, .3, .4, .5, .2])
    assert hub.states[-1].recognised is True
    assert sum(value is not None for value in source.playback.timeline.describe()['guided']) == 6


def test_truth_stands_beside_the_picture_of_its_stamp(folder: Path) -> None:
    wanted = Wanted(True, False, False, frozenset({TRUTH}))
    hub = play(wide(folder), 8, {0.25: {'seek': 1.0}, 0.35: {'seek': 0.5}}, wanted)
    with BagReader(folder / 'wide') as reader:
        truths = [read_image(message.read())
                  for message in reader.messages(['/camera/wide/image_raw'])]
    for number, picture in zip(hub.numbers, hub.pictures, strict=True):
        assert np.array_equal(picture.beside[TRUTH], truths[round(number / STEP_S)])
    assert hub.states[0].playback['beside'] == (TRUTH,)
    *_, plain = split_all(EncodedPicture(1, hub.pictures[0], 80, False).message(False))
    about, _, _, shown = split_all(
        EncodedPicture(1, hub.pictures[0], 80, False).message(False, False, TRUTH))
    assert plain == b'' and shown.startswith(b'\xff\xd8\xff') and about['beside'] == TRUTH


def test_several_cameras_are_tiles_and_each_can_be_the_large_one(folder: Path) -> None:
    source = BagSource(folder / 'two', folder / 'box.onnx')
    wanted = Wanted(True, False, False, frozenset({CAMERAS}))
    front, rear = '/front/wide/image', '/rear/wide/image'
    hub = play(source, 9, {0.45: {'camera': rear}}, wanted)
    assert hub.states[0].playback['cameras'] == (front, rear)
    assert hub.states[0].name == f'two {front}' and hub.states[-1].name == f'two {rear}'
    names = [picture.beside[CAMERAS].describe()[0]['name'] for picture in hub.pictures[1:]]
    assert names == 4 * [rear] + 4 * [front]
    about, *_, shown = split_all(
        EncodedPicture(1, hub.pictures[3], 80, False).message(False, False, CAMERAS))
    assert about['tiles'] == [{'name': rear, 'x': 0, 'y': 0, 'width': 1, 'height': 1}] and shown
    # The same moment, under the other name.
    assert hub.numbers[5] == pytest.approx(hub.numbers[4] - 0.09, abs=0.02)


def test_the_time_line_of_a_replay(folder: Path) -> None:
    source = wide(folder)
    player = source.playback
    read_timeline(folder / 'wide', player.timelines, '/camera/wide/image_raw', threading.Event())
    known = player.timeline.describe()
    assert known['done'] and known['seconds'] == pytest.approx(LAST)
    with BagReader(folder / 'wide') as reader:
        pairs = list(zip(*([read_image(message.read()) for message in reader.messages([name])]
                           for name in (TOPIC, '/camera/wide/image_raw'))))
    for number in range(FRAMES):
        piece = min(int(number / (FRAMES - 1) * PIECES), PIECES - 1)
        assert known['guided'][piece] == 1.0 and known['agreement'][piece] > 0.8
        errors = np.square(np.subtract(*pairs[number], dtype=float))[EXPANSION.extrapolated_mask]
        assert known['psnr'][piece] == pytest.approx(
            10 * np.log10(255 ** 2 / errors.mean()), abs=0.01)
    assert sum(value is not None for value in known['psnr']) == FRAMES


def test_rejects_are_counted_where_they_happened() -> None:
    timeline = Timeline((0, 10**9))
    timeline.reject(5 * 10**8, 3)
    timeline.reject(10**9)
    rejects = timeline.describe()['rejects']
    assert rejects[PIECES // 2] == 3 and rejects[-1] == 1 and sum(rejects) == 4
    assert timeline.describe()['psnr'] is None


def test_a_ring_that_is_right_scores_high() -> None:
    truth = np.full((8, 8, 3), 100, np.uint8)
    shown = truth.copy()
    shown[2:6, 2:6] = 0
    seen = (0.25, 0.25, 0.5, 0.5)
    assert ring_psnr(truth, shown, seen) > 70 > 30 > ring_psnr(truth, shown, None)


@pytest.mark.parametrize('asked', [{'seek': 'x'}, {'seek': float('nan')}, {'rate': None},
                                   {'step': []}], ids=repr)
def test_what_is_no_command_is_refused(asked: dict[str, Any]) -> None:
    with pytest.raises((ValueError, TypeError)):
        Playback((0, 10**9)).command(asked)


def test_limits_of_commands() -> None:
    player = Playback((10**9, 3 * 10**9))
    player.command({'rate': 1e9})
    assert player.rate == 100
    player.command({'seek': -5})
    assert player.take_jump() == Jump(10**9)
    player.command({'camera': '/etc/passwd'})
    assert player.camera == '' and not player.jumps


def test_viewers_command_through_the_stream() -> None:
    async def test() -> None:
        async with running() as (client, hub):
            answer = await client.get('/timeline')
            assert answer.status == 404
            hub.playback = Playback((0, 10**9))
            async with watching(client) as socket:
                await socket.send_json({'player': {'play': False}, 'beside': TRUTH, 'ping': 1})
                while (await socket.receive_json())['type'] != 'pong':
                    pass
                assert not hub.playback.playing and hub.wanted.beside == {TRUTH}
                assert (await (await client.get('/timeline')).json())['seconds'] == 1.0
                await socket.send_json({'player': 3})
                assert (await socket.receive()).data == 1007
    run(test)
