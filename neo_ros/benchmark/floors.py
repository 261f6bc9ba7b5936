"""
Is a large floor as good as one room? Floors of a building, from photos to a model.

    python -m neo_ros.benchmark.floors --work FOLDER [--rooms N ...] [--floors N] [--width PIXELS]

Each floor is photographed as a mapping robot does, and trained with the same steps a room; from
two tiles' width on that is tile by tile, see `field/tiles.py`.
"""
from collections.abc import Sequence
import json
from pathlib import Path
from typing import Annotated, Any, Optional

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.benchmark.building import look_for, measure_search, write_rows
from neo_ros.evaluation.baselines import NeoModel
from neo_ros.evaluation.evaluate import evaluate, TruthFrames
from neo_ros.evaluation.metrics import score_frame
from neo_ros.experiment import Experiment
from neo_ros.field.config import FieldConfig
from neo_ros.field.tiles import Tile
from neo_ros.flat.building import Building, open_building
from neo_ros.flat.building_plan import BuildingPlan
from neo_ros.flat.building_routes import corridor_drive
from neo_ros.flat.scene_writing import BUILDING_LIGHT, write_building_scene
from neo_ros.machine.progress import no_stage_progress, StageProgress
from neo_ros.outpaint.fitting import OutpaintConfig
from neo_ros.pipeline import train
from neo_ros.scenes.scene import read_scene
from neo_ros.training.tiles import tiles_of
import numpy as np
import typer

STEPS = 1000  # of a room's field, and of a tile's
APART = 0.6  # metres from any place to a keyframe: a few hundred on the largest floor
SEED = 1
LAYOUT = 'trained'
STEP, NEAR = 0.2, 0.5  # Metres from image to image in a corridor; from a border of two tiles.


def floor_experiment(rooms: int, tiled: bool) -> Experiment:
    """Return how a floor is trained: the same steps a room, or a tile; the network for minutes."""
    field = FieldConfig(steps=STEPS if tiled else STEPS * rooms)
    return Experiment(field=field, outpaint=OutpaintConfig(minutes=3),
                      memory=MemoryConfig(distance=APART))


def measure_floors(work: Path, plan: BuildingPlan, width: int, searches: int,
                   progress: StageProgress = no_stage_progress) -> dict[str, Any]:
    """Train on a building's floors, as far as `work` has nothing of it; return the row of it."""
    name = f'{plan.floors}x{plan.rooms}_rooms_{width}'
    folder = work / name
    write_building_scene(folder, plan, image_size=width, progress=progress)
    scene = read_scene(folder)
    tiles = tiles_of(scene, Experiment())
    run = train(folder, floor_experiment(plan.rooms * plan.floors, len(tiles) > 1),
                work / f'run_{name}', progress)
    model = NeoModel(run.model_path, threads=1)
    scores, = evaluate(scene.name, TruthFrames(scene.test, run.expansion), [model],
                       progress=lambda done: progress('scoring', done, len(scene.test or ())))
    # Through the door of the one room, of the same seed, which is the first of any building.
    first = [frame['ring_psnr'] for frame in scores.frames
             if frame['path_id'] == scores.frames[0]['path_id']]
    building = open_building(plan, folder / BUILDING_LIGHT)
    row = measure_search(LAYOUT, building, run.memory_path, run.expansion,
                         look_for(building, run.expansion.source, searches))
    return {**row, **measure_drive(model, building, tiles),
            'guided_ring_psnr': round(scores.estimates['ring_psnr'].mean, 2),
            'first_walk_ring_psnr': round(float(np.mean(first)), 2),
            'oracle_ring_psnr': round(run.figures['oracle_ring_psnr'], 2),
            'guided_share': round(scores.estimates['guided'].mean, 4),
            'tiles': len(tiles), 'photos': len(scene.train),
            'train_minutes': round(run.seconds / 60, 1)}


def measure_drive(model: NeoModel, building: Building, tiles: Sequence[Tile]
                  ) -> dict[str, float]:
    """
    Drive down the ground floor's corridor, to tell whether a seam shows; return keys of the row.

    corridor_guided_share and, of the guided images, corridor_ring_psnr and, of those taken less
    than NEAR metres from a border of tiles, border_ring_psnr.
    """
    poses = corridor_drive(building, 0, STEP)
    places = np.stack([pose.position for pose in poses])
    tile_of = np.stack([tile.holds(places) for tile in tiles]).argmax(0)
    borders = (places[1:] + places[:-1])[np.diff(tile_of) != 0] / 2
    model.reset()
    ring, guided, near = list[float](), list[bool](), list[bool]()
    for pose in poses:
        truth = building.render(model.expansion.target, pose)[0]
        wide = model.expand(np.ascontiguousarray(model.expansion.crop(truth)))
        ring.append(score_frame(truth, wide, model.expansion)['ring_psnr'])
        guided.append(bool(model.notes(pose)['guided']))
        near.append(bool((np.linalg.norm(borders - pose.position, axis=1) < NEAR).any()))
    scores, shown, at_border = np.array(ring), np.array(guided), np.array(near)
    figures = {'corridor_guided_share': shown.mean(), 'corridor_ring_psnr': scores[shown].mean()}
    if (shown & at_border).any():
        figures['border_ring_psnr'] = scores[shown & at_border].mean()
    return {name: round(float(value), 4) for name, value in figures.items()}


def _say(stage: str, done: int, total: int, note: str = '') -> None:
    """Print each tenth of a stage."""
    if 10 * done // total > 10 * (done - 1) // total:
        print(f'{stage} {done}/{total} {note}', flush=True)


def main(work: Annotated[Path, typer.Option(help='Keeps scenes and trainings.')],
         rooms: Annotated[Optional[list[int]], typer.Option(
             help='Of a floor; may be given again. Default: 1, 3 and 12.')] = None,
         floors: Annotated[int, typer.Option(help='That lie one upon the other.', min=1)] = 1,
         width: Annotated[int, typer.Option(help='Of the camera, pixels.', min=32)] = 128,
         searches: Annotated[int, typer.Option(help='In each building.', min=1)] = 100,
         out: Annotated[Path, typer.Option(help='JSON file of the rows; others stay.')] = Path(
             'results/building.json')) -> None:
    """Train on floors and measure them; a room takes some minutes, a break costs one at most."""
    for count in rooms or (1, 3, 12):
        row = measure_floors(work, BuildingPlan(floors=floors, rooms=count, seed=SEED), width,
                             searches, _say)
        known = json.loads(out.read_text()) if out.exists() else []
        known = [old for old in known if _which(old) != _which(row)] + [row]
        one_rooms = {old['camera']: old['guided_ring_psnr'] for old in known
                     if (old['layout'], old['floors'] * old['rooms']) == (LAYOUT, 1)}
        for new in known:
            if new['layout'] == LAYOUT:
                new['one_room_ring_psnr'] = one_rooms.get(new['camera'])
        write_rows(out, known)
        print(row, flush=True)


def _which(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[key] for key in ('layout', 'camera', 'floors', 'rooms'))


if __name__ == '__main__':
    typer.run(main)
