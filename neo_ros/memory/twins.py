"""Places of a scene that look alike, found once, when its memory was made."""
from dataclasses import dataclass

from neo_ros.geometry import CameraPose
import numpy as np

# Metres around an area in which a camera may have been found that is in it.
AROUND = 0.5


@dataclass(frozen=True, eq=False)
class Twins:
    """
    Pairs of places: a camera in one of them could as well be in the other.

    T (K, 4, 4) takes poses of the first place to the second, world to world; areas (K, 2, 3), the
    corners of the first; T_world_cam (K, 4, 4), a camera in it that sees the same from there.
    """

    T: np.ndarray
    areas: np.ndarray
    T_world_cam: np.ndarray

    def of(self, pose: CameraPose) -> list[CameraPose]:
        """Return where a camera could as well be that was found at a pose."""
        back = np.linalg.inv(self.T) @ pose.T_world_cam
        return CameraPose.nearest_each(np.concatenate([
            (self.T @ pose.T_world_cam)[self._in_areas(pose.position)],
            back[self._in_areas(back[:, :3, 3])]]))

    def _in_areas(self, positions: np.ndarray) -> np.ndarray:
        """Tell whether positions (3,) or (K, 3) are in each first place, bool (K,)."""
        inside: np.ndarray = ((positions >= self.areas[:, 0] - AROUND)
                              & (positions <= self.areas[:, 1] + AROUND)).all(-1)
        return inside

    def __len__(self) -> int:
        """Return how many pairs there are."""
        return len(self.T)


NO_TWINS = Twins(np.zeros((0, 4, 4)), np.zeros((0, 2, 3)), np.zeros((0, 4, 4)))
