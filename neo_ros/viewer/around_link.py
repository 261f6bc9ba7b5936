"""One viewer's second connection: where the camera is, and looks away from it."""
import asyncio
from dataclasses import dataclass
import math
from typing import Any, TYPE_CHECKING

from aiohttp import web
import cv2
from neo_ros.errors import NeoError
from neo_ros.messages import encode_jpeg
from neo_ros.viewer.clock import Clock
from neo_ros.viewer.hearing import finite, hear
from neo_ros.viewer.pictures import pack
from neo_ros.viewer.surroundings import MOST_LOOKING, Surroundings
from neo_ros.viewer.whereabouts import Place, Whereabouts
import numpy as np

if TYPE_CHECKING:
    from neo_ros.memory.look_around import Direction, Distance, LookAround, SeenImage

PERIOD_S = 0.1
# As for pictures: more than these would only wait on a slow link.
MOST_ON_THE_WAY = 2
# From this age on a look is drawn where the last motion leads, and says so; then it is stale.
PREDICT_AFTER_S, STALE_AFTER_S = 0.3, 2.0
# Pixels and radians of a look.
SIDES, FIELDS, STEEPEST = (64, 640), (math.radians(15), math.radians(130)), math.radians(85)
# The kinds of pixels are sent in a picture so much smaller.
COARSER = 2
QUALITY = 80


@dataclass(frozen=True, eq=False)
class Look:
    """What a look is drawn from: position (3,), live image, those before, age in seconds."""

    position: np.ndarray
    now: 'SeenImage | None'
    before: 'list[SeenImage]'
    age: float

    @property
    def predicted(self) -> bool:
        """Whether it shows where the last motion leads."""
        return self.age > PREDICT_AFTER_S


class AroundLink:
    """
    Tells one viewer of the camera's place, and draws where the viewer looks.

    To the viewer: JSON of type `place` (`why`: the look that was asked for cannot be drawn),
    `distance`, `full`; or a look, see `pictures.pack`: a JSON object, a JPEG, a PNG of its kinds,
    see `memory.look_around`. From the viewer: JSON objects with `look` (yaw, pitch, hfov in
    radians, width, height in pixels; null = no more), `got` (seq of a message), `ahead` (seconds
    that a message is on its way), `ask` (x, y in shares of the picture, id).
    """

    def __init__(self, socket: web.WebSocketResponse, where: Whereabouts,
                 surroundings: Surroundings, clock: Clock) -> None:
        self._socket, self._where = socket, where
        self._surroundings, self._clock = surroundings, clock
        self._direction: 'Direction | None' = None
        self._ahead = 0.0
        self._sequence = 0
        self._on_the_way: set[int] = set()
        self._told: tuple[Place | None, 'Direction | None'] = (None, None)
        self._again = 0.0

    async def serve(self) -> None:
        """Send and listen until the connection ends."""
        self._where.wanted += 1
        sender = asyncio.create_task(self._send())
        try:
            await hear(self._socket, self._clock, self._answer)
        finally:
            self._where.wanted -= 1
            self._look(None)
            sender.cancel()
            await asyncio.gather(sender, return_exceptions=True)

    async def _send(self) -> None:
        while True:
            await self._clock.sleep(PERIOD_S)
            place, direction = self._where.last, self._direction
            if place is None or len(self._on_the_way) >= MOST_ON_THE_WAY:
                continue
            # A view of a place that is gone by changes, too: it is drawn where the motion leads.
            moving = (direction is not None and self._where.stands is None
                      and self._clock.now() - place.captured < 2 * STALE_AFTER_S)
            if (place, direction) == self._told and not moving:
                continue
            self._told = place, direction
            self._sequence += 1
            self._on_the_way.add(self._sequence)
            about = {'type': 'place', 'seq': self._sequence, **_place_fields(place)}
            drawn = None
            if direction is not None and self._surroundings.looks is not None:
                try:
                    drawn = await asyncio.to_thread(
                        self._draw, self._surroundings.looks, direction, place, about)
                except NeoError as error:  # The places must go on.
                    about['why'] = str(error)
            if drawn is None:
                await self._socket.send_json(about)
            else:
                await self._socket.send_bytes(drawn)

    def _draw(self, looks: 'LookAround', direction: 'Direction', place: Place,
              about: dict[str, Any]) -> bytes:
        look = self._scene(place)
        drawn = looks.draw(look.position, direction, look.now, look.before)
        about = about | {
            'type': 'look', 'yaw': direction.yaw, 'pitch': direction.pitch,
            'hfov': direction.hfov, 'frame': [line.round(4).tolist() for line in drawn.frame],
            'predicted': look.predicted, 'stale': look.age > STALE_AFTER_S,
            'age': round(look.age, 3)}
        image = bytes(encode_jpeg(drawn.image, QUALITY))
        kinds = cv2.imencode('.png', drawn.kinds[::COARSER, ::COARSER])[1].tobytes()
        return pack(about, image, kinds)

    def _scene(self, place: Place) -> Look:
        stands = self._where.stands
        now = self._clock.now() + self._ahead if stands is None else stands
        age = now - place.captured
        before = [seen for kept in self._where.recent(now)
                  if (seen := self._surroundings.seen(kept)) is not None]
        live = self._surroundings.seen(place)
        if age <= PREDICT_AFTER_S:
            return Look(place.pose.position, live, before, age)
        position = self._where.predicted(now)
        # What was live is what was seen last.
        return Look(place.pose.position if position is None else position, None,
                    [*([live] if live is not None else []), *before], age)

    async def _answer(self, asked: dict[str, Any]) -> None:
        if 'ahead' in asked:
            self._ahead = _within(asked['ahead'], (0.0, STALE_AFTER_S))
        if 'got' in asked:
            self._on_the_way.discard(int(asked['got']))
        if 'look' in asked:
            wanted = asked['look'] is not None and self._surroundings.looks is not None
            self._look(_direction(asked['look']) if wanted else None)
            if wanted and self._direction is None:
                await self._socket.send_json({'type': 'full'})
        if 'ask' in asked:
            ask = asked['ask']
            x, y = (_within(ask[name], (0.0, 1.0)) for name in 'xy')
            try:
                told = await asyncio.to_thread(self._distance, x, y)
            except NeoError:
                told = None  # Nobody knows it.
            await self._socket.send_json({'type': 'distance', 'id': int(ask['id']),
                                          **(told._asdict() if told is not None else {})})

    def _look(self, direction: 'Direction | None') -> None:
        """Take or give back one of the few seats."""
        surroundings = self._surroundings
        if direction is None:
            surroundings.looking -= self._direction is not None
            self._direction = None
        elif self._direction is not None or surroundings.looking < MOST_LOOKING:
            surroundings.looking += self._direction is None
            self._direction = direction

    def _distance(self, x: float, y: float) -> 'Distance | None':
        looks, place, direction = self._surroundings.looks, self._where.last, self._direction
        if looks is None or place is None:
            return None
        if direction is None:
            view = looks.expansion.target
            return looks.distance_in(place.pose, view, x * view.width, y * view.height,
                                     self._surroundings.seen(place))
        look = self._scene(place)
        return looks.distance(look.position, direction, x, y, look.now)


def _place_fields(place: Place) -> dict[str, Any]:
    return {'position': place.pose.position.round(4).tolist(),
            'forward': place.pose.forward.round(5).tolist(), 'captured': 1e3 * place.captured}


def _direction(asked: dict[str, Any]) -> 'Direction':
    """Return what somebody asked for, within its limits."""
    from neo_ros.memory.look_around import Direction

    width, height = (int(_within(asked[name], SIDES)) for name in ('width', 'height'))
    return Direction(math.remainder(finite(asked['yaw']), 2 * math.pi),
                     _within(asked['pitch'], (-STEEPEST, STEEPEST)),
                     _within(asked['hfov'], FIELDS), width, height)


def _within(value: Any, limits: tuple[float, float]) -> float:
    return min(max(finite(value), limits[0]), limits[1])
