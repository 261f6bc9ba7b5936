"""A map of the floor out of a model's scene memory, as navigation wants it."""
from dataclasses import dataclass
from pathlib import Path

from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import ModelCard
import numpy as np

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
# Of the heights that are drawn: what is lower is floor, carpets included. A layer of the plan is
# a fourteenth of them.
FLOOR_SHARE = 1.2 / 14


@dataclass(frozen=True, eq=False)
class SceneMap:
    """
    Free and occupied places of a scene, in its axes.

    cells int8 (H, W), FREE, OCCUPIED or UNKNOWN; the first row lies at the smallest y, as in a
    nav_msgs/OccupancyGrid. resolution: metres a cell; origin: x and y of the outer corner of the
    first cell; floor: z of the floor, metres.
    """

    cells: np.ndarray
    resolution: float
    origin: tuple[float, float]
    floor: float


def read_scene_map(model: Path | str, card: ModelCard) -> SceneMap | None:
    """
    Draw the map of a model, with what was learnt since; None without a scene memory.

    Takes a second for a flat, longer the more was learnt. A cell is occupied where anything stands
    up to 1.8 m above the floor, or up to 0.7 of the height of low rooms. Raises ModelError for a
    memory that cannot be used.
    """
    if card.memory is None:
        return None
    # Its compiled loops take a second to load: not without a memory.
    from neo_ros.memory.floor_plan import draw_floor_plan
    from neo_ros.memory.learnt import read_learnt

    memory = read_learnt(memory_path(model, card.memory), card.memory.sha256)
    plan = draw_floor_plan(memory, card.arbitrary_scale)
    cells, floor = cells_of(plan.height[::-1])
    return SceneMap(cells, plan.resolution, plan.origin, floor)


def cells_of(height: np.ndarray) -> tuple[np.ndarray, float]:
    """Return cells and the floor's z of heights, float32 (H, W), NaN = unknown."""
    known = np.isfinite(height)
    floor, top = float(np.nanmin(height)), float(np.nanmax(height))
    cells = np.full(height.shape, UNKNOWN, np.int8)
    cells[known] = np.where(height[known] - floor <= FLOOR_SHARE * (top - floor), FREE, OCCUPIED)
    return cells, floor
