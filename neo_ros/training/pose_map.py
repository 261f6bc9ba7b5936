"""Where the training views come from: counts and a picture, in the output folder and report."""
import json
from pathlib import Path
from typing import Any

import cv2
from neo_ros.errors import SceneError
from neo_ros.machine.files import write_bytes
from neo_ros.reports.plan_view import FLOOR, PlanView
from neo_ros.reports.report import Picture, Section, Table
from neo_ros.scenes.pose_sampling import PoseSampler
from neo_ros.scenes.posed_images import PosedImages
import numpy as np

PICTURE_FILE, COUNTS_FILE = 'poses.png', 'poses.json'
_GRID_POINT, _PHOTO, _USED, _REFUSED = (221, 230, 240), (150, 155, 165), (20, 130, 80), (
    200, 40, 40)
_TICK = 10
_MOST_GRID_POINTS = 100_000


def draw_poses(sampler: PoseSampler, used: np.ndarray, refused: np.ndarray,
               photos: PosedImages) -> np.ndarray:
    """
    Draw positions (N, 3), metres, over floor and photos from above, RGB uint8.

    Shaded: free floor, and on it the grid where positions are drawn from. Grey with ticks: photos.
    Green dots: positions used; red crosses: refused.
    """
    grid = sampler.positions_xy
    grid = grid[::-(-len(grid) // _MOST_GRID_POINTS)]
    floor = np.empty((0, 2)) if sampler.floor is None else sampler.floor.centres()
    everything = np.concatenate([grid, floor, photos.T_world_cam[:, :2, 3]])
    plan = PlanView(everything.min(0), everything.max(0))
    for centre in floor:
        assert sampler.floor is not None
        plan.shade(centre, sampler.floor.resolution, FLOOR)
    nearest = np.sort(np.linalg.norm(grid - grid[len(grid) // 2], axis=1))
    edge = float(nearest[1]) if len(grid) > 1 else 0.05
    for point in grid:
        plan.shade(point, edge, _GRID_POINT)
    plan.draw_grid()
    for pose in photos.poses:
        plan.draw_look(pose.position[:2], pose.forward, _PHOTO, _TICK)
    for position in used:
        cv2.circle(plan.image, plan.place(position[:2]), 3, _USED, -1, cv2.LINE_AA)
    for position in refused:
        cv2.drawMarker(plan.image, plan.place(position[:2]), _REFUSED, cv2.MARKER_TILTED_CROSS,
                       9, 1, cv2.LINE_AA)
    return plan.image


def write_poses(folder: Path, summary: dict[str, Any], picture: np.ndarray) -> None:
    """Write poses.png and poses.json, what `PanoramaPool.summary` tells."""
    write_bytes(folder / PICTURE_FILE, cv2.imencode('.png', picture[..., ::-1])[1].tobytes())
    write_bytes(folder / COUNTS_FILE, json.dumps(summary, indent=1).encode())


def pose_sections(folder: Path) -> list[Section]:
    """Show what `write_poses` left in the folder; nothing where it left nothing."""
    if not (folder / COUNTS_FILE).is_file():
        return []
    try:
        counts = json.loads((folder / COUNTS_FILE).read_text())
        rows = [
            ('Positions on the grid', f'{counts["grid_positions"]}'),
            ('Headings at each', f'{counts["yaws"] or "any"}'),
            ('Positions drawn', f'{counts["drawn_positions"]}'),
            *((f'- refused: {reason}', f'{number}')
              for reason, number in counts['refused_positions'].items()),
            ('Positions used', f'{counts["positions"]}'),
            ('Views drawn to count', f'{counts["drawn_views"]}'),
            *((f'- refused: {reason}', f'{number}')
              for reason, number in counts['refused_views'].items())]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise SceneError(f'{folder / COUNTS_FILE}: expected the counts of the poses: {error!r}; '
                         'delete it and outpainter.ckpt to train again') from error
    image = cv2.imread(str(folder / PICTURE_FILE))
    table = Table(('Poses of the training views', 'number'), rows, 'Where training views look')
    if image is None:
        return [table]
    return [table, Picture('Positions from above', image[..., ::-1], (
        'Pale green: free floor. Blue: the grid. Grey: photos and where they looked. Green: '
        'positions used; red: refused. Numbers are metres.'))]
