"""The run that is updated, and its photos with those of a drive behind them."""
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
from neo_ros.baking.keyframes import BakingRules, clear_pixels, MemoryConfig, Photos
from neo_ros.errors import ModelError, SceneError
from neo_ros.experiment import Experiment
from neo_ros.field.mesh_field import MeshField
from neo_ros.field.voxel_field import VoxelField
from neo_ros.geometry import Intrinsics
from neo_ros.pictures.usable import shrunk
from neo_ros.runtime import ModelCard
from neo_ros.runtime.fov_extrapolator import memory_path
from neo_ros.runtime.model_card import read_model_card
from neo_ros.scenes.scene import Scene
from neo_ros.scenes.upright import read_upright_scene
from neo_ros.training.folder import check_run, named_as_trained, scene_folder
from neo_ros.training.time_plan import settings_of
from neo_ros.updating.compared_photos import EarlierChanges
from neo_ros.updating.driven_photos import Drive
from neo_ros.updating.more_photos import read_stale
from neo_ros.updating.past import Past
from neo_ros.updating.tuned_network import CHECKPOINT
import numpy as np


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
    def find(cls, folder: Path, scene: Path | None, experiment: Experiment | None,
             tuned: bool = False) -> 'UpdateRun':
        """
        Raise NeoError for a folder that is no finished run with a memory and a fitted field.

        tuned: its network is to be trained on.
        """
        experiment = settings_of(folder, experiment)
        found = named_as_trained(read_upright_scene(scene or scene_folder(folder)), folder)
        check_run(folder, found, experiment, tuned)
        if not (folder / 'field.npz').exists():
            raise SceneError(f'{folder}: expected a finished run with its field.npz, there is '
                             'none; train it to the end, or anew')
        if tuned and not (folder / CHECKPOINT).exists():
            raise SceneError(f'{folder}: expected {CHECKPOINT} to train its network on, there is '
                             'none; leave out --network-minutes, or train it anew')
        if MeshField.load(folder / 'field.npz') is not None:
            raise SceneError(f'{folder}: expected a field that was fitted to photos, got a mesh '
                             'or splats, which cannot be changed in part')
        model = folder / f'{found.name}.onnx'
        card = read_model_card(model)
        if card.memory is None:
            raise ModelError(f'{model}: expected a model with a scene memory; it has none')
        return cls(folder, found, experiment, model, card, memory_path(model, card.memory))

    @property
    def keyframes_apart(self) -> float:
        """Metres from any place to the nearest keyframe, at most."""
        return (self.experiment.memory or MemoryConfig()).distance

    @property
    def camera(self) -> Intrinsics:
        """The camera of photos at the resolution of the wide views."""
        return self.scene.train.intrinsics.scaled(self.experiment.scale)

    @property
    def small_camera(self) -> Intrinsics:
        """The same, as fine as the field shows."""
        return self.camera.scaled(min(BakingRules.photo_focal / self.camera.fx, 1.0))

    @property
    def fitted_camera(self) -> Intrinsics:
        """The camera of photos as the field is fitted to them."""
        return self.scene.train.intrinsics.scaled(self.experiment.field_scale)

    @cached_property
    def past(self) -> Past:
        """What earlier updates changed. Raises SceneError."""
        return Past.read(self.folder)

    def image(self, drive: Drive, index: int) -> np.ndarray:
        """
        Return photo `index` of the run, or of the drive behind them: uint8 RGB (H, W, 3).

        One of the drive stands in the middle of a black one.
        """
        train, camera = self.scene.train, self.camera
        if index < len(train):
            return train.read_image(index, self.experiment.scale)
        image = np.zeros((camera.height, camera.width, 3), np.uint8)
        image[camera.window(self.card.expansion.source)] = drive.images[index - len(train)]
        return image

    def masks(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """
        Return what of a photo of `image` shows the scene now, and what did once, bool (H, W) each.

        The second is what an update found out of date.
        """
        train, camera = self.scene.train, self.camera
        size = (camera.width, camera.height)
        now, stale = np.zeros((2, camera.height, camera.width), bool)
        if index >= len(train):
            now[camera.window(self.card.expansion.source)] = True
            return now, stale
        full, gone = train.read_usable(index), read_stale(train, index)
        now = ~now if full is None else shrunk(full, *size)
        if full is not None and gone is not None:
            # A pixel of a smaller size, a part of which is out of date, was usable once.
            stale = shrunk(full | gone, *size) & ~now
        return now, stale

    def earlier_changes(self, field: VoxelField, camera: Intrinsics, more: int
                        ) -> EarlierChanges:
        """
        Return what earlier updates changed, for the scene's photos and `more` of the drive.

        What is out of date is so in pixels of a smaller camera; also of a scene that was trained
        anew since.
        """
        train = self.scene.train
        stale = np.zeros((len(train) + more, camera.height, camera.width), bool)
        for index in range(len(train)):
            now, fine = self.masks(index)
            if fine.any():
                stale[index] = clear_pixels(now | fine, camera) & ~clear_pixels(now, camera)
        # Each update gave its photos a number of their own.
        ids = np.array(train.path_ids)
        updates = np.maximum(ids - (ids.max() - len(self.card.updates)), 0).astype(np.int32)
        founders = (updates == 0) | np.isin(np.arange(len(train)), self.past.founders)
        return EarlierChanges(field, self.past.dates(field), updates, founders, stale)

    def photos(self, drive: Drive, chosen: Sequence[int], camera: Intrinsics) -> Photos:
        """Return photos as a camera of fewer pixels sees them."""
        images = np.empty((len(chosen), camera.height, camera.width, 3), np.uint8)
        usable = np.ones(images.shape[:3], bool)
        for place, index in enumerate(chosen):
            now, stale = self.masks(index)
            mask = now | stale
            images[place] = cv2.resize(self.image(drive, index), (camera.width, camera.height),
                                       interpolation=cv2.INTER_AREA)
            if not mask.all():
                usable[place] = clear_pixels(mask, camera)
        train = self.scene.train
        return Photos(images, camera, np.concatenate([train.T_world_cam, *(
            pose.T_world_cam[None] for pose in drive.poses)])[chosen], usable)
