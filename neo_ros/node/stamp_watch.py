"""What the stamps of images tell: their age, whether they move, what got lost; no ROS here."""
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
import time
from typing import NamedTuple

import numpy as np

WINDOW_S = 5.0
# What is younger may still be on its way.
SETTLE_NS = 500_000_000


@dataclass(frozen=True)
class StampLimits:
    """When the stamps are worth a warning."""

    oldest_ms: float = 1000.0    # What looks at the past of TF waits for about that long.
    most_ahead_ms: float = 100.0  # More than clocks kept by NTP differ by.
    frozen: int = 3              # Images of one stamp; two come from a message sent twice.
    most_lost: float = 0.2       # A busy computer loses some, and the newest image is what counts.
    # The period is near this quantile of the gaps: most may be longer.
    shortest: float = 0.1
    longest_gap_s: float = 1.0   # Longer ones are pauses, or a bag that begins anew.
    least_frames: int = 10       # Frames from which a rate is told.


class StampReport(NamedTuple):
    """
    The last WINDOW_S seconds.

    images: how many came. infos: how many camera_infos of different stamps. bytes: of the largest
    image. age_ms: median since the stamp, at arrival; None where nobody tells the time. unstamped:
    all stamps are 0. same: images that share the newest stamp. rate: of the camera, per second,
    None where it cannot be told. sent, lost: frames of the camera that should have come, and those
    that did not; by_infos: most of these are known from camera_infos alone.
    """

    images: int = 0
    infos: int = 0
    bytes: int = 0  # noqa: A003
    age_ms: float | None = None
    unstamped: bool = False
    same: int = 0
    rate: float | None = None
    sent: int = 0
    lost: int = 0
    by_infos: bool = False


class StampWatch:
    """Keeps the stamps of the images and of the camera_infos that came lately."""

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        """Take the clock as an argument, so that tests need not wait."""
        self._now, self._limits = now, StampLimits()
        self.forget()

    def forget(self) -> None:
        """Drop everything: another camera, or a pause."""
        self._images: deque[tuple[float, int, float | None, int]] = deque()
        self._infos: deque[tuple[float, int]] = deque()

    def add_image(self, stamp_ns: int, age_ms: float | None, size: int) -> None:
        """Note an image: its stamp, its age at arrival if it is known, its bytes."""
        self._images.append((self._now(), stamp_ns, age_ms, size))
        self._clean()

    def add_info(self, stamp_ns: int) -> None:
        """Note a camera_info; the same one may be noted twice."""
        self._infos.append((self._now(), stamp_ns))
        self._clean()

    def report(self) -> StampReport:
        """Return what the stamps tell now."""
        self._clean()
        infos = {stamp for _, stamp in self._infos}
        if not self._images:
            return StampReport(infos=len(infos))
        stamps = [stamp for _, stamp, _, _ in self._images]
        # camera_infos of other stamps than the images' are no sign of images.
        per_image = 2 * len(infos & set(stamps)) >= len(set(stamps))
        rate, sent, lost, by_infos = self._losses(set(stamps), infos if per_image else set())
        ages = [age for _, _, age, _ in self._images if age is not None]
        return StampReport(
            images=len(stamps), infos=len(infos),
            bytes=max(size for _, _, _, size in self._images),
            age_ms=float(np.median(ages)) if ages else None,
            unstamped=not any(stamps), same=Counter(stamps)[stamps[-1]],
            rate=rate, sent=sent, lost=lost, by_infos=by_infos)

    def _losses(self, images: set[int], infos: set[int]
                ) -> tuple[float | None, int, int, bool]:
        frames = np.array(sorted(images | infos))
        frames = frames[frames <= frames[-1] - SETTLE_NS]
        gaps = np.diff(frames)
        gaps = gaps[gaps < self._limits.longest_gap_s * 1e9]
        if len(gaps) < self._limits.least_frames:
            return None, 0, 0, False
        period = float(np.quantile(gaps, self._limits.shortest))
        for _ in range(2):  # From a short gap to the middle of those that are one period long.
            period = float(np.median(gaps[gaps < 1.5 * period]))
        skipped = int((np.rint(gaps / period) - 1).sum())
        without = sum(int(stamp) not in images for stamp in frames)
        return 1e9 / period, len(frames) + skipped, skipped + without, without > skipped

    def _clean(self) -> None:
        begin = self._now() - WINDOW_S
        for kept in (self._images, self._infos):
            while kept and kept[0][0] < begin:
                kept.popleft()  # type: ignore[attr-defined]


def judge_stamps(report: StampReport, remedy: str) -> str:
    """Return what is wrong with a camera's stamps, in words; '' = nothing. remedy: for losses."""
    limits = StampLimits()
    if not report.images:
        if report.infos >= limits.frozen:
            return f'camera_info comes, the images do not: {remedy}'
        return ''
    size = f'{report.bytes / 1e6:.1f} MB each'
    if report.unstamped:
        return 'the images have no stamps: nobody can tell what belongs together'
    age_s = (report.age_ms or 0) / 1000
    wrongs = []
    if report.same >= limits.frozen:
        wrongs.append(f'the last {report.same} images have one stamp: the driver repeats it')
    elif age_s * 1000 > limits.oldest_ms:
        wrongs.append(f'the images are {age_s:.1f} s old when they come: a slow link, the clock '
                      'of another computer, or a bag without use_sim_time')
    elif -age_s * 1000 > limits.most_ahead_ms:
        wrongs.append(f'the stamps are {-age_s:.1f} s ahead of the clock: the clocks of two '
                      'computers differ')
    if report.sent and report.lost > limits.most_lost * report.sent:
        words = (f'{report.lost} of {report.sent} images got lost before this node ({size}): '
                 f'{remedy}')
        if report.by_infos:
            words += (', unless somebody throttles the images and not camera_info: throttle both')
        wrongs.append(words)
    return '; '.join(wrongs)
