"""Meshes with colours, as photogrammetry and scanners write them: PLY, OBJ, GLB."""
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from neo_ros.errors import ConfigError, SceneError
import numpy as np

ENDINGS = ('.ply', '.obj', '.glb', '.gltf')
NEEDS = "the extra `mesh`: pip install '.[mesh]' in a checkout"


@dataclass(frozen=True, eq=False)
class ColouredMesh:
    """
    F triangles; the colour of a point is that of its corners, times that of its texture.

    corners     float32 (F, 3, 3): where the three corners are
    colours     float32 (F, 3, 3): their RGB in [0, 1]
    uv          float32 (F, 3, 2): their places in the texture, from its lower left corner
    texture_of  int32 (F,): which texture, -1 = none
    textures    RGB uint8 (H, W, 3) each
    """

    corners: np.ndarray
    colours: np.ndarray
    uv: np.ndarray
    texture_of: np.ndarray
    textures: tuple[np.ndarray, ...]

    @property
    def centres(self) -> np.ndarray:
        """Places (F, 3) that tell where the mesh is."""
        return self.corners.mean(1)

    def transformed(self, turn: np.ndarray) -> 'ColouredMesh':
        """Return the mesh with each point x at turn (3, 3) @ x."""
        return replace(self, corners=(self.corners @ turn.T).astype(np.float32))

    def colours_at(self, face: np.ndarray, second: np.ndarray, third: np.ndarray) -> np.ndarray:
        """
        Return RGB float32 (N, 3) in [0, 1] of points on the triangles `face` (N,).

        second, third: shares (N,) of the second and third corner; the rest is the first one's.
        """
        shares = np.stack([1 - second - third, second, third], -1).astype(np.float32)
        rgb = np.einsum('nc,ncv->nv', shares, self.colours[face])
        where = np.einsum('nc,ncv->nv', shares, self.uv[face])
        texture_of = self.texture_of[face]
        for index, texture in enumerate(self.textures):
            hit = texture_of == index
            if hit.any():
                rgb[hit] *= _looked_up(texture, where[hit]) / 255
        return rgb


def _looked_up(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Return RGB float32 (N, 3) at uv (N, 2), between texels; textures repeat beyond [0, 1]."""
    height, width = texture.shape[:2]
    x, y = uv[:, 0] * width - 0.5, (1 - uv[:, 1]) * height - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    across, down = (x - left)[:, None].astype(np.float32), (y - top)[:, None].astype(np.float32)
    columns, rows = (left % width, (left + 1) % width), (top % height, (top + 1) % height)
    above, below = (texture[row, columns[0]] * (1 - across) + texture[row, columns[1]] * across
                    for row in rows)
    return above * (1 - down) + below * down


def read_mesh(path: Path) -> ColouredMesh:
    """
    Read a mesh with a texture, or with colours of its vertices or faces.

    Raises SceneError for other files, and ConfigError where trimesh is not installed.
    """
    try:
        import trimesh
    except ImportError as error:
        raise ConfigError(f'{path}: reading a mesh needs {NEEDS}') from error
    try:
        # One by one: joining them would pack their textures into one.
        parts = [part for part in trimesh.load_scene(path, process=False).dump()
                 if isinstance(part, trimesh.Trimesh) and len(part.faces)]
    except Exception as error:  # Of broken files trimesh raises many types.
        raise SceneError(f'{path}: expected a mesh: {error!r}') from error
    if not parts:
        raise SceneError(f'{path}: expected a mesh with faces, there are none; a cloud of points '
                         'has no surface: make a mesh of it')
    if all(part.visual is None or part.visual.kind is None for part in parts):
        raise SceneError(f'{path}: expected a mesh with a texture or colours, it has none; for '
                         'an .obj the .mtl and the picture must lie beside it')
    textures: list[np.ndarray] = []
    pieces = zip(*(_piece(part, textures) for part in parts))
    corners, colours, uv, texture_of = (np.concatenate(piece) for piece in pieces)
    return ColouredMesh(corners, colours, uv, texture_of, tuple(textures))


def _piece(part: Any, textures: list[np.ndarray]) -> tuple[np.ndarray, ...]:
    """Return corners, colours, uv and texture_of of one mesh, and add its texture."""
    faces, visual = part.faces, part.visual
    colours: np.ndarray = np.ones((len(faces), 3, 3), np.float32)
    uv: np.ndarray = np.zeros((len(faces), 3, 2), np.float32)
    texture_of = np.full(len(faces), -1, np.int32)
    if visual.kind == 'vertex':
        colours = visual.vertex_colors[faces][..., :3] / 255
    elif visual.kind == 'face':
        colours = np.repeat(visual.face_colors[:, None, :3], 3, 1) / 255
    elif visual.kind == 'texture':
        picture = getattr(visual.material, 'baseColorTexture', None) or getattr(
            visual.material, 'image', None)
        if picture is not None and visual.uv is not None:
            texture_of[:], uv = len(textures), visual.uv[faces]
            textures.append(np.array(picture.convert('RGB')))
        else:
            own = visual.vertex_attributes.get('color')
            colours = (np.broadcast_to(visual.material.main_color[:3] / 255, colours.shape)
                       if own is None else own[faces][..., :3] / 255)
    return (np.asarray(part.vertices)[faces].astype(np.float32), colours.astype(np.float32),
            uv.astype(np.float32), texture_of)
