"""What is seen from a pose: how well the memory agrees with the image there, and its guide."""
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TYPE_CHECKING

from neo_ros.geometry import CameraPose
from neo_ros.memory.alignment import Drawn
from neo_ros.memory.alignment_kernels import PhotoLevel
from neo_ros.memory.depth_kernels import fill_trusted_depth
from neo_ros.memory.landmarks import Location
from neo_ros.memory.local_features import Features
from neo_ros.memory.recent_images import SeenBefore
from neo_ros.memory.rendering import GuideView
import numpy as np

if TYPE_CHECKING:
    from neo_ros.memory.panorama import Panorama

Found = Literal['tracked', 'searched', 'landmarks', 'prior']


class CameraImage:
    """
    One image of the camera, RGB uint8 (h, w, 3), and what is made of it once.

    photo: its levels, see `Aligner.photo`; find_features makes `features`, when they are asked
    for: that is as slow as a frame.
    """

    def __init__(self, pixels: np.ndarray, photo: list[PhotoLevel],
                 find_features: Callable[[np.ndarray], Features]) -> None:
        self.pixels, self.photo = pixels, photo
        self._find_features = find_features

    @cached_property
    def features(self) -> Features:
        """What landmarks are matched with."""
        return self._find_features(self.pixels)


@dataclass(frozen=True)
class TrustThresholds:
    """Which remembered depth is told."""

    # Grey levels by which the present image or the last ones differ from the memory where
    # something else stands there now. The mean over squares of so many pixels, odd, counts.
    contradiction: float = 24.0
    around: int = 9
    # 0 ... 255. Where the colours are not sure, neither is the depth.
    least_confidence: int = 64


@dataclass(frozen=True, eq=False)
class Guide:
    """
    What the memory shows in the wide view of an image.

    image float32 RGB (H, W, 3) in 0 ... 255, in the exposure of the image; known, stretched bool
    (H, W), see GuideView; pose of the camera; agreement of memory and image in [-1, 1];
    seen_before: by how much the last images differ from it, None if none shows any of it.
    found: what the pose comes from; landmarks: how many of them were matched with this image,
    which are looked for now and then. observed: rows and columns of the image in the wide view.
    light: float32 (h, w, 3), what the light of now multiplies the memory's colours with in the
    image; None while it is the light of the training photos. two_states: float32 (H, W), 1 where
    a thing is shown that has more than one state, 0 elsewhere; None: nothing was learnt.
    """

    image: np.ndarray
    known: np.ndarray
    stretched: np.ndarray
    pose: CameraPose
    agreement: float
    seen_before: SeenBefore | None = None
    found: Found = 'tracked'
    landmarks: int = 0
    remembered_depth: np.ndarray | None = None
    find_covariance: Callable[[], np.ndarray] | None = None
    observed: tuple[slice, slice] = (slice(0, 0), slice(0, 0))
    draw_panorama: 'Callable[[np.ndarray, int], Panorama] | None' = None
    light: np.ndarray | None = None
    two_states: np.ndarray | None = None

    @cached_property
    def covariance(self) -> np.ndarray:
        """
        Return how exactly the pose is known, float64 (6, 6); computed when first asked for.

        In REP-103's order: x, y, z in metres, then rotations about x, y, z in radians; all along
        and about the axes of the world, through the camera's centre.
        """
        assert self.find_covariance is not None
        return self.find_covariance()

    def depth(self) -> np.ndarray:
        """
        Return what the memory knows of the wide view's depth, float32 (H, W).

        Metres along the optical axis; NaN where nothing is known, or only what is on both sides
        of a gap.
        """
        assert self.remembered_depth is not None
        return np.where(self.known & ~self.stretched, self.remembered_depth, np.float32(np.nan))

    def trusted_depth(self, wide_image: np.ndarray, confidence: np.ndarray,
                      thresholds: TrustThresholds = TrustThresholds()) -> np.ndarray:
        """
        Return `depth()` without what the last images contradict or what is not sure, float32.

        wide_image uint8 RGB (H, W, 3) and confidence uint8 (H, W) that this guide led to.
        """
        assert self.remembered_depth is not None
        depth = np.empty_like(self.remembered_depth)
        rows, columns = self.observed
        seen = None if self.seen_before is None else self.seen_before.at(depth.shape)
        fill_trusted_depth(
            self.remembered_depth, self.stretched, confidence, thresholds.least_confidence,
            (self.image, wide_image), (rows.start, columns.start, rows.stop, columns.stop),
            seen, thresholds.around // 2, np.float32(thresholds.contradiction), depth)
        return depth

    def panorama(self, wide_image: np.ndarray, width: int) -> 'Panorama':
        """Draw the whole sphere around the camera, so many pixels wide, the live image in it."""
        assert self.draw_panorama is not None
        return self.draw_panorama(wide_image, width)


@dataclass(frozen=True, eq=False)
class Sight:
    """
    A pose, what the memory shows from it, and how well that agrees with the image.

    view: the wide view, which `show` draws, once; part: what the image is of it, in some size;
    drawn: the same, as it is aligned with the next image.
    believed: good enough to be shown; located: landmarks speak for the pose; location: what they
    say; found: what the pose comes from.
    """

    pose: CameraPose
    show: Callable[[], GuideView]
    part: GuideView
    drawn: Drawn
    agreement: float
    believed: bool
    located: bool = False
    location: Location | None = None
    found: Found = 'tracked'

    @property
    def view(self) -> GuideView:
        """The wide view."""
        return self.show()

    @property
    def led(self) -> bool:
        """Whether the pose is what landmarks say, and alignment had no say."""
        return self.location is not None and self.pose is self.location.pose

    def rank(self) -> tuple[bool, bool, float]:
        """Return what tells the better of two sights."""
        return self.believed, self.located, self.agreement


def located(sight: Sight, least_agreement: float, location: Location,
            found: Found) -> Sight:
    """Return what is seen from a pose that landmarks speak for: believed, unless all differs."""
    return replace(sight, believed=sight.believed or sight.agreement >= least_agreement,
                   located=True, location=location, found=found)


def better(one: Sight | None, other: Sight | None) -> Sight | None:
    """Return the one that is believed; of such, that landmarks speak for; then, agrees more."""
    if one is None or other is None:
        return one or other
    return max(one, other, key=Sight.rank)


def is_near(pose: CameraPose, other: CameraPose, metres: float, cosine: float) -> bool:
    """Tell whether two poses are so near, and look so much the same way."""
    return bool(np.linalg.norm(pose.position - other.position) < metres
                and pose.forward @ other.forward > cosine)


def are_near(T_world_cam: np.ndarray, pose: CameraPose, metres: float, cosine: float
             ) -> np.ndarray:
    """Tell of poses (K, 4, 4) which are so near to one, or at just that, bool (K,)."""
    near: np.ndarray = (
        np.linalg.norm(T_world_cam[:, :3, 3] - pose.position, axis=1) <= metres) & (
            T_world_cam[:, :3, 2] @ pose.forward >= cosine)
    return near
