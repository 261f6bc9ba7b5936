"""When a pose is believed, when a camera is searched for, and what then is looked at."""
from dataclasses import dataclass

from neo_ros.memory.alignment import AlignmentThresholds
from neo_ros.memory.landmarks import LandmarkThresholds
from neo_ros.memory.pose_covariance import CovarianceThresholds
from neo_ros.memory.recent_images import RecentThresholds
from neo_ros.memory.scene_light import LightThresholds


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
