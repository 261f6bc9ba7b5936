"""Change a trained scene where bags of later days show that it has changed, and nowhere else."""
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
import logging
import math
from pathlib import Path
import shutil
import time

from neo_ros.bags.camera_choice import CameraChoice
from neo_ros.baking.landmarks import find_landmarks
from neo_ros.baking.memory_baking import make_keyframes
from neo_ros.errors import BagError, ConfigError
from neo_ros.experiment import Experiment
from neo_ros.field.voxel_field import VoxelField
from neo_ros.machine.files import make_output_folder, see_to_disk, share_file
from neo_ros.machine.progress import no_stage_progress, of_stage, StageProgress
from neo_ros.machine.ray_jobs import check_ray
from neo_ros.memory.landmarks import Landmarks
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.reports.report import Section, write_report
from neo_ros.runtime import FovExtrapolator
from neo_ros.runtime.model_card import MemoryFile, Update, write_model_card
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.folder import note_update, scene_folder
from neo_ros.training.time_plan import PLAN_FILE
from neo_ros.updating.changed_keyframes import (
    bake_changes, bake_changes_on_ray, ChangeRecipe)
from neo_ros.updating.changed_space import ChangedSpace, find_changed_space
from neo_ros.updating.compared_photos import compare, ComparedPhotos
from neo_ros.updating.driven_photos import Drive, drive_through
from neo_ros.updating.growth import grow, Growth, stand_outside
from neo_ros.updating.more_photos import write_more_photos
from neo_ros.updating.new_keyframes import (
    joined_floor, new_floor, new_positions, recipe_of, with_place)
from neo_ros.updating.photos_that_see import keep_photos, photos_that_see
from neo_ros.updating.placing import place_lost
from neo_ros.updating.refit import refit
from neo_ros.updating.tuned_network import CHECKPOINT, tune_network
from neo_ros.updating.turned_back import turn_back, TurnedBack
from neo_ros.updating.update_report import update_sections
from neo_ros.updating.update_run import UpdateRun
from neo_ros.updating.what_happened import what_happened
import numpy as np

logger = logging.getLogger(__name__)
# Lies in the folder of an update that is not finished: it may be deleted.
MARK = '.neo_update'


@dataclass(frozen=True, kw_only=True)
class UpdateOptions:
    """
    What a user may say; camera: of the bags; minutes for the fits of field and network.

    cluster: Ray's workers make the keyframes.
    """

    camera: CameraChoice = CameraChoice()
    minutes: float | None = None
    network_minutes: float | None = None
    cluster: bool = False

    def __post_init__(self) -> None:
        for name, value in (('minutes', self.minutes), ('network-minutes', self.network_minutes)):
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(f'--{name}: expected a number > 0, got {value}; leave it out, '
                                  'or give minutes')


def update(run: Path, bags: Sequence[Path], out: Path, options: UpdateOptions = UpdateOptions(),
           scene: Path | None = None, experiment: Experiment | None = None,
           progress: StageProgress = no_stage_progress) -> list[int | None]:
    """
    Write into `out` the run as bags, the oldest first, show its scene; return places by bag.

    None: that bag cannot be used, a warning says why, and the others were. Where nothing has
    changed nothing is written. `out` appears whole or not at all. Raises NeoError for runs that
    cannot be used, and where no bag can.
    """
    if out.exists():
        raise ConfigError(f'{out}: expected a folder that does not exist yet; choose another')
    if options.cluster:
        check_ray()
    work = out.with_name(f'{out.name}.partial')
    _remove_broken_off(work)
    try:
        return _update(run, bags, out, options, scene, experiment, progress, work)
    finally:
        _remove(work)


def _remove_broken_off(work: Path) -> None:
    """Remove what an earlier update left, which begins anew; ConfigError for anything else."""
    ours = work.is_dir() and not work.is_symlink() and (
        (work / MARK).exists() or not any(work.iterdir()))
    if ours:
        _remove(work)
    elif work.exists() or work.is_symlink():
        raise ConfigError(f'{work}: expected nothing there, or what an update left that was '
                          'broken off; it holds something else: move it away, or choose another '
                          '--out')


def _remove(work: Path) -> None:
    """Remove the folder of an update, its mark last: killed on the way, the rest is still ours."""
    for path in work.glob('*'):
        if path.name != MARK:
            shutil.rmtree(path, ignore_errors=True)
    shutil.rmtree(work, ignore_errors=True)


def _update(run: Path, bags: Sequence[Path], out: Path, options: UpdateOptions,
            scene: Path | None, experiment: Experiment | None, progress: StageProgress,
            work: Path) -> list[int | None]:
    newest, sections, found = run, list[Section](), list[int | None]()
    for index, bag in enumerate(bags):
        current = UpdateRun.find(newest, scene if newest == run else None, experiment,
                                 options.network_minutes is not None)
        (make_output_folder(work) / MARK).touch()
        folder = make_output_folder(work / str(index))
        try:
            told = update_once(current, bag, folder, options, progress)
        except BagError as error:
            if index + 1 == len(bags) and not any(one is not None for one in found):
                raise
            logger.warning('%s', error)
            found.append(None)
            continue
        found.append(0 if told is None else told[0])
        if told is not None:
            newest, sections = folder, sections + told[1]
    if newest != run:
        if options.network_minutes is not None:
            updated = UpdateRun.find(newest, None, experiment)
            tune_network(newest, updated.scene, updated.experiment, options.network_minutes,
                         progress)
        write_report(newest / 'report.html', f'What has changed in {scene_folder(newest).name}',
                     sections)
        # Else a power cut could leave the folder, and files without their content.
        for path in (*newest.rglob('*'), newest):
            see_to_disk(path)
        newest.rename(out)
    return found


def update_once(run: UpdateRun, bag: Path, out: Path, options: UpdateOptions,
                progress: StageProgress) -> tuple[int, list[Section]] | None:
    """Leave the run as a bag shows it in `out`; return places and a report, None if unchanged."""
    started, named = time.monotonic(), run.card.memory
    assert named is not None
    # A copy without a journal: what was learnt meanwhile would hide what has changed.
    model, memory_file = out / run.model.name, out / f'{run.model.stem}.memory'
    share_file(run.model, model)
    share_file(run.memory, memory_file)
    drive = drive_through(bag, FovExtrapolator.load(model), options.camera,
                          of_stage(progress, bag.name))
    field = VoxelField.load(run.folder / 'field.npz')
    before = SceneMemory.read(memory_file, named.sha256)
    drive, compared, growth = _grown(run, bag, field, before, drive, options.minutes, progress)
    if growth is not None:
        field = growth.field
    # The report tells of all that contradicts the memory, also of what was turned back.
    old, told = field, compared
    field, compared, fitted, back = _as_it_is_now(run, bag, field, drive, compared,
                                                  options.minutes, progress)
    changed = fitted.joined(back.space)
    space = changed if growth is None else growth.space.joined(changed)
    if not space.places:
        return None
    field.save(out / 'field.npz')
    source, scene = run.card.expansion.source, run.scene
    work = out.with_name(f'{out.name}.work')
    chosen, seen, wrong, right = photos_that_see(old, field, space, compared)
    kept = keep_photos(run, drive, compared, chosen, wrong, right, out / 'field.npz', work)
    photos, gains = kept.read_photos(), compared.gains[chosen]
    shared = kept if options.cluster else None
    if growth is not None:
        growth = replace(growth, field=field)
        floor = new_floor(growth, source, run.experiment.sampling, scene.walkable)
        if floor is not None and scene.walkable is not None:
            scene = replace(scene, walkable=joined_floor(scene.walkable, floor))
    write_more_photos(out / run.scene.name, scene, chosen, photos)
    updated = read_upright_scene(out / run.scene.name)
    landmarks = _changed_landmarks(run, before.landmarks, field, changed, updated.train,
                                   work / 'landmarks', progress)
    recipe = recipe_of(before, photos, seen, gains, source)
    change = ChangeRecipe(space, before, photos, seen, gains, recipe.directions)
    show = of_stage(progress, 'keyframes')
    after = before.replaced(
        bake_changes(change, field, show) if shared is None else bake_changes_on_ray(
            change, shared, (run.memory, named.sha256), work / 'changed', show),
        landmarks)
    if growth is not None:
        positions = new_positions(growth, floor, before, run.keyframes_apart)
        after = with_place(after, growth, recipe, positions, make_keyframes(
            recipe, field, positions, work / 'new', progress, scene=shared,
            stage='new keyframes'))
    sha256 = after.write(memory_file)
    write_model_card(model, replace(
        run.card, memory=MemoryFile(file=memory_file.name, sha256=sha256), scores={},
        updates=(*run.card.updates, Update(
            memory=named.sha256, bag=bag.name, photos=len(drive.poses),
            at=f'{datetime.now(timezone.utc):%Y-%m-%d %H:%M:%S}'))))
    run.past.with_more(old, field, fitted.cells, back.undone, len(run.card.updates) + 1,
                       _founders(chosen, compared, growth)).write(out)
    note_update(out, run.folder, updated)
    for name in (PLAN_FILE, 'field.json', CHECKPOINT):
        if (run.folder / name).exists():
            share_file(run.folder / name, out / name)
    return len(space.places), update_sections(
        bag.name, scene, run.card.expansion, drive, told, space.places,
        what_happened(old, field, space.places, told), before, after,
        time.monotonic() - started, growth, len(back.space.places))


def _grown(run: UpdateRun, bag: Path, field: VoxelField, before: SceneMemory, drive: Drive,
           minutes: float | None, progress: StageProgress
           ) -> tuple[Drive, ComparedPhotos, Growth | None]:
    """Return the drive, its photos compared, and the place that it shows and the scene had not."""
    train = len(run.scene.train)
    tied = place_lost(drive, run.card.expansion.source, of_stage(progress, 'poses of lost images'))
    placed, known = len(tied.poses), len(drive.poses)
    longer = drive.with_more([one.image for one in tied.images], tied.poses,
                             [one.number for one in tied.images])
    compared = compare(run.photos(longer, range(train + known + placed), run.small_camera), train,
                       before, of_stage(progress, 'photos'), elsewhere=tied.elsewhere,
                       earlier=run.earlier_changes(field, run.small_camera, known + placed))
    outside = stand_outside(compared, tied.elsewhere)
    growth = None
    if len(outside):
        chosen = [train + index for index in (*tied.beside, *range(known, known + placed))]
        growth = grow(field, compared, outside, tied, chosen,
                      run.photos(longer, chosen, run.fitted_camera),
                      run.experiment.field_config(run.scene.walkable is not None),
                      run.experiment.seed, minutes, of_stage(progress, 'new place'))
    lost = len(drive.lost) - len(tied.poses if growth is not None else ())
    if lost:
        logger.warning('%s: of %d images %d, taken where the memory knows little or nothing, '
                       'could not be placed: they change nothing', bag.name, drive.seen, lost)
    if growth is None:  # What was placed in the scene as it was teaches nothing new.
        return drive, compared.first(train + known), None
    return longer, compared, growth


def _as_it_is_now(run: UpdateRun, bag: Path, field: VoxelField, drive: Drive,
                  compared: ComparedPhotos, minutes: float | None, progress: StageProgress
                  ) -> tuple[VoxelField, ComparedPhotos, ChangedSpace, TurnedBack]:
    """Return the field as new photos show it, these compared anew, what was fitted and turned."""
    back = turn_back(field, compared, run.past, of_stage(progress, 'what was there before'))
    field, compared = back.field, back.compared
    try:
        space = find_changed_space(field, compared, other_light=drive.other_light)
    except BagError as error:
        raise BagError(f'{bag}: {error}') from error
    if space.places:
        field, space = refit(
            field, space, compared, lambda chosen: run.photos(drive, chosen, run.fitted_camera),
            run.experiment.field, run.experiment.seed, minutes, of_stage(progress, 'field'))
    return field, compared, space, back


def _founders(chosen: list[int], compared: ComparedPhotos, growth: Growth | None) -> np.ndarray:
    """Return the numbers, int32 (K,), that photos of a new place have in the updated scene."""
    placed = 0 if growth is None else len(growth.tied.poses)  # The last ones.
    new = [index for index in chosen if index >= compared.old]
    return np.array([compared.old + number for number, index in enumerate(new)
                     if index >= len(compared.photos.images) - placed], np.int32)


def _changed_landmarks(run: UpdateRun, old: Landmarks | None, field: VoxelField,
                       space: ChangedSpace, photos: PosedImages, work: Path,
                       progress: StageProgress) -> Landmarks | None:
    """Leave out the landmarks in a space, and put those there that the new photos show."""
    if old is None or not space.places:
        return old
    new = find_landmarks(photos.subset(range(len(run.scene.train), len(photos))),
                         run.experiment.scale, run.card.expansion.source, work, progress)
    return Landmarks.joined([old.subset(~space.holds(field, old.points)),
                             new and new.subset(space.holds(field, new.points))])
