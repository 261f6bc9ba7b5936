"""The demo flat on the days after the training: chairs, pictures, a plant and a rug change."""
from dataclasses import dataclass, replace

from neo_ros.flat.demo_flat import DemoFlat
import numpy as np

# Where solids are put that somebody took away: nobody sees it there.
AWAY = (0.0, 0.0, -100.0)


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
# What has changed since the training, visit by visit; the last one finds the chairs moved back.
VISITS: tuple[tuple[Change, ...], ...] = (
    (), CHAIRS, (*CHAIRS, *PICTURES), (*CHAIRS, *PICTURES, PLANT, RUG), (*PICTURES, PLANT, RUG))


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
