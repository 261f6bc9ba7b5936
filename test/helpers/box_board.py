"""A board that stands in the box room, and a drive past it."""
from pathlib import Path

from box_room import EXPANSION, planar, SOURCE, view
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.journal import journal_path, write_journal
from neo_ros.memory.patch import Patch
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.runtime import read_model_card
import numpy as np

WALL = 3.6  # metres along x, where a board stands that the memory does not know
DRIVE = [planar(1.5 + 0.02 * step, 1.2 + 0.04 * step, 8) for step in range(20)]


def with_board(pose: CameraPose, camera: Intrinsics, middle: float = 1.8
               ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return image, depth, and where the board is: bool (H, W)."""
    image, depth = view(pose, camera)
    image, rays = image.copy(), camera.pixel_rays() @ pose.T_world_cam[:3, :3].T
    with np.errstate(divide='ignore'):
        z = (WALL - pose.position[0]) / rays[..., 0]
    point = pose.position + rays * z[..., None]
    board = ((z > 0) & (z < depth) & (np.abs(point[..., 1] - middle) < 0.5)
             & (np.abs(point[..., 2] - 1.3) < 0.5))
    pattern = 128 + 110 * np.sign(np.sin(17 * point[..., 1]) * np.sin(15 * point[..., 2] + 1))
    image[board] = np.stack([pattern, 255 - pattern, np.full_like(pattern, 40)], -1)[board]
    return image, np.where(board, z, depth).astype(np.float32), board


def true_patch(pose: CameraPose, batch: int = 0) -> Patch:
    """Return what a perfect look at the board teaches."""
    image, depth, board = with_board(pose, SOURCE)
    return Patch.of(pose, SOURCE, image, np.where(board, depth, 0), 0, batch, view(pose, SOURCE))


def teach_board(model: Path) -> None:
    """Write the journal of a box model that has seen the board."""
    memory = read_model_card(model).memory
    assert memory is not None
    write_journal(journal_path(model.parent / memory.file), memory.sha256,
                  [true_patch(pose) for pose in DRIVE[6:14]])


def board_error(memory: SceneMemory, middle: float = 1.8) -> tuple[float, float]:
    """Return the mean error of the board and of the rest, from a pose beside the drive."""
    pose = planar(1.8, 1.7, 12)
    truth, _, board = with_board(pose, EXPANSION.target, middle)
    off = np.abs(MemoryRenderer(memory).render(pose, EXPANSION.target).image - truth).mean(-1)
    return float(off[board].mean()), float(off[~board].mean())
