"""A mesh as the radiance field: Embree casts the rays, the mesh's own colours are seen."""
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import ClassVar
from zipfile import BadZipFile

from neo_ros.errors import ConfigError
from neo_ros.field.field_file import write_field
from neo_ros.field.mesh_file import ColouredMesh, NEEDS
import numpy as np
import torch

# Edges of cells that a mesh's extent is divided into, to tell where matter is.
CELLS = 300
# Points of the surface that are looked at in a cell that it crosses: one in 3000 is missed.
POINTS = 8


class MeshField:
    """
    A `RadianceField` made of opaque triangles.

    The back of a triangle that photos saw from the front alone counts as seen by no photo: a
    robot that sees it stands in the wall.
    """

    device: ClassVar = torch.device('cpu')

    def __init__(self, mesh: ColouredMesh, near: float) -> None:
        try:
            from embreex.mesh_construction import TriangleMesh
            from embreex.rtcore_scene import EmbreeScene
        except ImportError as error:
            raise ConfigError(f'rays through a mesh need {NEEDS}') from error
        self.mesh, self.near = mesh, near
        self.seen = np.zeros((len(mesh.corners), 2), np.bool_)  # from the front, from the back
        self._embree = EmbreeScene()
        self._kept = TriangleMesh(self._embree, np.ascontiguousarray(mesh.corners))

    @property
    def voxel(self) -> float:
        """Edge of the cells that matter is told by, metres."""
        low, high = self._bounds
        return float((high - low).max() / CELLS)

    @cached_property
    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        points = self.mesh.corners.reshape(-1, 3)
        return points.min(0), points.max(0)

    def _cast(self, rays_o: np.ndarray, rays_d: np.ndarray) -> dict[str, np.ndarray]:
        """Return what Embree says of rays that begin `near` before the lens."""
        return self._embree.run(np.ascontiguousarray(rays_o + self.near * rays_d, np.float32),
                                np.ascontiguousarray(rays_d, np.float32), output=True)

    def render(self, rays_o: np.ndarray, rays_d: np.ndarray, background: float) -> np.ndarray:
        """Render unit rays float32 (N, 3); returns float32 (N, 6), see `kernels.render_rays`."""
        out = np.zeros((len(rays_o), 6), np.float32)
        out[:, :3] = background
        found = self._cast(rays_o, rays_d)
        hit = found['primID'] >= 0
        face = found['primID'][hit]
        out[hit, :3] = self.mesh.colours_at(face, found['u'][hit], found['v'][hit])
        out[hit, 3] = found['tfar'][hit] + self.near
        out[hit, 4] = 1
        side = _side(found['Ng'][hit], rays_d[hit])
        out[hit, 5] = self.seen[face, side] | ~self.seen[face, 1 - side]
        return out

    def mark_seen(self, rays: Iterable[tuple[np.ndarray, np.ndarray]]) -> None:
        """Note which side of each triangle photos' rays_o and rays_d (N, 3) reach."""
        self.seen[:] = False
        for rays_o, rays_d in rays:
            found = self._cast(rays_o, rays_d)
            hit = found['primID'] >= 0
            self.seen[found['primID'][hit], _side(found['Ng'][hit], rays_d[hit])] = True

    def is_matter(self, points: np.ndarray) -> np.ndarray:
        """Tell which world points (..., 3) lie in cells that a triangle crosses: bool (...)."""
        low, _ = self._bounds
        cells = self._matter
        place = np.floor((points - low) / self.voxel).astype(int)
        inside = ((place >= 0) & (place < cells.shape)).all(-1)
        x, y, z = np.moveaxis(np.clip(place, 0, np.array(cells.shape) - 1), -1, 0)
        return cells[x, y, z] & inside

    @cached_property
    def _matter(self) -> np.ndarray:
        """Cells that triangles cross, bool (X, Y, Z)."""
        low, high = self._bounds
        corners, random = self.mesh.corners, np.random.default_rng(0)
        cells = np.zeros(np.floor((high - low) / self.voxel).astype(int) + 1, np.bool_)
        edges = corners[:, 1:] - corners[:, :1]
        area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1) / 2
        face = np.repeat(np.arange(len(corners)), np.ceil(
            POINTS * area / self.voxel ** 2).astype(int) + 1)
        shares = random.random((len(face), 2), np.float32)
        beyond = shares.sum(1) > 1
        shares[beyond] = 1 - shares[beyond]
        points = corners[face, 0] + np.einsum('nk,nkv->nv', shares, edges[face])
        place = np.floor((points - low) / self.voxel).astype(int)
        x, y, z = np.clip(place, 0, np.array(cells.shape) - 1).T
        cells[x, y, z] = True
        return cells

    def save(self, path: Path) -> None:
        """Write the field as .npz, see `write_field`."""
        mesh = self.mesh
        write_field(path, corners=mesh.corners, colours=mesh.colours, uv=mesh.uv,
                    texture_of=mesh.texture_of, seen=self.seen, near=self.near,
                    **{f'picture_{i:06d}': one for i, one in enumerate(mesh.textures)})

    @classmethod
    def load(cls, path: Path) -> 'MeshField | None':
        """Read what `save` wrote; None for any other file."""
        try:
            with np.load(path) as data:
                if 'corners' not in data:
                    return None
                arrays = dict(data)
            textures = [arrays[name] for name in sorted(arrays) if name.startswith('picture_')]
            mesh = ColouredMesh(arrays['corners'], arrays['colours'], arrays['uv'],
                                arrays['texture_of'], tuple(textures))
            near, seen = float(arrays['near']), arrays['seen']
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            return None
        field = cls(mesh, near)
        field.seen = seen
        return field


def _side(normals: np.ndarray, rays_d: np.ndarray) -> np.ndarray:
    """Tell from which side rays (N, 3) come: 0 = against the normals (N, 3), 1 = along them."""
    return (np.einsum('nk,nk->n', normals, rays_d) > 0).astype(int)
