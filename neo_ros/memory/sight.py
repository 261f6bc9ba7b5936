"""What is seen from a pose: how well the memory agrees with the image there, and its guide."""
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TYPE_CHECKING

from neo_ros.geometry import CameraPose
from neo_ros.memory.alignment import AlignmentThresholds, Drawn
from neo_ros.memory.alignment_kernels import PhotoLevel
from neo_ros.memory.depth_kernels import fill_trusted_depth
from neo_ros.memory.landmarks import LandmarkThresholds, Location
from neo_ros.memory.local_features import Features
from neo_ros.memory.pose_covariance import CovarianceThresholds
from neo_ros.memory.recent_images import RecentThresholds, SeenBefore
from neo_ros.memory.rendering import GuideView
from neo_ros.memory.scene_light import LightThresholds
import numpy as np

if TYPE_CHECKING:
    from neo_ros.memory.panorama import Panorama

Found = Literal['tracked', 'searched', 'landmarks', 'prior']


@dataclass(frozen=True)
class AmbiguityThresholds:
    """When another place counts as a rival, and when an image tells two places apart."""

    # A place is elsewhere when it is farther away than this, or looks farther to the side: nearer
    # ones become the same pose when they are aligned.
    elsewhere_metres: float = 1.0
    elsewhere_cosine: float = 0.94
    # So many of the places elsewhere that an image is most like are looked at, these far apart, if
    # they are not less like it than the place that was found, by so much (correlation of glances).
    # Of 99 rivals in 60 searches among twins 95 had 0.25 or less; with 40 of them 8 of 100
    # searches believed the wrong twin, with 24 11 did. In a flat without twins 6 of 24 are left.
    starts: int = 40
    less_alike: float = 0.25
    start_metres: float = 0.4
    start_cosine: float = 0.97
    # They are aligned in images of this width first, a quarter of the time; those that agree so
    # much there, or hardly less than the place that was found, are aligned again, at most so many,
    # and no two that come so near to each other.
    coarse: int = 32
    least_coarse: float = 0.7
    agrees_less: float = 0.15
    most_rivals: int = 12
    same_metres: float = 0.2
    same_cosine: float = 0.99
    # Levels in [0, 1] by which an image differs from what a place would show, in the colour that
    # differs most, as the mean over a square of so large a share of its width; the place's rival
    # must fit twice as well. Of 100 images in rooms that all differ 4 decide nothing so, in grey
    # 15: a green wall is as bright as a beige one.
    contradiction: float = 0.08
    around: float = 0.1
    # An image whose colours differ by less on average, in [0, 1], has none.
    colourless: float = 0.01
    # Not where depth leaps by so large a share from pixel to pixel: a pose a little off makes a
    # difference there.
    leap: float = 0.15
    # Share of an image that has to speak for one place against another. Of 600 searches among
    # twins chance let 0.031 speak for the wrong one, twice; a picture that one of them has, where
    # it is in the image, most often 0.04 and more.
    decisive: float = 0.04
    # The images that follow speak together, each from so far from the one before. Of what was said
    # so much is left with each that is asked: between equal places chance must not add up. On 36
    # walks to and fro among them, of 100 images each, it let at most 0.027 speak for one.
    decisive_together: float = 0.06
    asked_metres: float = 0.1
    asked_cosine: float = 0.996
    remembered: float = 0.9
    # A rival that agrees less could be it if hardly more of the image is left unexplained there.
    as_unexplained: float = 1.25
    # So could a known twin of where it was found, if the memory shows it well enough to ask it.
    # Of 300 images among twins one agreed by 0.85 with its own place and by 0.95 with the other.
    least_twin: float = 0.75
    # A place that does not agree any more is dropped if this much more of the image is left
    # unexplained than at the best one.
    unexplained: float = 2.0


@dataclass(frozen=True)
class GuideThresholds:
    """When a pose is believed, when a camera is searched for, and what is drawn."""

    # Correlation of image and memory. Where the pose is right it is 0.956 and more on held-out
    # photos of the demo flat and of a real kitchen; where it is wrong, hardly ever more than 0.85.
    # In parts that the photos hardly show, it is low even where the pose is right.
    sure: float = 0.94
    least_agreement: float = 0.85
    # Of a pose that was searched for all over the scene nothing else speaks: it has to agree by
    # more, as a whole or in its best part. In a hand-held capture two poses that were found were
    # 15 degrees off, with 0.85 and 0.87, 0.99 in the best part; where chairs were moved right ones
    # have 0.86 and 0.999.
    least_found: float = 0.9
    least_found_partial: float = 0.995
    # A camera that has moved less than this is aligned with what was drawn for the image before,
    # if that agreed with it. On a walk through the flat that is as exact as drawing anew (0.21 cm
    # of 128 pixels, 0.24 of 256), and saves a quarter of the time.
    redrawn_metres: float = 0.05
    redrawn_cosine: float = 0.999
    # A pose that was searched for in another light than the memory knows is believed where what
    # is fine agrees so. By lamps alone three of four right ones have 0.82 and more, wrong ones at
    # most 0.59; in a real kitchen poses that are 0.4 metres off have up to 0.76, of 258.
    least_fine: float = 0.8
    # Of the pixels that fit best, for a pose that is where a moving camera was expected to be.
    # With 40 % of the held-out photos hidden it is 0.98 and more.
    least_partial: float = 0.97
    expected_metres: float = 0.15
    expected_cosine: float = 0.99
    # A search takes as long as several frames: a lost camera is searched for every so many frames,
    # one whose pose is believed, but not sure, now and then.
    search_every: int = 5
    doubt_every: int = 30
    # For so many images, and no longer than this, a lost camera is followed from where it would
    # be: somebody passed by. In a longer time a lift takes it to another floor.
    lost_ns: int = 1_000_000_000
    # Looking for landmarks takes as long as a frame: now and then, while image and memory agree,
    # and beside the next images; what they say counts so many images later. Where they
    # contradict, they lead for as many images as they are looked for once.
    landmarks_every: int = 10
    landmarks_later: int = 2
    # A pose that landmarks give is right, even where the memory shows other colours or another
    # depth.
    least_located: float = 0.5
    # Keyframes that are drawn. Those around where a camera in steady motion will be so many images
    # later are decoded beside the images. With 2 to 6 none was waited for on a walk at 0.8 m/s
    # (640x480, 10 Hz); with 15 half of those that were decoded never were drawn.
    shown: int = 3
    decoded_ahead: int = 4
    # Glances that an image is most like, out of so many lists of their index.
    alike: int = 512
    lists: int = 32
    # Places that a lost camera is compared with, and how far apart they are at least.
    candidates: int = 24
    # They are aligned in small images first; closely those that agree most there, at most so many,
    # and not where they agree less than this: what is right has twice as much.
    likely: int = 8
    least_likely: float = 0.3
    apart_metres: float = 0.25
    apart_cosine: float = 0.97
    # Where a camera may be that somebody says is at a place: a click on a map is not exact.
    prior_metres: float = 1.5
    prior_cosine: float = 0.7
    # At most some 64 by 64 pixels of an image tell its exposure.
    samples: int = 64
    alignment: AlignmentThresholds = AlignmentThresholds()
    landmarks: LandmarkThresholds = LandmarkThresholds()
    recent: RecentThresholds = RecentThresholds()
    light: LightThresholds = LightThresholds()
    covariance: CovarianceThresholds = CovarianceThresholds()
    ambiguity: AmbiguityThresholds = AmbiguityThresholds()


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
