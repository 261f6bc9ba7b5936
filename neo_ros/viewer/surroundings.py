"""What a viewer's model knows of the scene: its plan from above, and looks in any direction."""
from dataclasses import dataclass
import math
from pathlib import Path
import threading
from typing import Any, TYPE_CHECKING

import cv2
from neo_ros.errors import ModelError, SceneError
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import read_model_card
from neo_ros.scenes.floor_map import read_map_server
from neo_ros.scenes.walkable import read_walkable, WalkableMap
from neo_ros.viewer.whereabouts import Place
import numpy as np

if TYPE_CHECKING:
    from neo_ros.memory.look_around import LookAround, SeenImage

NO_MODEL = ('The viewer was started without a model: with --model it shows a map, and one can '
            'look around.')
# How many may look around at once: a look takes 25 ms of a core, ten times a second.
MOST_LOOKING = 4


@dataclass(frozen=True)
class PlanPicture:
    """The plan as the page takes it: WebP, and where it lies."""

    picture: bytes
    about: dict[str, Any]


class Surroundings:
    """
    Looks and plan of one model's memory, or `why` there are none, in words.

    With what was learnt until now; what a node learns later needs a new start.

    Raises ModelError for files that cannot be used, SceneError for a floor map that cannot.
    """

    def __init__(self, model: Path | None, floor: Path | None = None) -> None:
        self.why, self.looking = '', 0
        self.looks: 'LookAround | None' = None
        self._seen: dict[Place, 'SeenImage'] = {}
        # Two: where much was learnt the plan takes a minute, and looks go on meanwhile.
        self._busy, self._drawing = threading.Lock(), threading.Lock()
        self._plan: PlanPicture | None = None
        if floor is not None and model is None:
            raise SceneError('floor: expected together with a model, which draws the map that its '
                             'outlines lie under; give --model')
        self._floor = _read_floor(floor) if floor is not None else None
        if model is None:
            self.why = NO_MODEL
            return
        self._card = read_model_card(model)
        if self._card.memory is None:
            self.why = (f'The model {model.name} has no scene memory: there is no map, and one '
                        'cannot look around.')
            return
        # Its compiled loops take a second to load: not without a model.
        from neo_ros.memory import look_around
        from neo_ros.memory.learnt import read_learnt

        self._memory = read_learnt(memory_path(model, self._card.memory),
                                   self._card.memory.sha256)
        self.looks = look_around.LookAround(self._memory, self._card.expansion)

    def plan(self) -> PlanPicture | None:
        """
        Draw the plan, or return it; where there is none `why` says it.

        It takes a second for a flat, longer the more was learnt.
        """
        with self._drawing:
            if self._plan is None and not self.why:
                try:
                    self._plan = self._draw_plan()
                except ModelError as error:
                    self.why = f'There is no map, and one cannot look around: {error}'
            return self._plan

    def _draw_plan(self) -> PlanPicture:
        from neo_ros.memory.floor_plan import draw_floor_plan, encode_plan

        drawn = draw_floor_plan(self._memory, self._card.arbitrary_scale)
        height, width = drawn.image.shape[:2]
        expansion = self._card.expansion
        return PlanPicture(encode_plan(drawn), {
            'width': width, 'height': height, 'resolution': drawn.resolution,
            'origin': drawn.origin, 'metric': not self._card.arbitrary_scale,
            'camera': _sides(expansion.source), 'wide': _sides(expansion.target),
            'outlines': outlines(self._floor) if self._floor is not None else []})

    def warm_up(self) -> None:
        """Draw the plan and a look: at first use what is compiled takes seconds."""
        self.plan()
        if self.looks is not None:
            from neo_ros.memory import look_around

            position, source = self._memory.positions[0], self.looks.expansion.source
            ahead = look_around.Direction(0.0, 0.0, 1.0, 64, 64)
            image = look_around.SeenImage(
                np.zeros((source.height, source.width, 3), np.uint8), ahead.pose(position))
            self.looks.draw(position, ahead, image, [image])

    def seen(self, place: Place) -> 'SeenImage | None':
        """Return the camera's own image of a place; None where it is not of this model."""
        if self.looks is None:
            return None
        found = self._seen.get(place)
        if found is None:
            wide, expansion = place.read_image(), self.looks.expansion
            if wide is None or wide.shape[:2] != (expansion.target.height,
                                                  expansion.target.width):
                return None
            from neo_ros.memory import look_around

            found = look_around.SeenImage(np.ascontiguousarray(expansion.crop(wide)), place.pose)
            with self._busy:
                # Those of the last seconds are asked for again and again.
                while len(self._seen) >= 32:
                    del self._seen[next(iter(self._seen))]
                self._seen[place] = found
        return found


def outlines(floor: WalkableMap) -> list[list[tuple[float, float]]]:
    """Return the borders of the free floor, closed polygons of x, y in metres."""
    found, _ = cv2.findContours(np.pad(floor.cells, 1).repeat(2, 0).repeat(2, 1).astype(np.uint8),
                                cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    x0, y0 = floor.origin
    edge = floor.resolution / 2
    return [[(round(x0 + (x - 1.5) * edge, 4), round(y0 + (y - 1.5) * edge, 4)) for x, y in
             cv2.approxPolyDP(line, 1.5, True)[:, 0].tolist()] for line in found]


def _sides(view: Any) -> tuple[float, float]:
    """Return how far a view reaches to the left and to the right, radians."""
    return math.atan2(view.cx, view.fx), math.atan2(view.width - view.cx, view.fx)


def _read_floor(path: Path) -> WalkableMap:
    if path.suffix.lower() in ('.yaml', '.yml'):
        return read_map_server(path, 0.0)
    return read_walkable(path)
