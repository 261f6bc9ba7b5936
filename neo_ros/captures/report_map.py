"""A capture from above: where the cameras stood, where they looked, where the robot can be."""
from neo_ros.captures.report_measures import apart, CaptureMeasures
from neo_ros.reports.plan_view import FLOOR, PlanView
from neo_ros.scenes.walkable import WalkableMap
import numpy as np

_LOOK = 14


def draw_map(measures: CaptureMeasures, walkable: WalkableMap | None) -> np.ndarray:
    """
    Draw the capture from above, RGB uint8.

    A dot and a tick in the viewing direction for every photo, coloured by how much of the wide
    view was seen there, red (little) to green (all), or at the nearest photo that was looked at;
    walkable floor is shaded.
    """
    positions = measures.photos.T_world_cam[:, :2, 3]
    floor = np.empty((0, 2)) if walkable is None else walkable.centres()
    everything = np.concatenate([positions, floor])
    plan = PlanView(everything.min(0), everything.max(0))
    for centre in floor:
        assert walkable is not None
        plan.shade(centre, walkable.resolution, FLOOR)
    plan.draw_grid()
    seen = measures.wide_seen.mean(axis=(1, 2))
    viewed = measures.photos.T_world_cam[measures.viewed]
    for pose in measures.photos.poses:
        share = float(seen[np.add(*apart(viewed, pose.T_world_cam)).argmin()])
        colour = (round(215 * (1 - share) + 15), round(150 * share + 30), 60)
        plan.draw_look(pose.position[:2], pose.forward, colour, _LOOK)
    return plan.image
