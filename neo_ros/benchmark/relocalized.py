"""
B3: find the camera's pose in the scene, then let the radiance field render the wide view there.

Retrieval, 2D-3D matches, PnP with RANSAC and refinement, as hloc does (Sarlin et al., 2019).
"""
from dataclasses import dataclass
import math
from typing import Any, NamedTuple

from neo_ros.baking.photo_bank import PhotoBank
from neo_ros.baking.sparse_model import SparseModel
from neo_ros.benchmark.field_view import FieldView
from neo_ros.evaluation.baselines import NeoModel
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.geometry.camera_pose import rotation_angle
from neo_ros.machine.colmap import load_pycolmap
from neo_ros.memory.local_features import Features, find_features, match_features
import numpy as np


@dataclass(frozen=True)
class RelocalizationRules:
    """How a pose is found; as hloc does, chosen by measuring."""

    retrieved: int = 20       # photos whose points are matched
    ratio: float = 0.9        # of the best to the second distance of descriptors
    pnp_pixels: float = 2.0   # from the projection of its point, for a match to be an inlier
    least_inliers: int = 8    # with fewer, the pose counts as not found
    least_coverage: float = 0.5  # of a pixel, by what photos saw; else B1 paints it


class Localization(NamedTuple):
    """Where the camera is thought to be, from how many inliers; `failed` = a guess."""

    pose: CameraPose
    inliers: int
    failed: bool


class Relocalizer:
    """Find the pose of a narrow image in a scene whose photos were triangulated."""

    def __init__(self, bank: PhotoBank, model: SparseModel, camera: Intrinsics,
                 rules: RelocalizationRules = RelocalizationRules()) -> None:
        pycolmap = load_pycolmap()
        self.bank, self.model, self.rules = bank, model, rules
        self.lens = pycolmap.Camera(model='PINHOLE', width=camera.width, height=camera.height,
                                    params=[camera.fx, camera.fy, camera.cx, camera.cy])
        self.options = pycolmap.AbsolutePoseEstimationOptions()
        self.options.ransac.max_error = self.rules.pnp_pixels
        self.options.ransac.random_seed = 0
        self.refinement = pycolmap.AbsolutePoseRefinementOptions()

    def locate(self, narrow_image: np.ndarray) -> Localization:
        """
        Locate an RGB uint8 image (h, w, 3) of the camera.

        Where PnP finds nothing, the pose of the photo that looks most like the image is the
        answer, marked as failed.
        """
        features = find_features(narrow_image)
        near = self.bank.nearest(features, self.rules.retrieved)
        found = self._pnp(features, near)
        if found is None:
            return Localization(self.bank.photos.poses[near[0]], 0, True)
        # Once the place is known, the photos around it have more points in view.
        again = self._pnp(features, self._around(found[0]))
        pose, inliers = max([found, again or found], key=lambda one: one[1])
        return Localization(pose, inliers, False)

    def _around(self, pose: CameraPose) -> np.ndarray:
        T_world_cam = self.bank.photos.T_world_cam
        apart = np.linalg.norm(T_world_cam[:, :3, 3] - pose.position, axis=1)
        turned = np.arccos(np.clip(T_world_cam[:, :3, 2] @ pose.forward, -1, 1))
        # Metres and radians shift a picture about as much, and far photos see other sides.
        return np.argsort(apart + turned, kind='stable')[:self.rules.retrieved]

    def _pnp(self, features: Features, photos: np.ndarray) -> tuple[CameraPose, int] | None:
        pycolmap = load_pycolmap()
        pairs: set[tuple[int, int]] = set()
        for index in photos:
            owned = np.flatnonzero(self.model.point_of[index] >= 0)
            matches = match_features(
                features.descriptors, self.bank.features[index].descriptors[owned],
                self.rules.ratio)
            points = self.model.point_of[index][owned[matches[:, 1]]]
            pairs.update(zip(matches[:, 0].tolist(), points.tolist()))
        if len(pairs) < self.rules.least_inliers:
            return None
        chosen = np.array(sorted(pairs))
        result: dict[str, Any] | None = pycolmap.estimate_and_refine_absolute_pose(
            features.points[chosen[:, 0]], self.model.points[chosen[:, 1]], self.lens,
            self.options, self.refinement)
        if result is None or result['num_inliers'] < self.rules.least_inliers:
            return None
        T = np.eye(4)
        T[:3] = result['cam_from_world'].matrix()
        return CameraPose(np.linalg.inv(T)), int(result['num_inliers'])


class Relocalized:
    """B3 as a method: the pose is estimated, the field renders, the camera's pixels stay."""

    name = 'relocalized'
    observed_pasted = True

    def __init__(self, relocalizer: Relocalizer, view: FieldView,
                 train_minutes: float | None, model_mb: float | None) -> None:
        self.relocalizer, self.view = relocalizer, view
        self.train_minutes, self.model_mb = train_minutes, model_mb
        self.last: Localization | None = None

    @property
    def expansion(self) -> ViewExpansion:
        """The source and target views."""
        return self.view.expansion

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""
        self.last = self.relocalizer.locate(narrow_image)
        return self.view.widen(narrow_image, self.last.pose)

    def notes(self, true_pose: CameraPose) -> dict[str, float]:
        """Return how far the pose of the last frame was off."""
        assert self.last is not None
        return {**pose_error(self.last.pose, true_pose), 'pnp_inliers': float(self.last.inliers),
                'pose_failed': float(self.last.failed)}


class RelocalizedNeo(Relocalized):
    """B3 where a photo saw what the field shows; NEO elsewhere and where no pose is found."""

    name = 'relocalized_neo'

    def __init__(self, relocalized: Relocalized, neo: NeoModel,
                 train_minutes: float | None) -> None:
        mine, other = relocalized.model_mb, neo.model_mb
        super().__init__(relocalized.relocalizer, relocalized.view, train_minutes,
                         None if mine is None or other is None else mine + other)
        self.neo = neo

    def expand(self, narrow_image: np.ndarray) -> np.ndarray:
        """Widen (h, w, 3) RGB uint8 to (H, W, 3) RGB uint8."""
        made_up = self.neo.expand(narrow_image)
        self.last = self.relocalizer.locate(narrow_image)
        if self.last.failed:
            return made_up
        shown, coverage = self.view.show(narrow_image, self.last.pose)
        least = self.relocalizer.rules.least_coverage
        unseen = (coverage < least) & self.expansion.extrapolated_mask
        shown[unseen] = made_up[unseen]
        return shown


def pose_error(found: CameraPose, true_pose: CameraPose) -> dict[str, float]:
    """Return pose_error_cm and pose_error_deg."""
    relative = found.T_world_cam[:3, :3].T @ true_pose.T_world_cam[:3, :3]
    return {'pose_error_cm': 100 * float(np.linalg.norm(found.position - true_pose.position)),
            'pose_error_deg': math.degrees(rotation_angle(relative))}
