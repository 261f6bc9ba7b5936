"""
Is a room taken for another one that looks alike? Searches in synthetic buildings, in figures.

    python -m neo_ros.benchmark.building --work FOLDER [--out results/building.json]

The memory is made of exact depth and colours, see `true_memory.py`: what is measured is the
search, not a field. `before` is the search that believes the best place it finds.
"""
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import json
from pathlib import Path
import time
from typing import Annotated, Any

from neo_ros.benchmark.true_memory import true_memory
from neo_ros.flat.building import build_building, Building
from neo_ros.flat.building_plan import BuildingPlan
from neo_ros.flat.building_routes import door_walks
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.geometry.camera_pose import rotation_angle
from neo_ros.machine.files import whole_file
from neo_ros.machine.host import commit, core_count, host
from neo_ros.memory.scene_guide import SceneGuide
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import AmbiguityThresholds, GuideThresholds
import numpy as np
import typer

LAYOUTS: Mapping[str, BuildingPlan] = {
    'all different': BuildingPlan(rooms=12, seed=1),
    'alike to 80 %': BuildingPlan(rooms=12, seed=1, alike=0.8),
    'alike to 95 %': BuildingPlan(rooms=12, seed=1, alike=0.95),
    'twins': BuildingPlan(rooms=12, seed=1, twins=6),
    'twins but one picture': BuildingPlan(rooms=12, seed=1, twins=6, own_picture=True)}
UNMEASURED = ('guided_ring_psnr', 'one_room_ring_psnr', 'guided_share', 'follow_ms_p95',
              'resident_mb', 'train_minutes')


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


def measure_layout(name: str, plan: BuildingPlan, work: Path, searches: int,
                   rules: BuildingRules = BuildingRules()) -> list[dict[str, Any]]:
    """Search in one building, before and after; keeps light and memory in `work`."""
    work.mkdir(parents=True, exist_ok=True)
    tag = name.replace(' ', '_').replace('%', 'percent')
    source = Intrinsics.from_hfov(rules.width, rules.width, np.pi / 2)
    expansion = ViewExpansion.to_size(source, 2 * rules.width, 2 * rules.width)
    building = build_building(plan, work / f'{tag}.light.npz', workers=core_count())
    memory, megabytes = _memory(building, expansion, work / f'{tag}.{rules.width}.memory')
    rows = []
    for rivals in (False, True):
        limits = AmbiguityThresholds() if rivals else AmbiguityThresholds(starts=0)
        guide = SceneGuide(memory, expansion, thresholds=replace(
            GuideThresholds(), ambiguity=limits))
        guide.warm_up()
        counts = {'wrong': 0, 'ambiguous': 0, 'lost': 0}
        spent = []
        for pose in _places(building, source, searches, rules):
            image, _ = building.render(source, pose)
            guide.reset()
            started = time.perf_counter()
            found = guide.guide(image)
            spent.append(1e3 * (time.perf_counter() - started))
            if found is None:
                counts['ambiguous' if guide.ambiguous else 'lost'] += 1
            else:
                counts['wrong'] += _is_wrong(found.pose, pose, rules)
        resolved, wrong, walks = _walk(building, source, guide, rules)
        rows.append({
            'layout': name, 'search': 'compared with rivals' if rivals else 'before',
            'area_m2': round(plan.area), 'floors': plan.floors, 'rooms': plan.rooms,
            'camera': f'{rules.width}x{rules.width}', **dict.fromkeys(UNMEASURED),
            'found_ms_median': round(float(np.median(spent)), 1),
            'found_ms_p95': round(float(np.percentile(spent, 95)), 1),
            'searches': searches, 'wrong_places': counts['wrong'],
            'ambiguous': counts['ambiguous'], 'lost': counts['lost'],
            'door_walks': walks, 'walks_found_right': resolved, 'walks_ever_wrong': wrong,
            'file_mb': round(megabytes, 1), 'commit': commit(), 'host': host()})
    return rows


def _memory(building: Building, expansion: ViewExpansion, path: Path
            ) -> tuple[SceneMemory, float]:
    note = path.with_suffix('.sha256')
    if not note.exists():
        note.write_text(true_memory(building, expansion).write(path))
    return SceneMemory.read(path, note.read_text()), path.stat().st_size / 1e6


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


def _walk(building: Building, source: Intrinsics, guide: SceneGuide, rules: BuildingRules
          ) -> tuple[int, int, int]:
    """Walk 2 m through each of some doors: how often found right at the end, ever wrong."""
    resolved = wrong = 0
    walks = door_walks(building, 0, rules.walk_frames, 1)
    for walk in walks:
        guide.reset()
        ever, found, pose = False, None, walk[0]
        for pose in walk:
            found = guide.guide(building.render(source, pose)[0])
            ever |= found is not None and _is_wrong(found.pose, pose, rules)
        resolved += found is not None and not _is_wrong(found.pose, pose, rules)
        wrong += ever
    return resolved, wrong, len(walks)


def _is_wrong(found: CameraPose, true: CameraPose, rules: BuildingRules) -> bool:
    turn = rotation_angle(found.T_world_cam[:3, :3].T @ true.T_world_cam[:3, :3])
    return bool(np.linalg.norm(found.position - true.position) > rules.wrong_metres
                or np.degrees(turn) > rules.wrong_degrees)


def write_rows(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows, each on a line."""
    with whole_file(path) as partial:
        partial.write_text('[\n' + ',\n'.join(json.dumps(row) for row in rows) + '\n]\n')


def main(work: Annotated[Path, typer.Option(help='Keeps buildings and memories.')],
         out: Annotated[Path, typer.Option(help='JSON file of the rows.')] = Path(
             'results/building.json'),
         searches: Annotated[int, typer.Option(help='In each building.', min=1)] = 100) -> None:
    """Measure all layouts; a building takes minutes, and is made once."""
    rows: list[dict[str, Any]] = []
    for name, plan in LAYOUTS.items():
        rows += measure_layout(name, plan, work, searches)
        write_rows(out, rows)
        for row in rows[-2:]:
            print({key: value for key, value in row.items() if value is not None}, flush=True)


if __name__ == '__main__':
    typer.run(main)
