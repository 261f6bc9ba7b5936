"""Baked light of the demo flat: irradiance on every face, by Monte Carlo with the same rays."""
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from neo_ros.errors import SceneError
from neo_ros.flat.bilinear import neighbours
from neo_ros.flat.raycast import cast_rays
from neo_ros.flat.rooms import demo_solids, LAMPS, WINDOWS
from neo_ros.flat.shapes import BOX, FACES, Solids
from neo_ros.flat.surfaces import chart_places, face_sizes, locate, SurfacePoints
from neo_ros.machine.compiled import njit
import numpy as np

BRIGHTEST = 5.0  # irradiance that is stored as 255; stored values are square roots
LIGHT_FILE = Path(__file__).with_name('light.npz')
WINDOW_RADIANCE = np.array([6.6, 7.0, 7.5])
LAMP_RADIANCE = np.array([15.0, 13.4, 11.0])
SUN_IRRADIANCE = np.array([9.0, 8.2, 6.9])  # on a face that looks at it
SUN_DISTANCE = 40.0  # metres; farther off a ray would not see what is a hand away
SUN_RADIUS = 0.01     # of its distance; edges of what it shines on are a little soft
Layout = tuple[np.ndarray, np.ndarray, np.ndarray]  # first texel, columns, rows of charts
# Of points on windows and lamps: where, normals, radiance, area.
Samples = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class LightQuality:
    """How finely light is baked: texels in metres, rays to each lamp or window, rays around."""

    texel: float = 0.11
    shadow_rays: int = 48
    bounce_rays: int = 96
    bounces: int = 7


FINE = LightQuality()


@dataclass(frozen=True)
class LightSources:
    """
    Where light comes from, metres.

    windows  each: axis of the wall's normal, its coordinate, from, to, sill, top, side of the room
    lamps    round ceiling lamps, each: x, y, radius
    sun      the way to it, if it shines into the windows
    """

    windows: tuple[tuple[int, float, float, float, float, float, int], ...]
    lamps: tuple[tuple[float, float, float], ...]
    sun: tuple[float, float, float] | None = None


DEMO_SOURCES = LightSources(WINDOWS, LAMPS)


@dataclass(frozen=True, eq=False)
class LightMap:
    """
    Irradiance of all charts in one row of texels.

    values float32 (T, 3); start (C,) first texel of a chart; columns, rows (C,) its size.
    """

    values: np.ndarray
    start: np.ndarray
    columns: np.ndarray
    rows: np.ndarray

    def look_up(self, places: SurfacePoints, wraps: np.ndarray) -> np.ndarray:
        """Interpolate the light at M points: float32 (M, 3); `wraps` (M,) closes round sides."""
        light = np.empty((len(places.solid), 3), np.float32)
        _look_up(self.values, self.start, self.columns, self.rows,
                 places.solid * FACES + places.face, places.across, places.up, wraps, light)
        return light


@njit(error_model='numpy', nogil=True)
def _look_up(values, starts, all_columns, all_rows, charts, across, up, wraps, light):
    one = np.float32(1)
    for m in range(len(charts)):
        chart = charts[m]
        columns = all_columns[chart]
        i0, i1, u = neighbours(across[m], columns, wraps[m])
        j0, j1, v = neighbours(up[m], all_rows[chart], False)
        j0, j1 = starts[chart] + j0 * columns, starts[chart] + j1 * columns
        for k in range(3):
            lower = values[j0 + i0, k] * (one - u) + values[j0 + i1, k] * u
            upper = values[j1 + i0, k] * (one - u) + values[j1 + i1, k] * u
            light[m, k] = lower * (one - v) + upper * v


def chart_layout(solids: Solids, texel: float = FINE.texel) -> Layout:
    """Return first texel, columns and rows of all charts, int32 (N * FACES,)."""
    counts = np.rint(face_sizes(solids) / texel).astype(np.int32)
    empty = (face_sizes(solids) == 0).any(axis=1)
    counts = np.where(empty[:, None], 0, np.maximum(counts, 1))
    is_round = np.repeat(solids.kind != BOX, FACES) & (np.arange(len(counts)) % FACES == 0)
    counts[is_round] = np.maximum(counts[is_round], (6, 2))
    total = counts.prod(axis=1)
    return ((np.cumsum(total) - total).astype(np.int32), counts[:, 0], counts[:, 1])


@lru_cache(maxsize=1)
def demo_light() -> LightMap:
    """Read the light that comes with the package; `bake_light` makes it anew."""
    start, columns, rows = chart_layout(demo_solids())
    with np.load(LIGHT_FILE) as file:
        codes = file['codes']
    if len(codes) != int((columns * rows).sum()):
        raise SceneError(f'{LIGHT_FILE.name}: expected {int((columns * rows).sum())} texels, got '
                         f'{len(codes)}; the flat was changed: run '
                         'python -m neo_ros.flat.light')
    values = (codes.astype(np.float32) / 255) ** 2 * np.float32(BRIGHTEST)
    return LightMap(values, start, columns, rows)


def bake_light(solids: Solids, sources: LightSources = DEMO_SOURCES,
               quality: LightQuality = FINE) -> np.ndarray:
    """Compute irradiance of all texels, float32 (T, 3); deterministic; about a minute."""
    layout = chart_layout(solids, quality.texel)
    points, normals, chart = _texels(solids, layout)
    direct = _direct(solids, points, normals, _light_samples(sources, quality.shadow_rays))
    targets = _bounce_targets(solids, points, normals, layout, quality.bounce_rays)
    values = direct
    for _ in range(quality.bounces):
        values = direct + _leaving(solids, chart, values)[targets].mean(axis=1)
    return _smooth(values, _inside_something(solids, points + 0.004 * normals), layout)


def gather_light(solids: Solids, known: np.ndarray, charts: np.ndarray,
                 quality: LightQuality = FINE) -> np.ndarray:
    """
    Compute irradiance of the texels of some charts anew, given that of all: float32 (t, 3).

    Light that is in balance comes out as it went in, up to smoothing and noise.
    """
    layout = chart_layout(solids, quality.texel)
    points, normals, chart = _texels(solids, layout)
    leaving = _leaving(solids, chart, known)
    keep = np.isin(chart, charts)
    targets = _bounce_targets(solids, points[keep], normals[keep], layout, quality.bounce_rays)
    samples = _light_samples(DEMO_SOURCES, quality.shadow_rays)
    return _direct(solids, points[keep], normals[keep], samples) + leaving[targets].mean(axis=1)


def _leaving(solids: Solids, chart: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the light each texel sends on, (T + 1, 3); the last row is the outside: none."""
    colours = np.array([m.colour for m in solids.materials], np.float32)[chart // FACES]
    glow = np.array([m.emission for m in solids.materials], np.float32)[chart // FACES]
    glow = np.where(glow < 1.5, glow, 0)[:, None] * 0.8  # ceiling lamps are in `_direct`
    return np.concatenate([colours * (values + glow), np.zeros((1, 3), np.float32)])


def _texels(solids: Solids, layout: Layout) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    _, columns, rows = layout
    points, normals, charts = [], [], []
    for chart in np.flatnonzero(columns).tolist():
        across, up = np.meshgrid((np.arange(columns[chart]) + 0.5) / columns[chart],
                                 (np.arange(rows[chart]) + 0.5) / rows[chart])
        p, n = chart_places(solids, chart // FACES, chart % FACES, across.ravel(), up.ravel())
        points.append(p)
        normals.append(n)
        charts.append(np.full(len(p), chart))
    return np.concatenate(points), np.concatenate(normals), np.concatenate(charts)


def _light_samples(sources: LightSources, n: int) -> Samples:
    """Return points, normals, radiance and area share of samples on windows and lamps."""
    rng = np.random.default_rng(77)
    points, normals, radiance, area = [], [], [], []
    for axis, wall, low, high, sill, top, side in sources.windows:
        along = (np.arange(n) + rng.random(n)) / n
        up = (rng.permutation(n) + rng.random(n)) / n
        p = np.empty((n, 3))
        p[:, axis], p[:, 1 - axis] = wall - 0.02 * side, low + along * (high - low)
        p[:, 2] = sill + up * (top - sill)
        normal = np.zeros(3)
        normal[axis] = side
        points.append(p)
        normals.append(np.tile(normal, (n, 1)))
        radiance.append(np.tile(WINDOW_RADIANCE, (n, 1)))
        area.append(np.full(n, (high - low) * (top - sill) / n))
    for x, y, radius in sources.lamps:
        m = n // 2
        turn, out = rng.random(m) * 2 * np.pi, radius * np.sqrt((np.arange(m) + 0.5) / m)
        points.append(np.stack([x + out * np.cos(turn), y + out * np.sin(turn),
                                np.full(m, 2.45)], axis=1))
        normals.append(np.tile((0.0, 0.0, -1.0), (m, 1)))
        radiance.append(np.tile(LAMP_RADIANCE, (m, 1)))
        area.append(np.full(m, np.pi * radius ** 2 / m))
    if sources.sun is not None:
        way = np.array(sources.sun) / np.linalg.norm(sources.sun)
        points.append(SUN_DISTANCE * way + rng.normal(0, SUN_DISTANCE * SUN_RADIUS, (n, 3)))
        normals.append(np.tile(-way, (n, 1)))
        radiance.append(np.tile(np.pi * SUN_IRRADIANCE, (n, 1)))
        area.append(np.full(n, SUN_DISTANCE ** 2 / n))
    return (np.concatenate(points), np.concatenate(normals), np.concatenate(radiance),
            np.concatenate(area))


def _direct(solids: Solids, points: np.ndarray, normals: np.ndarray,
            samples: Samples) -> np.ndarray:
    """Sum the light of all window and lamp samples that each texel sees; pi is left out."""
    total = np.zeros((len(points), 3), np.float32)
    everything = np.arange(len(solids))
    starts = points + 0.003 * normals
    for place, facing, radiance, area in zip(*samples):
        way = place - starts
        square = (way ** 2).sum(axis=1)
        length = np.sqrt(square)
        cosine = (way * normals).sum(axis=1) / length
        other = -(way @ facing) / length
        lit = np.flatnonzero((cosine > 0.001) & (other > 0.001))
        if not len(lit):
            continue
        hits = cast_rays(solids, everything, np.ascontiguousarray(starts[lit].T, np.float32),
                         np.ascontiguousarray(way[lit].T, np.float32))
        free = lit[(hits.distance >= 0.999) | (hits.solid < 0)]  # The sun is outside of all.
        weight = cosine[free] * other[free] * area / np.maximum(square[free], 0.02) / np.pi
        total[free] += (weight[:, None] * radiance).astype(np.float32)
    return total


def _bounce_targets(solids: Solids, points: np.ndarray, normals: np.ndarray,
                    layout: Layout, count: int) -> np.ndarray:
    """Return which texel cosine-distributed rays hit, (M, rays); T for the outside."""
    start, columns, rows = layout
    outside = int((columns * rows).sum())
    rng = np.random.default_rng(78)
    targets = np.empty((len(points), count), np.int32)
    origins = np.ascontiguousarray((points + 0.003 * normals).T, np.float32)
    for ray in range(count):
        height = (ray + rng.random(len(points))) / count
        turn = (ray * 0.618034 + rng.random(len(points))) * 2 * np.pi
        ball = np.sqrt(1 - (2 * height - 1) ** 2)
        sphere = np.stack([ball * np.cos(turn), ball * np.sin(turn), 2 * height - 1], axis=1)
        way = normals + sphere * 0.999
        way /= np.linalg.norm(way, axis=1, keepdims=True)
        directions = np.ascontiguousarray(way.T, np.float32)
        hits = cast_rays(solids, np.arange(len(solids)), origins, directions)
        inside = np.flatnonzero(hits.solid >= 0)
        places = locate(solids, hits.solid[inside],
                        (origins + directions * hits.distance).T[inside], directions.T[inside])
        target = places.solid.astype(np.int64) * FACES + places.face
        i = np.minimum((places.across * columns[target]).astype(int), columns[target] - 1)
        j = np.minimum((places.up * rows[target]).astype(int), rows[target] - 1)
        targets[:, ray] = outside
        targets[inside, ray] = start[target] + j * columns[target] + i
    return targets


def _inside_something(solids: Solids, points: np.ndarray) -> np.ndarray:
    inside = np.zeros(len(points), bool)
    for index in np.flatnonzero((solids.kind == BOX) & (solids.yaw == 0)):
        inside |= (np.abs(points - solids.centre[index]) < solids.half[index]).all(axis=1)
    return inside


def _smooth(values: np.ndarray, buried: np.ndarray, layout: Layout) -> np.ndarray:
    """Average each texel with its neighbours; texels inside other solids take from outside."""
    start, columns, rows = layout
    result = values.copy()
    for chart in np.flatnonzero(columns):
        part = slice(start[chart], start[chart] + columns[chart] * rows[chart])
        grid = values[part].reshape(rows[chart], columns[chart], 3)
        weight = np.where(buried[part].reshape(rows[chart], columns[chart], 1), 1e-6, 1.0)
        total = np.pad(grid * weight, ((1, 1), (1, 1), (0, 0)))
        weight = np.pad(weight, ((1, 1), (1, 1), (0, 0)))
        sums = []
        for array in (total, weight):
            array = array[:-2] + 2 * array[1:-1] + array[2:]
            sums.append(array[:, :-2] + 2 * array[:, 1:-1] + array[:, 2:])
        result[part] = (sums[0] / sums[1]).reshape(-1, 3)
    return result


def write_light(path: Path = LIGHT_FILE) -> None:
    """Bake the light anew and write it."""
    values = bake_light(demo_solids())
    codes = np.rint(np.sqrt(np.clip(values / BRIGHTEST, 0, 1)) * 255).astype(np.uint8)
    np.savez_compressed(path, codes=codes)


if __name__ == '__main__':
    write_light()
