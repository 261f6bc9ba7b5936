"""Change a trained scene where bags of later days show that it has changed, and nowhere else."""
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
import math
from pathlib import Path
import shutil
import time

import cv2
from neo_ros.baking.changed_keyframes import bake_changes
from neo_ros.baking.keyframes import BakingRules, Photos, seen_by_photos
from neo_ros.errors import ConfigError, ModelError, SceneError
from neo_ros.experiment import Experiment
from neo_ros.field.mesh_field import MeshField
from neo_ros.field.rendering import world_rays
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import make_output_folder, share_file
from neo_ros.machine.progress import no_stage_progress, of_stage, StageProgress
from neo_ros.memory.landmarks import Landmarks
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.reports.report import Section, write_report
from neo_ros.runtime import FovExtrapolator, ModelCard
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import MemoryFile, read_model_card, Update, write_model_card
from neo_ros.scenes.scene import Scene
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.folder import check_run, note_update, scene_folder
from neo_ros.training.time_plan import PLAN_FILE, read_plan
from neo_ros.updating.changed_space import (
    ChangedSpace, find_changed_space, without_poor_places)
from neo_ros.updating.driven_photos import compared_with_memory, Drive, drive_through
from neo_ros.updating.more_photos import write_more_photos
from neo_ros.updating.refit import agreeing, Reaching, refit, shrunk_photos
from neo_ros.updating.update_report import update_sections
import numpy as np


@dataclass(frozen=True, kw_only=True)
class UpdateOptions:
    """What a user may say; topics as of a replay, minutes for the fit of the field."""

    image_topic: str | None = None
    info_topic: str | None = None
    rectify: bool = False
    minutes: float = math.inf


@dataclass(frozen=True, eq=False)
class UpdateRun:
    """A finished run: its folder, scene, settings and model."""

    folder: Path
    scene: Scene
    experiment: Experiment
    model: Path
    card: ModelCard
    memory: Path

    @classmethod
    def find(cls, folder: Path, scene: Path | None, experiment: Experiment | None) -> 'UpdateRun':
        """Raise NeoError for a folder that is no finished run with a memory and a fitted field."""
        if experiment is None:
            planned = (folder / PLAN_FILE).exists()
            experiment = read_plan(folder).experiment if planned else Experiment()
        found = read_upright_scene(scene or scene_folder(folder))
        check_run(folder, found, experiment)
        if not (folder / 'field.npz').exists():
            raise SceneError(f'{folder}: expected a finished run with its field.npz, there is '
                             'none; train it to the end, or anew')
        if MeshField.load(folder / 'field.npz') is not None:
            raise SceneError(f'{folder}: expected a field that was fitted to photos, got a mesh '
                             'or splats, which cannot be changed in part')
        model = folder / f'{found.name}.onnx'
        card = read_model_card(model)
        if card.memory is None:
            raise ModelError(f'{model}: expected a model with a scene memory; it has none')
        return cls(folder, found, experiment, model, card, memory_path(model, card.memory))


def update(run: Path, bags: Sequence[Path], out: Path, options: UpdateOptions = UpdateOptions(),
           scene: Path | None = None, experiment: Experiment | None = None,
           progress: StageProgress = no_stage_progress) -> list[int]:
    """
    Write into `out` the run as bags, the oldest first, show its scene; return places by bag.

    Where nothing has changed nothing is written. `out` appears whole or not at all. Raises
    NeoError for runs and bags that cannot be used.
    """
    if out.exists():
        raise ConfigError(f'{out}: expected a folder that does not exist yet; choose another')
    work = out.with_name(f'{out.name}.partial')
    shutil.rmtree(work, ignore_errors=True)  # What was broken off begins anew.
    try:
        return _update(run, bags, out, options, scene, experiment, progress, work)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _update(run: Path, bags: Sequence[Path], out: Path, options: UpdateOptions,
            scene: Path | None, experiment: Experiment | None, progress: StageProgress,
            work: Path) -> list[int]:
    newest, sections, found = run, list[Section](), list[int]()
    for index, bag in enumerate(bags):
        current = UpdateRun.find(newest, scene if newest == run else None, experiment)
        folder = make_output_folder(work / str(index))
        told = _update_once(current, bag, folder, options, progress)
        found.append(0 if told is None else told[0])
        if told is not None:
            newest, sections = folder, sections + told[1]
    if newest != run:
        write_report(newest / 'report.html', f'What has changed in {scene_folder(newest).name}',
                     sections)
        newest.rename(out)
    return found


def _update_once(run: UpdateRun, bag: Path, out: Path, options: UpdateOptions,
                 progress: StageProgress) -> tuple[int, list[Section]] | None:
    """Leave the run as a bag shows it in `out`; return places and a report, None if unchanged."""
    started, named = time.monotonic(), run.card.memory
    assert named is not None
    # A copy without a journal: what was learnt meanwhile would hide what has changed.
    model, memory_file = out / run.model.name, out / f'{run.model.stem}.memory'
    share_file(run.model, model)
    share_file(run.memory, memory_file)
    drive = drive_through(bag, FovExtrapolator.load(model), options.image_topic,
                          options.info_topic, options.rectify, of_stage(progress, bag.name))
    field = VoxelField.load(run.folder / 'field.npz')
    space = find_changed_space(field, drive)
    if not space.places:
        return None
    photos, chosen = _photos_that_see(run, field, space, drive)
    before = SceneMemory.read(memory_file, named.sha256)
    if chosen:
        space = without_poor_places(space, field, compared_with_memory(
            photos.images[:len(chosen)], photos.T_world_cam, photos.intrinsics, before,
            drive.small_camera.width))
    if not space.places:
        return None
    rules = BakingRules()
    seen, gains = seen_by_photos(field, photos, rules, of_stage(progress, 'depth of photos'))
    small = shrunk_photos(photos, rules.photo_focal)
    reached = np.stack([
        space.met_by(field, *world_rays(small.intrinsics, CameraPose(T)),
                     np.where(depth > 0, (1 + rules.one_surface) * depth, 0))
        for T, depth in zip(photos.T_world_cam, seen)])
    old, window = len(chosen), _window(run)
    assert small.usable is not None
    reached[:old] &= small.usable[:old]
    reached[old:] &= _shrunk(window, small.intrinsics.width, small.intrinsics.height)
    reaching = Reaching(small, gains, reached, old)
    changed = refit(field, space, reaching, run.experiment.field, run.experiment.seed,
                    options.minutes, of_stage(progress, 'field'))
    photos = replace(photos, usable=_agreed(photos, changed, reaching, window))
    seen, gains = seen_by_photos(changed, photos, rules, of_stage(progress, 'depth of photos'))
    after = before.replaced(bake_changes(
        changed, before, photos, seen, gains,
        lambda position, rays, reach: space.met_by(changed, position, rays, reach),
        of_stage(progress, 'keyframes')), _landmarks_outside(before.landmarks, field, space))
    sha256 = after.write(memory_file)
    changed.save(out / 'field.npz')
    write_model_card(model, replace(
        run.card, memory=MemoryFile(file=memory_file.name, sha256=sha256),
        updates=(*run.card.updates, Update(
            memory=named.sha256, bag=bag.name, photos=len(drive.photos),
            at=f'{datetime.now(timezone.utc):%Y-%m-%d %H:%M:%S}'))))
    write_more_photos(out / run.scene.name, run.scene, chosen, photos, old)
    note_update(out, run.folder, read_upright_scene(out / run.scene.name))
    for name in (PLAN_FILE, 'field.json'):
        if (run.folder / name).exists():
            share_file(run.folder / name, out / name)
    return len(space.places), update_sections(
        bag.name, run.scene, run.card.expansion, drive, space, before, after,
        time.monotonic() - started)


def _photos_that_see(run: UpdateRun, field: VoxelField, space: ChangedSpace, drive: Drive
                     ) -> tuple[Photos, list[int]]:
    """Return photos of before that may see changed space, which ones, and behind them new ones."""
    train, scale = run.scene.train, run.experiment.scale
    camera = train.intrinsics.scaled(scale)
    few = camera.scaled(min(BakingRules.photo_focal / 2 / camera.fx, 1.0))
    anywhere = np.zeros((few.height, few.width), np.float32)
    chosen = [index for index, pose in enumerate(train.poses)
              if space.met_by(field, *world_rays(few, pose), anywhere).any()]
    window = camera.window(run.card.expansion.source)
    size = (camera.height, camera.width)
    images = np.zeros((len(chosen) + len(drive.photos), *size, 3), np.uint8)
    usable = np.zeros(images.shape[:3], bool)
    for place, index in enumerate(chosen):
        images[place] = train.read_image(index, scale)
        mask = train.read_usable(index, scale)
        usable[place] = True if mask is None else mask
    for place, photo in enumerate(drive.photos, len(chosen)):
        images[place][window] = photo.image
        # Until the field shows what is new, its exposure is told by what agrees.
        usable[place][window] = ~_enlarged(photo.off, photo.image.shape[1], photo.image.shape[0])
    T = np.concatenate([train.T_world_cam[chosen], np.stack(
        [photo.pose.T_world_cam for photo in drive.photos])])
    return Photos(images, camera, T, usable), chosen


def _window(run: UpdateRun) -> np.ndarray:
    """Return which pixels of a photo the robot's camera sees, too: bool (H, W)."""
    camera = run.scene.train.intrinsics.scaled(run.experiment.scale)
    window = np.zeros((camera.height, camera.width), bool)
    window[camera.window(run.card.expansion.source)] = True
    return window


def _agreed(photos: Photos, field: VoxelField, reaching: Reaching, window: np.ndarray
            ) -> np.ndarray:
    """Tell which pixels show what is there now, bool (N, H, W): all new ones, old that agree."""
    assert photos.usable is not None
    usable = photos.usable.copy()
    wrong = reaching.reached & ~agreeing(field, reaching)
    for index in range(reaching.old):
        usable[index] &= ~_enlarged(wrong[index], window.shape[1], window.shape[0])
    usable[reaching.old:] = window
    return usable


def _enlarged(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    return cv2.resize(mask.astype(np.uint8), (width, height),
                      interpolation=cv2.INTER_NEAREST_EXACT) > 0


def _shrunk(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    return cv2.resize((~mask).astype(np.float32), (width, height),
                      interpolation=cv2.INTER_AREA) == 0


def _landmarks_outside(landmarks: Landmarks | None, field: VoxelField, space: ChangedSpace
                       ) -> Landmarks | None:
    """Leave out the landmarks that may be gone; None where none is left."""
    if landmarks is None:
        return None
    stay = ~space.holds(field, landmarks.points)
    return Landmarks(landmarks.points[stay], landmarks.descriptors[stay]) if stay.any() else None
