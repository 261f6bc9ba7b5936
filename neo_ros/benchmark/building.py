"""
Is a room taken for another one that looks alike? Searches in synthetic buildings, in figures.

    python -m neo_ros.benchmark.building --work FOLDER [--layout NAME]

The memory is made of exact depth and colours, see `true_memory.py`: what is measured is the
search, not a field. `before` is the search that believes the best place it finds.
"""
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
import json
import multiprocessing
from pathlib import Path
import time
from typing import Annotated, Any, Optional

from neo_ros.benchmark.method_memory import resident_mb
from neo_ros.benchmark.true_memory import true_memory
from neo_ros.flat.building import build_building, Building
from neo_ros.flat.building_plan import BuildingPlan, FLOOR_HEIGHT
from neo_ros.flat.building_routes import door_walks
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.geometry.camera_pose import rotation_angle
from neo_ros.machine.files import sha256_of, whole_file
from neo_ros.machine.host import commit, core_count, host
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.thresholds import AmbiguityThresholds, GuideThresholds
import numpy as np
import typer

LAYOUTS: Mapping[str, BuildingPlan] = {
    'a floor of 1': BuildingPlan(rooms=1, seed=1), 'a floor of 3': BuildingPlan(rooms=3, seed=1),
    'all different': BuildingPlan(rooms=12, seed=1),
    'alike to 80 %': BuildingPlan(rooms=12, seed=1, alike=0.8),
    'alike to 95 %': BuildingPlan(rooms=12, seed=1, alike=0.95),
    'twins': BuildingPlan(rooms=12, seed=1, twins=6),
    'twins but one picture': BuildingPlan(rooms=12, seed=1, twins=6, own_picture=True),
    'all equal': BuildingPlan(rooms=12, seed=1, alike=1.0),
    'two equal floors': BuildingPlan(floors=2, rooms=6, seed=1, equal_floors=True),
    'two floors': BuildingPlan(floors=2, rooms=6, seed=1),
    'a floor of 50': BuildingPlan(rooms=50, seed=1),
    'two floors of 50': BuildingPlan(floors=2, rooms=50, seed=1)}
UNMEASURED = ('guided_ring_psnr', 'one_room_ring_psnr', 'guided_share', 'train_minutes')


@dataclass(frozen=True)
class BuildingRules:
    """What is searched for, and what counts as wrong."""

    width: int = 64  # pixels of the camera's image; the wide view is twice as wide
    # A pose this far from the true one is a wrong place.
    wrong_metres: float = 0.5
    wrong_degrees: float = 10.0
    # A camera right before a wall sees nothing: the median of the depth, metres.
    least_depth: float = 0.8
    walk_frames: int = 25
    walk_seeds: tuple[int, ...] = (1, 2, 3)  # each gives other walks through the same doors
    cab_frames: int = 10  # of a lift's walls, while a camera is taken to another floor
    # How far off a prior is, as a click on a map: its height is the floor's.
    prior_metres: float = 0.7
    prior_degrees: float = 30.0


@dataclass
class Counts:
    """What became of searches and walks; times of the processor, ms."""

    wrong: int = 0
    ambiguous: int = 0
    lost: int = 0
    by_landmarks: int = 0
    prior_right: int = 0
    prior_wrong: int = 0
    walks: int = 0
    walks_found_right: int = 0
    walks_ever_wrong: int = 0
    rides: int = 0
    rides_found_right: int = 0
    rides_ever_wrong: int = 0
    search_ms: list[float] = field(default_factory=list)
    follow_ms: list[float] = field(default_factory=list)


def measure_layout(name: str, plan: BuildingPlan, work: Path, searches: int,
                   rules: BuildingRules = BuildingRules()) -> list[dict[str, Any]]:
    """Search in one building, before and after; keeps light and memory in `work`."""
    work.mkdir(parents=True, exist_ok=True)
    tag = name.replace(' ', '_').replace('%', 'percent')
    source = Intrinsics.from_hfov(rules.width, rules.width, np.pi / 2)
    expansion = ViewExpansion.to_size(source, 2 * rules.width, 2 * rules.width)
    building = build_building(plan, work / f'{tag}.light.npz', workers=core_count())
    path = work / f'{tag}.{rules.width}.memory'
    _make_memory(building, expansion, path)
    views = look_for(building, source, searches, rules)
    rows = [measure_search(name, building, path, expansion, views, rivals, rules)
            for rivals in (True, False)]
    return rows[::-1]


def look_for(building: Building, source: Intrinsics, count: int,
             rules: BuildingRules = BuildingRules()) -> list[tuple[np.ndarray, CameraPose]]:
    """Return so many images to search by, all over the ground floor, with their poses."""
    return [(building.render(source, pose)[0], pose)
            for pose in _places(building, source, count, rules)]


def measure_search(layout: str, building: Building, path: Path, expansion: ViewExpansion,
                   views: Sequence[tuple[np.ndarray, CameraPose]], rivals: bool = True,
                   rules: BuildingRules = BuildingRules()) -> dict[str, Any]:
    """Search by images in the memory of a file, walk through doors; return the row of it."""
    sha256 = sha256_of(path)
    # In a process of its own: the building is no part of it.
    with ProcessPoolExecutor(1, multiprocessing.get_context('spawn')) as other:
        resident = other.submit(_resident_mb, path, sha256, expansion).result()
    limits = AmbiguityThresholds() if rivals else AmbiguityThresholds(most_rivals=0)
    guide = SceneGuide(SceneMemory.read(path, sha256), expansion, threads=1, thresholds=replace(
        GuideThresholds(), ambiguity=limits))
    guide.warm_up()
    counts, plan, source = Counts(), building.plan, expansion.source
    for image, pose in views:
        _search(guide, image, pose, rules, counts)
    for (image, pose), click in zip(views, _clicks(views, rules)):
        _search_around(guide, image, click, pose, rules, counts)
    _walk(building, source, guide, rules, counts)
    if plan.floors > 1:
        _ride(building, source, guide, rules, counts)
    return {
        'layout': layout, 'search': 'compared with rivals' if rivals else 'before',
        'area_m2': round(plan.area), 'floors': plan.floors, 'rooms': plan.rooms,
        'camera': f'{source.width}x{source.height}', **dict.fromkeys(UNMEASURED),
        'follow_ms_p95': (_rounded(np.percentile(counts.follow_ms, 95))
                          if counts.follow_ms else None),
        'found_ms_median': _rounded(np.median(counts.search_ms)),
        'found_ms_p95': _rounded(np.percentile(counts.search_ms, 95)),
        'searches': len(views), 'wrong_places': counts.wrong, 'ambiguous': counts.ambiguous,
        'lost': counts.lost, 'by_landmarks': counts.by_landmarks,
        'prior_right': counts.prior_right, 'prior_wrong': counts.prior_wrong,
        'door_walks': counts.walks, 'walks_found_right': counts.walks_found_right,
        'walks_ever_wrong': counts.walks_ever_wrong, 'lift_rides': counts.rides,
        'rides_found_right': counts.rides_found_right, 'rides_ever_wrong': counts.rides_ever_wrong,
        'file_mb': _rounded(path.stat().st_size / 1e6), 'resident_mb': _rounded(resident),
        'commit': commit(), 'host': host()}


def _rounded(value: Any) -> float:
    return round(float(value), 1)


def _make_memory(building: Building, expansion: ViewExpansion, path: Path) -> None:
    """Write a building's memory, if it is not there: a broken-off run leaves none."""
    if not path.exists():
        true_memory(building, expansion).write(path)


def _resident_mb(path: Path, sha256: str, expansion: ViewExpansion) -> float:
    """Return by how many MB a process grows that looks at all of a memory, and searches in it."""
    before = resident_mb('VmRSS')
    guide = SceneGuide(SceneMemory.read(path, sha256), expansion, threads=1)
    guide.warm_up()
    positions = guide.renderer.memory.positions.tolist()
    for index, (x, y, z) in enumerate(positions):
        view = guide.renderer.render(CameraPose.from_planar(x, y, z, 0.0), expansion.target)
        if index % max(len(positions) // 100, 1) == 0:  # A hundred searches and a few.
            guide.reset()
            guide.guide(view.image[expansion.observed].astype(np.uint8))
    return resident_mb('VmRSS') - before


def _search(guide: SceneGuide, image: np.ndarray, pose: CameraPose, rules: BuildingRules,
            counts: Counts) -> None:
    guide.reset()
    started = time.process_time()
    found = guide.guide(image)
    counts.search_ms.append(1e3 * (time.process_time() - started))
    if found is None:
        counts.ambiguous += guide.ambiguous
        counts.lost += not guide.ambiguous
    else:
        counts.wrong += _is_wrong(found.pose, pose, rules)
        counts.by_landmarks += found.found == 'landmarks'


def _search_around(guide: SceneGuide, image: np.ndarray, prior: CameraPose, pose: CameraPose,
                   rules: BuildingRules, counts: Counts) -> None:
    guide.reset()
    found = guide.guide(image, prior)
    if found is not None:
        wrong = _is_wrong(found.pose, pose, rules)
        counts.prior_wrong += wrong
        counts.prior_right += not wrong


def _clicks(views: Sequence[tuple[np.ndarray, CameraPose]], rules: BuildingRules
            ) -> Iterator[CameraPose]:
    """Yield for each image where somebody clicks on a map of its floor."""
    random, most = np.random.default_rng(6), np.radians(rules.prior_degrees)
    for _, pose in views:
        away, way = random.uniform(0, rules.prior_metres), random.uniform(-np.pi, np.pi)
        x, y, z = pose.position
        yield CameraPose.from_planar(
            x + away * np.cos(way), y + away * np.sin(way), FLOOR_HEIGHT * (z // FLOOR_HEIGHT),
            pose.yaw + random.uniform(-most, most))


def _places(building: Building, source: Intrinsics, count: int, rules: BuildingRules
            ) -> Iterator[CameraPose]:
    """Yield poses all over the ground floor, in any direction."""
    random, walkable, given = np.random.default_rng(5), building.walkable(), 0
    while given < count:
        (x, y), = walkable.sample(random, 1).tolist()
        pose = CameraPose.from_planar(x, y, walkable.camera_height, random.uniform(-np.pi, np.pi))
        if np.median(building.depth(source, pose)) >= rules.least_depth:
            given += 1
            yield pose


def _walks(building: Building, rules: BuildingRules) -> list[list[CameraPose]]:
    return [walk for seed in rules.walk_seeds
            for walk in door_walks(building, 0, rules.walk_frames, seed)]


def _follow(building: Building, source: Intrinsics, guide: SceneGuide,
            walk: Sequence[CameraPose], rules: BuildingRules, follow_ms: list[float]
            ) -> tuple[bool, bool]:
    """Return whether a walk ends at the right place, and whether it was ever at a wrong one."""
    right = ever_wrong = False
    for pose in walk:
        image = building.render(source, pose)[0]
        started = time.process_time()
        found = guide.guide(image)
        if found is not None and found.found == 'tracked':
            follow_ms.append(1e3 * (time.process_time() - started))
        wrong = found is not None and _is_wrong(found.pose, pose, rules)
        right, ever_wrong = found is not None and not wrong, ever_wrong or wrong
    return right, ever_wrong


def _walk(building: Building, source: Intrinsics, guide: SceneGuide, rules: BuildingRules,
          counts: Counts) -> None:
    """Walk 2 m through each of some doors."""
    for walk in _walks(building, rules):
        guide.reset()
        right, ever_wrong = _follow(building, source, guide, walk, rules, counts.follow_ms)
        counts.walks += 1
        counts.walks_found_right += right
        counts.walks_ever_wrong += ever_wrong


def _ride(building: Building, source: Intrinsics, guide: SceneGuide, rules: BuildingRules,
          counts: Counts) -> None:
    """Walk through doors, each time first on the ground floor, known by a prior, then above it."""
    cab = _cab(source)
    for walk in _walks(building, rules):
        guide.reset()
        guide.guide(building.render(source, walk[0])[0], walk[0])
        _follow(building, source, guide, walk[1:], rules, [])
        for _ in range(rules.cab_frames):
            guide.guide(cab)
        above = [CameraPose.from_planar(pose.position[0], pose.position[1],
                                        pose.position[2] + FLOOR_HEIGHT, pose.yaw)
                 for pose in walk]
        right, ever_wrong = _follow(building, source, guide, above, rules, [])
        counts.rides += 1
        counts.rides_found_right += right
        counts.rides_ever_wrong += ever_wrong


def _cab(source: Intrinsics) -> np.ndarray:
    """Return an image of brushed steel with a door's gap in the middle, uint8 RGB (h, w, 3)."""
    random = np.random.default_rng(7)
    columns = 150 + 12 * random.standard_normal(source.width)
    columns[source.width // 2] = 30
    rows = np.linspace(0.8, 1.1, source.height)
    steel = rows[:, None] * columns + random.standard_normal((source.height, source.width))
    return np.repeat(steel[..., None].clip(0, 255).astype(np.uint8), 3, axis=2)


def _is_wrong(found: CameraPose, true: CameraPose, rules: BuildingRules) -> bool:
    turn = rotation_angle(found.T_world_cam[:3, :3].T @ true.T_world_cam[:3, :3])
    return bool(np.linalg.norm(found.position - true.position) > rules.wrong_metres
                or np.degrees(turn) > rules.wrong_degrees)


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows, each on a line."""
    with whole_file(path) as partial:
        partial.write_text('[\n' + ',\n'.join(json.dumps(row) for row in rows) + '\n]\n')


def main(work: Annotated[Path, typer.Option(help='Keeps buildings and memories.')],
         layouts: Annotated[Optional[list[str]], typer.Option(
             '--layout', help='Only this one, other rows stay; may be given again. '
                              + ', '.join(LAYOUTS))] = None,
         out: Annotated[Path, typer.Option(help='JSON file of the rows.')] = Path(
             'results/building.json'),
         searches: Annotated[int, typer.Option(help='In each building.', min=1)] = 100) -> None:
    """Measure all layouts; a building takes minutes, one of 100 rooms 40, and is made once."""
    known = json.loads(out.read_text()) if out.exists() else []
    for name in layouts or LAYOUTS:
        if name not in LAYOUTS:
            raise typer.BadParameter(f'expected one of {", ".join(LAYOUTS)}, got {name}')
        rows = measure_layout(name, LAYOUTS[name], work, searches)
        known = [row for row in known if row['layout'] != name] + rows
        # Floors that were trained come last, see `floors.py`.
        known.sort(key=lambda row: [*LAYOUTS, row['layout']].index(row['layout']))
        write_rows(out, known)
        for row in rows:
            print({key: value for key, value in row.items() if value is not None}, flush=True)


if __name__ == '__main__':
    typer.run(main)
