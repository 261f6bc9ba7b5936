"""The demo flat on the days after the training: furniture, light, a door, somebody who walks."""
from dataclasses import dataclass, replace
from functools import lru_cache
import math
from pathlib import Path

from neo_ros.flat.demo_flat import build_demo_flat, DemoFlat
from neo_ros.flat.light import bake_light, chart_layout, LightMap, LightSources
from neo_ros.flat.rooms import BEDROOM, DOOR, DOOR_TOP, LAMPS, WINDOWS
from neo_ros.flat.shapes import paint, SolidBuilder, Solids
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import whole_file
import numpy as np

# Where solids are put that somebody took away: nobody sees it there.
AWAY = (0.0, 0.0, -100.0)
DOOR_PLACE = ((BEDROOM[0][0] + 6.0) / 2, sum(DOOR) / 2)
LEAF = paint('e9e4d8', 'wood', 'd9d1bf', 0.15)
# Of what is brought into the flat: its light does not know it, and is even there.
EVEN_LIGHT = 0.8
# Lamps alone are darker; the camera's exposure follows. The sun comes in through the windows of
# the south.
EVENING_EXPOSURE, SUN_WAY, SUNNY_EXPOSURE = 1.9, (-0.35, -0.75, 0.5), 0.8


@dataclass(frozen=True)
class Moved:
    """
    What stands around a place is moved, or taken away.

    place, reach: x, y, and how far around it parts reach, metres; heights: between which its
    parts are; by: x, y, z.
    """

    place: tuple[float, float]
    reach: float
    heights: tuple[float, float]
    by: tuple[float, float, float]

    @property
    def goal(self) -> np.ndarray:
        """Where it stands afterwards, x, y."""
        return np.add(self.place, self.by[:2])


@dataclass(frozen=True)
class Repainted:
    """A picture is exchanged; name, other: of bitmaps of `flat/pictures.py`."""

    name: str
    other: str


Change = Moved | Repainted
CHAIRS = tuple(Moved(place, reach, (-0.01, 1.2), by) for place, reach, by in (
    ((0.75, 3.0), 0.55, (0.15, -0.85, 0.0)), ((8.6, 1.55), 0.4, (-0.9, 0.35, 0.0)),
    ((4.2, 1.62), 0.28, (-0.9, 0.6, 0.0)), ((4.88, 1.66), 0.28, (0.3, 0.9, 0.0))))
PLANT = Moved((5.68, 3.35), 0.45, (-0.01, 1.4), (3.9, -2.3, 0.0))
RUG = Moved((2.2, 2.43), 0.6, (-0.001, 0.013), AWAY)
PICTURES = (Repainted('portrait_b', 'abstract_c'), Repainted('landscape_c', 'landscape_a'))


@dataclass(frozen=True)
class Visit:
    """
    What a robot finds that was here on the day of the training.

    light   day, evening (lamps alone, outside it is dark) or sun (it shines into the bedroom)
    closed  whether the door between the rooms is
    people  whether somebody walks before the camera while it learns
    """

    changes: tuple[Change, ...] = ()
    light: str = 'day'
    closed: bool = False
    people: bool = False


# Day after day; from visit 4 to 9 the chairs are back, on 18 everything is.
_FURNITURE: tuple[tuple[Change, ...], ...] = (
    (), CHAIRS, (*CHAIRS, *PICTURES), (*CHAIRS, *PICTURES, PLANT, RUG), (*PICTURES, PLANT, RUG))
VISITS = (
    *map(Visit, _FURNITURE),
    Visit(_FURNITURE[4], people=True), Visit(_FURNITURE[4], 'evening'),
    Visit(_FURNITURE[4], 'sun'), Visit(_FURNITURE[4], closed=True), Visit(_FURNITURE[4]),
    Visit(_FURNITURE[3]), Visit(_FURNITURE[3], people=True), Visit(_FURNITURE[3], 'evening'),
    Visit(_FURNITURE[1]), Visit(_FURNITURE[1], closed=True), Visit(_FURNITURE[2]),
    Visit(_FURNITURE[2], 'sun'), Visit((*CHAIRS, PLANT)), Visit(), Visit(_FURNITURE[3]))


@lru_cache(maxsize=2)
def visited_flat(visit: Visit, lights: Path) -> DemoFlat:
    """
    Return the flat as a visit finds it; furniture's shadows stay where they were.

    lights: a folder where light that was baked is kept, for it takes a minute.
    """
    flat = changed_flat(build_demo_flat(), visit.changes)
    if visit.light != 'day':
        flat = _lit(flat, visit.light, lights)
    return with_more(flat, _door()) if visit.closed else flat


def changed_flat(flat: DemoFlat, changes: tuple[Change, ...]) -> DemoFlat:
    """Return the flat after these changes; the light, with its shadows, stays as it was."""
    solids = flat.solids
    centre, materials = solids.centre.copy(), list(solids.materials)
    for change in changes:
        if isinstance(change, Repainted):
            materials = [replace(one, picture=change.other) if one.picture == change.name else one
                         for one in materials]
            continue
        low, high = change.heights
        # The walls and floors that things stand at and on are larger than the reach.
        away = np.linalg.norm(solids.centre[:, :2] - change.place, axis=1)
        parts = (away + 0.3 * np.linalg.norm(solids.half[:, :2], axis=1) < change.reach) & (
            solids.lower[:, 2] > low) & (solids.upper[:, 2] > 0.01) & (
            solids.upper[:, 2] < high)
        centre[parts] += change.by
    return replace(flat, solids=replace(solids, centre=centre, materials=tuple(materials)))


def with_more(flat: DemoFlat, more: Solids) -> DemoFlat:
    """Return the flat with solids that its light does not know."""
    here, light = flat.solids, flat.light
    _, columns, rows = chart_layout(more)
    counts = columns * rows
    first = len(light.values) + np.cumsum(counts) - counts
    values = np.full((int(counts.sum()), 3), EVEN_LIGHT, np.float32)
    kind, centre, half, yaw = (np.concatenate([getattr(here, name), getattr(more, name)])
                               for name in ('kind', 'centre', 'half', 'yaw'))
    columns, rows, first = (np.concatenate(pair).astype(np.int32) for pair in (
        (light.columns, columns), (light.rows, rows), (light.start, first)))
    return replace(
        flat, solids=Solids(kind, centre, half, yaw, here.materials + more.materials),
        light=LightMap(np.concatenate([light.values, values]), first, columns, rows))


def somebody(pose: CameraPose, step: int) -> Solids:
    """Return who walks to and fro two metres before a camera, at one of its steps."""
    x, y = pose.position[:2] + 2.0 * pose.forward[:2] + 0.8 * math.sin(0.35 * step) * np.array(
        [-pose.forward[1], pose.forward[0]])
    builder = SolidBuilder()
    person = builder.at(float(x), float(y))
    person.frustum(0, 0, (0.0, 0.85), (0.13, 0.17), paint('2f3b52'))
    person.frustum(0, 0, (0.85, 1.45), (0.17, 0.22), paint('b3372f', 'stripes', 'e8d9c0', 0.12))
    person.ellipsoid((0, 0, 1.6), (0.1, 0.1, 0.13), paint('c69076'))
    return builder.build()


def _door() -> Solids:
    builder = SolidBuilder()
    x = DOOR_PLACE[0]
    builder.box((x - 0.02, DOOR[0], 0.005), (x + 0.02, DOOR[1], DOOR_TOP), LEAF)
    return builder.build()


def _lit(flat: DemoFlat, light: str, folder: Path) -> DemoFlat:
    """Return the flat in another light, which is baked with the furniture as by day."""
    sources = LightSources((), LAMPS) if light == 'evening' else LightSources(
        WINDOWS, LAMPS, SUN_WAY)
    path = folder / f'light_{light}.npy'
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as partial, open(partial, 'wb') as file:
            np.save(file, bake_light(build_demo_flat().solids, sources))
    lit = replace(flat.light, values=np.load(path).astype(np.float32))
    if light == 'evening':
        return replace(flat, light=lit, outside=0.01, exposure=EVENING_EXPOSURE)
    return replace(flat, light=lit, outside=1.5, exposure=SUNNY_EXPOSURE)
