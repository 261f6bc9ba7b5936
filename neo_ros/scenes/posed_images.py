"""The hand-over between captures and training: images with poses and one set of intrinsics."""
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
from neo_ros.errors import SceneError
from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.pictures.depth import read_depth
from neo_ros.pictures.photo import read_photo
from neo_ros.pictures.usable import read_usable
import numpy as np


@dataclass(frozen=True)
class PosedImages:
    """
    Images of one camera with their poses; pixels stay on disk until they are read.

    image_paths      files of `intrinsics` size
    poses            one CameraPose (OpenCV camera axes, metres) per image
    path_ids         which walk or run each image belongs to; scores are averaged over these
    z_up             the world's z axis points up by definition, however the photos were held
    arbitrary_scale  nobody knows how long a unit of the poses is
    depth_paths      a depth map of each image (see `pictures/depth.py`), None where it has none;
                     empty: no image has one
    mask_paths       likewise: black where an image does not show the scene (see
                     `pictures/usable.py`)
    """

    intrinsics: Intrinsics
    image_paths: tuple[Path, ...]
    poses: tuple[CameraPose, ...]
    path_ids: tuple[int, ...]
    z_up: bool = False
    arbitrary_scale: bool = False
    depth_paths: tuple[Path | None, ...] = ()
    mask_paths: tuple[Path | None, ...] = ()

    def __post_init__(self) -> None:
        for what, paths in (('depth maps', self.depth_paths), ('masks', self.mask_paths)):
            if paths and len(paths) != len(self.image_paths):
                raise SceneError(f'posed images: expected as many {what} as images, got '
                                 f'{len(self.image_paths)} images, {len(paths)} {what}')
        counts = {len(self.image_paths), len(self.poses), len(self.path_ids)}
        if len(counts) != 1:
            raise SceneError(
                f'posed images: expected as many poses and path ids as images, '
                f'got {len(self.image_paths)} images, {len(self.poses)} poses, '
                f'{len(self.path_ids)} path ids')
        if not self.image_paths:
            raise SceneError('posed images: expected at least one image, got none')

    def __len__(self) -> int:
        return len(self.image_paths)

    @property
    def T_world_cam(self) -> np.ndarray:
        """All poses, float64 (N, 4, 4)."""
        return np.stack([pose.T_world_cam for pose in self.poses])

    def subset(self, indices: Sequence[int]) -> 'PosedImages':
        """Keep the images at `indices`, in that order."""
        return replace(
            self, image_paths=tuple(self.image_paths[i] for i in indices),
            poses=tuple(self.poses[i] for i in indices),
            path_ids=tuple(self.path_ids[i] for i in indices),
            depth_paths=tuple(self.depth_paths[i] for i in indices) if self.depth_paths else (),
            mask_paths=tuple(self.mask_paths[i] for i in indices) if self.mask_paths else ())

    def read_image(self, index: int, scale: float = 1.0) -> np.ndarray:
        """Read image `index` as RGB uint8 (H, W, 3), resampled by area if scale < 1."""
        return _resized(read_rgb_image(self.image_paths[index], self.intrinsics),
                        self.intrinsics.scaled(scale))

    def read_images(self, scale: float = 1.0,
                    progress: Callable[[int], None] = lambda done: None) -> np.ndarray:
        """Read all images as RGB uint8 (N, H, W, 3)."""
        size = self.intrinsics.scaled(scale)
        images = np.empty((len(self), size.height, size.width, 3), np.uint8)
        for index in range(len(self)):
            images[index] = self.read_image(index, scale)
            progress(index + 1)
        return images

    def read_depths(self, scale: float = 1.0) -> np.ndarray | None:
        """
        Read all depth maps as uint16 (N, H, W), millimetres along the optical axis.

        0 = unknown; None where no image has one.
        """
        if not any(self.depth_paths):
            return None
        size = self.intrinsics.scaled(scale)
        depths = np.zeros((len(self), size.height, size.width), np.uint16)
        for index, path in enumerate(self.depth_paths):
            if path is not None:
                depths[index] = read_depth(path, size.width, size.height)
        return depths

    def read_usable(self, index: int, scale: float = 1.0) -> np.ndarray | None:
        """
        Read which pixels of image `index` show the scene, bool (H, W).

        A smaller pixel is usable where all of it is; None where the image has no mask.
        """
        path = self.mask_paths[index] if self.mask_paths else None
        size = self.intrinsics.scaled(scale)
        return None if path is None else read_usable(path, size.width, size.height)

    def read_shown(self, index: int, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Read image `index`, and which of its pixels show the scene, bool (H, W)."""
        image, usable = self.read_image(index, scale), self.read_usable(index, scale)
        return image, np.ones(image.shape[:2], bool) if usable is None else usable

    def read_all_usable(self, scale: float = 1.0) -> np.ndarray | None:
        """Read which pixels of all images show the scene, bool (N, H, W); None without masks."""
        if not any(self.mask_paths):
            return None
        size = self.intrinsics.scaled(scale)
        every = np.ones((len(self), size.height, size.width), bool)
        for index in range(len(self)):
            usable = self.read_usable(index, scale)
            if usable is not None:
                every[index] = usable
        return every


def read_rgb_image(path: Path, intrinsics: Intrinsics) -> np.ndarray:
    """
    Read an image file as RGB uint8 (H, W, 3); grayscale becomes three equal channels.

    Raises SceneError for files that are no image or not of the size of `intrinsics`.
    """
    image = read_photo(path)
    if image is None:
        raise SceneError(f'{path}: expected a readable image file; is it missing or truncated?')
    if image.shape[:2] != (intrinsics.height, intrinsics.width):
        raise SceneError(
            f'{path}: expected {intrinsics.width}x{intrinsics.height} pixels as the intrinsics '
            f'say, got {image.shape[1]}x{image.shape[0]}')
    return image


def _resized(image: np.ndarray, size: Intrinsics) -> np.ndarray:
    if image.shape[:2] == (size.height, size.width):
        return image
    shrink = size.width < image.shape[1]
    return cv2.resize(image, (size.width, size.height),
                      interpolation=cv2.INTER_AREA if shrink else cv2.INTER_CUBIC)
