"""Which camera_info an image belongs to; no ROS in here."""
from collections import deque
from collections.abc import Callable
import time
from typing import Any

# Drivers send an image before its camera_info: the first images of a camera that publishes one
# wait so long for it, the newest of them.
CAMERA_INFO_WAIT_S = 2.0
# How many frames, and camera_infos of each, are kept.
KEPT_FRAMES, KEPT_INFOS = 16, 8


class CameraPairing:
    """
    Gives every image the camera_info of its frame_id; of its stamp, where one comes per image.

    `take` gets each image with the CameraInfo, or None where the calibration is not known.
    `is_announced` says whether somebody publishes camera_info. An empty frame_id fits every
    other. What comes twice does no harm.
    """

    def __init__(self, take: Callable[[Any, Any | None], None], is_announced: Callable[[], bool],
                 now: Callable[[], float] = time.monotonic) -> None:
        self._take, self._is_announced, self._now = take, is_announced, now
        self.forget()

    def forget(self) -> None:
        """Drop what is known: the next camera may be another one."""
        self._infos: dict[str, deque[Any]] = {}
        self.newest: Any | None = None  # The camera_info that came last.
        self._waiting: Any | None = None
        self._waiting_since: float | None = None
        self._last_stamp: tuple[int, int] | None = None
        self._comes_per_image = False
        self.mismatch = ''  # Whose frames do not fit, in words.

    @property
    def waits(self) -> bool:
        """Whether an image waits for its camera_info."""
        return self._waiting is not None

    def add_info(self, info: Any) -> None:
        """Keep a camera_info, and let go the image that waits for it."""
        kept = self._infos.setdefault(_frame(info), deque(maxlen=KEPT_INFOS))
        kept.append(info)
        if len(self._infos) > KEPT_FRAMES:
            del self._infos[next(iter(self._infos))]
        self.newest = info
        stamp = _stamp(info)
        if stamp is not None and stamp == self._last_stamp:
            self._comes_per_image = True
        if self._waiting is not None and (self._of_stamp(self._waiting) is not None
                                          or not self._comes_per_image):
            found = self._find(self._waiting)
            if found is not None:
                image, self._waiting = self._waiting, None
                self._take(image, found)

    def add_image(self, image: Any) -> None:
        """Hand over an image, at once or with the camera_info that comes after it."""
        found, waiting = self._of_stamp(image), self._waiting
        self._last_stamp, self._waiting = _stamp(image), None
        if self._comes_per_image and waiting is not None and found is None:
            # The waiting one's camera_info got lost; the next one may, too.
            self._comes_per_image = False
            self._take(waiting, self._find(waiting))
        if found is not None:
            self._comes_per_image = True
        elif self._comes_per_image:
            self._waiting = image
            return
        else:
            found = self._find(image)
        if found is None and self._is_announced():
            now = self._now()
            self._waiting_since = now if self._waiting_since is None else self._waiting_since
            if now - self._waiting_since < CAMERA_INFO_WAIT_S:
                self._waiting = image
                return
        self._take(image, found)

    def _of_stamp(self, image: Any) -> Any | None:
        stamp = _stamp(image)
        if stamp is None:
            return None
        return next((info for info in self._fitting(image) if _stamp(info) == stamp), None)

    def _find(self, image: Any) -> Any | None:
        """Return the camera_info of the image's stamp, else the newest of its frame."""
        found = self._of_stamp(image) or next(iter(self._fitting(image)), None)
        self.mismatch = ''
        if found is None and self.newest is not None:
            self.mismatch = (f'camera_info is of the frame {_frame(self.newest)}, the images are '
                             f'of {_frame(image)}')
        return found

    def _fitting(self, image: Any) -> list[Any]:
        """Return the camera_infos of the image's frame, newest first."""
        frame = _frame(image)
        if not frame:
            frame = _frame(self.newest) if self.newest is not None else ''
        return [*reversed(self._infos.get(frame, ())),
                *(reversed(self._infos.get('', ())) if frame else ())]


def _frame(message: Any) -> str:
    return str(message.header.frame_id).lstrip('/')


def _stamp(message: Any) -> tuple[int, int] | None:
    """Return what tells two images apart; a stamp of 0 says nothing."""
    stamp = message.header.stamp
    return (stamp.sec, stamp.nanosec) if stamp.sec or stamp.nanosec else None
