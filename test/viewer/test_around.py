"""The map and the looks around, as the server gives them."""
import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
import json
import math
from pathlib import Path
import threading
from typing import Any

from aiohttp import ClientWebSocketResponse, WSMsgType
from aiohttp.test_utils import TestClient, TestServer
from box_board import teach_board, with_board
from box_room import EXPANSION, planar, view, write_box_model, write_model_without_floor
import cv2
from hand_clock import HandClock
from neo_ros.errors import ModelError, SceneError
from neo_ros.geometry import Intrinsics
from neo_ros.memory.look_around import Direction, LookAround
from neo_ros.memory.panorama import REMEMBERED, SEEN
from neo_ros.scenes.walkable import WalkableMap
from neo_ros.viewer.clock import Clock
from neo_ros.viewer.hearing import MOST_MESSAGES, TOO_MANY_MESSAGES
from neo_ros.viewer.hub import Hub
from neo_ros.viewer.server import Server
from neo_ros.viewer.settings import ViewerSettings
from neo_ros.viewer.surroundings import MOST_LOOKING, outlines, Surroundings
from neo_ros.viewer.whereabouts import Place
import numpy as np
import pytest
from tiny_model import write_tiny_model
from viewer_server import origin, run, split, WAIT_S

HERE = planar(1.9, 1.7, 30)
LOOK = {'yaw': math.radians(60), 'pitch': 0.0, 'hfov': math.radians(90), 'width': 160,
        'height': 120}
CAMERA = Intrinsics.from_hfov(160, 120, math.radians(90))


@pytest.fixture(scope='module')
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_box_model(tmp_path_factory.mktemp('box'))


@asynccontextmanager
async def serving(model: Path | None, clock: Clock = Clock()
                  ) -> AsyncIterator[tuple[TestClient, Hub]]:
    values, surroundings = ViewerSettings(), Surroundings(model)
    surroundings.warm_up()
    hub = Hub(values.quality, clock)
    async with TestClient(TestServer(Server(values, hub, surroundings).app)) as client:
        yield client, hub


def put(hub: Hub, age: float = 0.0, pose: Any = HERE) -> None:
    """Let the camera be there, and see the room, so many seconds ago."""
    hub.where.put(Place(pose, hub.clock.now() - age, lambda: view(pose, EXPANSION.target)[0]))


@asynccontextmanager
async def joined(client: TestClient) -> AsyncIterator[ClientWebSocketResponse]:
    async with client.ws_connect('/around', headers=origin(client)) as socket:
        yield socket


async def receive(socket: ClientWebSocketResponse, kind: str
                  ) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Return meta, image RGB and kinds of the next message of a kind; confirm what comes."""
    image: Any = None
    kinds: Any = None
    while True:
        message = await asyncio.wait_for(socket.receive(), 20)
        assert message.type in (WSMsgType.TEXT, WSMsgType.BINARY), message
        if message.type is WSMsgType.TEXT:
            about = json.loads(message.data)
        else:
            about, *parts = split(message.data)
            image, kinds = (cv2.imdecode(np.frombuffer(part, np.uint8), flags) for part, flags in
                            zip(parts, (cv2.IMREAD_COLOR, cv2.IMREAD_UNCHANGED)))
            image = image[..., ::-1]
        if 'seq' in about:
            await socket.send_json({'got': about['seq']})
        if about['type'] == kind:
            return about, image, kinds


async def first_look(socket: ClientWebSocketResponse, hub: Hub
                     ) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Look around once the camera's place is known; return the look as `receive` does."""
    put(hub)
    await receive(socket, 'place')
    put(hub)
    await socket.send_json({'look': LOOK})
    put(hub)
    return await receive(socket, 'look')


def test_the_map_is_the_room(model: Path) -> None:
    async def test() -> None:
        async with serving(model) as (client, _):
            about = await (await client.get('/map')).json()
            answer = await client.get('/map.webp')
            assert answer.content_type == 'image/webp'
            picture = cv2.imdecode(np.frombuffer(await answer.read(), np.uint8),
                                   cv2.IMREAD_UNCHANGED)
            assert picture is not None
            assert picture.shape == (about['height'], about['width'], 4)
            assert about['width'] * about['resolution'] == pytest.approx(5.1, abs=0.15)
            assert about['origin'] == pytest.approx([0, 0], abs=0.1)
            assert about['camera'] == pytest.approx([math.pi / 4] * 2)
            assert about['wide'] == pytest.approx([math.atan(2)] * 2)
            assert about['metric'] is True and about['outlines'] == []
    run(test)


@pytest.mark.parametrize('memory', [False, True], ids=['no model', 'no memory'])
def test_without_a_memory_the_page_is_told_why(tmp_path: Path, memory: bool) -> None:
    model = write_tiny_model(tmp_path / 'tiny.onnx', EXPANSION) if memory else None

    async def test() -> None:
        async with serving(model) as (client, hub):
            why = (await (await client.get('/map')).json())['why']
            assert ('tiny.onnx has no scene memory' if memory else '--model') in why
            assert (await client.get('/map.webp')).status == 404
            async with joined(client) as socket:
                await socket.send_json({'look': LOOK})
                put(hub)
                about, *_ = await receive(socket, 'place')
                assert about['position'] == pytest.approx(HERE.position.tolist())
                assert about['forward'] == pytest.approx(HERE.forward.tolist(), abs=1e-4)
                await socket.send_json({'ask': {'x': 0.5, 'y': 0.5, 'id': 3}})
                answer, *_ = await receive(socket, 'distance')
                assert answer == {'type': 'distance', 'id': 3}
    run(test)


def test_a_memory_without_a_floor_has_no_map_but_the_viewer_goes_on(tmp_path: Path) -> None:
    model = write_model_without_floor(tmp_path)

    async def test() -> None:
        async with serving(model) as (client, hub):
            for _ in range(2):
                why = (await (await client.get('/map')).json())['why']
                assert 'There is no map' in why and 'shows no floor' in why
                assert (await client.get('/map.webp')).status == 404
            async with joined(client) as socket:
                _, image, _ = await first_look(socket, hub)
                assert image.shape == (120, 160, 3)
    run(test)


def test_a_look_shows_the_room_with_the_live_image_in_it(model: Path) -> None:
    async def test() -> None:
        async with serving(model) as (client, hub), joined(client) as socket:
            about, image, kinds = await first_look(socket, hub)
            assert image.shape == (120, 160, 3) and kinds.shape == (60, 80)
            assert about['yaw'] == pytest.approx(LOOK['yaw'])
            # The camera looks 30 degrees to the right of the look.
            assert (kinds[20:40, 60:] == SEEN).all() and (kinds[20:40, :10] == REMEMBERED).all()
            truth, _ = view(planar(1.9, 1.7, 60), CAMERA)
            assert np.abs(image.astype(int) - truth).mean() < 8
            assert about['frame'] and not about['predicted'] and not about['stale']
            await socket.send_json({'look': None})
            put(hub, pose=planar(2.0, 1.7, 30))
            await receive(socket, 'place')
    run(test)


def test_a_look_shows_what_was_learnt(tmp_path: Path) -> None:
    ahead = Direction(math.radians(12), 0.0, math.radians(90), CAMERA.width, CAMERA.height)
    model, pose = write_box_model(tmp_path), ahead.pose(planar(1.8, 1.7, 12).position)
    truth, _, board = with_board(pose, CAMERA)

    def off() -> float:
        looks = Surroundings(model).looks
        assert looks is not None
        shown = looks.draw(pose.position, ahead, None).image.astype(int)
        return float(np.abs(shown - truth)[board].mean())

    untaught = off()
    teach_board(model)
    assert off() < 0.5 * untaught


def test_images_come_in_while_the_map_is_drawn(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun, may_end = threading.Event(), threading.Event()

    def draw(_: Surroundings) -> None:
        begun.set()
        may_end.wait(60)

    monkeypatch.setattr(Surroundings, '_draw_plan', draw)
    surroundings = Surroundings(model)
    drawing = threading.Thread(target=surroundings.plan)
    drawing.start()
    assert begun.wait(60)
    assert surroundings.seen(Place(HERE, 0.0, lambda: view(HERE, EXPANSION.target)[0]))
    assert drawing.is_alive()
    may_end.set()
    drawing.join()


def test_places_go_on_where_a_look_cannot_be_drawn(
        model: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> None:
        raise ModelError('keyframe 3: damaged')

    async def test() -> None:
        async with serving(model) as (client, hub), joined(client) as socket:
            monkeypatch.setattr(LookAround, 'draw', fail)
            monkeypatch.setattr(LookAround, 'distance', fail)
            await socket.send_json({'look': LOOK})
            for x in (1.9, 2.0):
                put(hub, pose=planar(x, 1.7, 30))
                about, *_ = await receive(socket, 'place')
                while 'why' not in about or about['position'][0] != pytest.approx(x):
                    about, *_ = await receive(socket, 'place')
                assert about['why'] == 'keyframe 3: damaged'
            await socket.send_json({'ask': {'x': 0.5, 'y': 0.5, 'id': 4}})
            answer, *_ = await receive(socket, 'distance')
            assert answer == {'type': 'distance', 'id': 4}
    run(test)


def test_one_look_more_than_there_are_seats_waits(model: Path) -> None:
    async def test() -> None:
        async with serving(model) as (client, hub):
            sockets = [await client.ws_connect('/around', headers=origin(client))
                       for _ in range(MOST_LOOKING + 1)]
            for socket in sockets[:-1]:
                await socket.send_json({'look': LOOK})
            put(hub)
            for socket in sockets[:-1]:
                await receive(socket, 'look')
            await sockets[-1].send_json({'look': LOOK})
            await receive(sockets[-1], 'full')
            await sockets[0].close()
            await sockets[-1].send_json({'look': LOOK})
            put(hub)
            await receive(sockets[-1], 'look')
    run(test)


@pytest.mark.parametrize('age, ahead, predicted, stale', [
    (0.0, 0.0, False, False), (1.0, 0.0, True, False), (0.0, 1.5, True, False),
    (3.0, 0.0, True, True)])
def test_on_a_bad_link_a_look_is_predicted_and_says_so(
        model: Path, age: float, ahead: float, predicted: bool, stale: bool) -> None:
    async def test() -> None:
        async with serving(model) as (client, hub), joined(client) as socket:
            # Half a metre a second, towards +x.
            for step in range(6):
                put(hub, age + 0.5 - step / 10, planar(1.5 + 0.05 * step, 1.7, 30))
            await socket.send_json({'look': LOOK, 'ahead': ahead})
            about, image, kinds = await receive(socket, 'look')
            assert about['predicted'] is predicted and about['stale'] is stale
            assert about['age'] == pytest.approx(age + ahead, abs=1.0)
            assert (SEEN in kinds) is not predicted, 'what is old is not what is seen now'
            moved = 1.75 + 0.5 * min(about['age'], 2.0) * predicted
            truth, _ = view(planar(moved, 1.7, 60), CAMERA)
            assert np.abs(image.astype(int) - truth).mean() < 8
    run(test)


def test_a_click_tells_how_far_away_a_point_is(model: Path) -> None:
    async def test() -> None:
        async with serving(model) as (client, hub), joined(client) as socket:
            put(hub)
            _, depth = view(HERE, EXPANSION.target)
            await socket.send_json({'ask': {'x': 0.5, 'y': 0.5, 'id': 1}})
            told, *_ = await receive(socket, 'distance')
            assert told['id'] == 1 and told['contradicted'] is False
            assert told['metres'] == pytest.approx(depth[64, 64], rel=0.03)
            assert 0 < told['plus_minus'] < 0.1 * told['metres']
            await socket.send_json({'look': LOOK})
            await receive(socket, 'look')
            put(hub)
            await socket.send_json({'ask': {'x': 0.5, 'y': 0.5, 'id': 2}})
            told, *_ = await receive(socket, 'distance')
            _, depth = view(planar(1.9, 1.7, 60), EXPANSION.target)
            assert told['metres'] == pytest.approx(depth[64, 64], rel=0.03)
    run(test)


@pytest.mark.parametrize('message', [
    '[]', '{"look": 3}', '{"look": {"yaw": "x"}}', '{"look": {"yaw": 1}}', '{"ahead": "nan"}',
    '{"ask": {"x": 1e999, "y": 0, "id": 0}}', '{"got": null}', 'x'])
def test_what_makes_no_sense_ends_the_connection(model: Path, message: str) -> None:
    async def test() -> None:
        async with serving(model) as (client, hub), joined(client) as socket:
            put(hub)
            await socket.send_str(message)
            while (answer := await asyncio.wait_for(socket.receive(), 5)).type is WSMsgType.TEXT:
                pass
            assert answer.type is WSMsgType.CLOSE and answer.data == 1007
    run(test)


def test_a_flood_of_messages_ends(model: Path) -> None:
    async def test() -> None:
        # By a clock that stands nothing is forgiven.
        async with serving(model, HandClock()) as (client, _), joined(client) as socket:
            for _ in range(round(MOST_MESSAGES) + 1):
                await socket.send_json({'ahead': 0.1})
            assert (await asyncio.wait_for(socket.receive(), WAIT_S)).data == TOO_MANY_MESSAGES
    run(test)


def test_wild_looks_are_held_within_limits(model: Path) -> None:
    async def test() -> None:
        async with serving(model) as (client, hub), joined(client) as socket:
            put(hub)
            await socket.send_json({'look': {
                'yaw': 1e9, 'pitch': 50, 'hfov': 9, 'width': 99999, 'height': 1}})
            about, image, _ = await receive(socket, 'look')
            assert image.shape == (64, 640, 3)
            assert abs(about['yaw']) <= math.pi and about['pitch'] < math.pi / 2
    run(test)


def test_other_sites_and_a_full_house_are_turned_away(model: Path) -> None:
    async def test() -> None:
        async with serving(model) as (client, hub):
            answer = await client.get('/around', headers={'Origin': 'http://evil.example'})
            assert answer.status == 403
            hub.where.wanted = ViewerSettings().max_viewers
            async with joined(client) as socket:
                assert (await socket.receive()).data == 4001
    run(test)


def test_outlines_are_the_borders_of_the_free_floor() -> None:
    cells = np.zeros((6, 8), bool)
    cells[1:5, 2:7] = True
    floor = WalkableMap(0.5, (-1.0, 3.0), cells, 1.5)
    (line,) = outlines(floor)
    xs, ys = np.array(line).T
    # Columns 2 to 7 and rows 1 to 5, half a metre each; drawn within half a cell.
    assert xs.min() == pytest.approx(0.0, abs=0.13) and xs.max() == pytest.approx(2.5, abs=0.13)
    assert ys.min() == pytest.approx(3.5, abs=0.13) and ys.max() == pytest.approx(5.5, abs=0.13)


def test_files_that_cannot_be_used_are_named(tmp_path: Path, model: Path) -> None:
    with pytest.raises(ModelError, match='none.onnx'):
        Surroundings(tmp_path / 'none.onnx')
    with pytest.raises(SceneError, match='--model'):
        Surroundings(None, tmp_path / 'walkable.json')
    with pytest.raises(SceneError, match='walkable.json'):
        Surroundings(model, tmp_path / 'walkable.json')
