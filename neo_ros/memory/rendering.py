"""Draw the scene memory from a pose: colours, depth, and what is not known."""
from collections.abc import Iterable
from dataclasses import dataclass

from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory import kernels
from neo_ros.memory.coarse_memory import CoarseMemory
from neo_ros.memory.scene_light import SceneLight
from neo_ros.memory.scene_memory import SceneMemory
import numpy as np

# Neighbours that parallax pulls apart by more than so many quads lie on two surfaces: one that is
# merely slanted is pulled by less. What is stretched between them is drawn only where nothing
# else is seen.
TEAR = 1.5
# Added to a keyframe's number in pixels that are stretched over a gap.
STRETCHED = 64


@dataclass(frozen=True, eq=False)
class GuideView:
    """
    What the memory shows from a pose.

    image float32 RGB (H, W, 3) in 0 ... 255; depth float32 (H, W), z in metres, 0 = unknown;
    stretched bool (H, W): colours of both sides of a gap, where no keyframe saw what is there;
    light float32 (H, W, 3): what brought the colours into the light of now, None: nothing.
    """

    image: np.ndarray
    depth: np.ndarray
    stretched: np.ndarray
    light: np.ndarray | None = None


class MemoryRenderer:
    """Draws views of one memory; keeps what all of them need."""

    def __init__(self, memory: SceneMemory | CoarseMemory) -> None:
        self.memory = memory
        self.light: SceneLight | None = None
        self._rays: np.ndarray | None = None

    def nearest(self, position: np.ndarray, count: int) -> np.ndarray:
        """Return the indices of the nearest keyframes, the nearest first."""
        away = self.memory.positions - position
        squared = np.einsum('ij,ij->i', away, away)
        # A search asks some hundred times: of a building's keyframes only these are sorted.
        last = np.partition(squared, count - 1)[count - 1] if count < len(away) else np.inf
        near = np.flatnonzero(squared <= last)
        return near[np.argsort(squared[near], kind='stable')][:count]

    def render(self, pose: CameraPose, view: Intrinsics, keyframes: int = 3) -> GuideView:
        """Draw the nearest keyframes; the nearer one wins where several show a surface."""
        return self.render_from(self.nearest(pose.position, keyframes), pose, view)

    def render_from(self, keyframes: Iterable[int], pose: CameraPose, view: Intrinsics
                    ) -> GuideView:
        """Draw these keyframes; one that comes earlier wins where several show a surface."""
        height, width = view.height, view.width
        canvas = kernels.Canvas(np.zeros((height, width, 3), np.float32),
                                np.zeros((height, width), np.float32),
                                np.full((height, width), -1, np.int8))
        camera = kernels.Pinhole(view.fx, view.fy, view.cx, view.cy)
        rotation = np.ascontiguousarray(pose.T_world_cam[:3, :3].T, np.float32)
        meshes = []
        for index in keyframes:
            keyframe = self.memory.keyframe(int(index), view.fx)
            if self._rays is None:
                self._rays = self.memory.band.rays(*keyframe.depth.shape)
            offset = (keyframe.position - pose.position).astype(np.float32)
            vertices = np.empty((3, *keyframe.depth.shape), np.float32)
            kinds = np.empty(keyframe.depth.shape, np.uint8)
            spans = np.empty((len(keyframe.depth), 2, 2), np.float32)
            kernels.project_vertices(self._rays, keyframe.depth, offset, rotation, camera,
                                     vertices)
            tear = TEAR * self.memory.band.width / keyframe.depth.shape[1]
            kernels.sort_quads(
                vertices, keyframe.depth, self.memory.band.wraps,
                float(np.linalg.norm(offset)) / tear, width, height, kinds, spans)
            meshes.append(kernels.Mesh(vertices, kinds, spans, keyframe.texture))
        # What is whole comes first, what is torn fills the gaps.
        for fill in (False, True):
            for own, mesh in enumerate(meshes):
                kernels.draw_keyframe(mesh, own + STRETCHED * fill, fill, canvas)
        inverse = canvas.inverse
        depth = np.divide(1, inverse, out=np.zeros_like(inverse), where=inverse > 0)
        light = None if self.light is None else self.light.relight(canvas.image, depth, pose, view)
        return GuideView(canvas.image, depth, canvas.rank >= STRETCHED, light)
