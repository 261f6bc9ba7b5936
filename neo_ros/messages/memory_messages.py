"""Everything that is published of what the scene memory knows: the node's and the replay's way."""
from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass
from typing import Any

from neo_ros.geometry import Intrinsics
from neo_ros.messages.frame_processor import WideFrame
from neo_ros.messages.image import image_fields
from neo_ros.messages.points import PointMaker, POINTS
from neo_ros.messages.scene_outputs import (
    depth_fields, Make, POSE, pose_message, stamped, STATUS, status_message)
from neo_ros.messages.stamps import NS_PER_S, stamp_of

IMAGE = 'sensor_msgs/msg/Image'
# Name of an output, which is its topic's last part, and its type.
MEMORY_OUTPUTS = {'pose': POSE, 'status': STATUS, 'depth': IMAGE, 'points': POINTS,
                  'panorama': IMAGE, 'panorama_mask': IMAGE}


@dataclass(frozen=True)
class MemorySettings:
    """
    What the outputs are like.

    scene_frame     the frame of poses and panoramas
    name            of who says the status
    points_every    of so many pixels and rows one becomes a point
    panorama_width  pixels, even
    panorama_fps    at most so many panoramas a second of the stamps
    """

    scene_frame: str
    name: str
    points_every: int = 2
    panorama_width: int = 1024
    panorama_fps: float = 1.0


class MemoryMessages:
    """
    Makes the messages of MEMORY_OUTPUTS; `make` as in scene_outputs.

    clock: seconds, where images come as they are taken; it counts where their stamps stand still.
    """

    def __init__(self, make: Make, settings: MemorySettings,
                 clock: Callable[[], float] | None = None) -> None:
        self._make, self.settings, self._clock = make, settings, clock
        self._points: tuple[tuple[Intrinsics, int], PointMaker] | None = None
        self._panorama_ns: int | None = None
        self._panorama_s = 0.0  # By the clock.

    def of(self, header: Any, frame: WideFrame, wanted: Container[str],
           age_ms: float | None = None) -> Iterator[tuple[str, Any]]:
        """
        Yield name and message of the wanted outputs, each computed when it is its turn.

        `header` is the image's, age_ms the time since its stamp, where a clock tells. While the
        network works alone, there is nothing but the status.
        """
        make, guide, settings = self._make, frame.guide, self.settings
        if 'status' in wanted:
            yield 'status', status_message(make, header, settings.name, frame, age_ms)
        if guide is None or frame.image is None or frame.confidence is None:
            return
        if 'pose' in wanted:
            yield 'pose', pose_message(make, header, guide.pose, guide.covariance,
                                       settings.scene_frame)
        if 'depth' in wanted or 'points' in wanted:
            depth = guide.trusted_depth(frame.image, frame.confidence)
            if 'depth' in wanted:
                yield 'depth', make(IMAGE, header=header, **depth_fields(depth))
            if 'points' in wanted:
                fields = self._point_maker(frame.view).fields(
                    make, depth, frame.image, frame.confidence)
                yield 'points', make(POINTS, header=header, **fields)
        if ('panorama' in wanted or 'panorama_mask' in wanted) and self._is_due(header):
            drawn = guide.panorama(frame.image, settings.panorama_width)
            there = stamped(make, header, settings.scene_frame)
            for name, pixels in (('panorama_mask', drawn.kinds), ('panorama', drawn.image)):
                if name in wanted:
                    yield name, make(IMAGE, header=there, **image_fields(pixels))

    def _point_maker(self, view: Intrinsics) -> PointMaker:
        key = (view, self.settings.points_every)
        if self._points is None or self._points[0] != key:
            self._points = (key, PointMaker(*key))
        return self._points[1]

    def _is_due(self, header: Any) -> bool:
        """Say whether a panorama is due; where time runs back, it is."""
        now, before = stamp_of(header), self._panorama_ns
        now_s = self._clock() if self._clock is not None else 0.0
        if before is not None:
            passed = ((now_s - self._panorama_s) * NS_PER_S if now == before
                      else now - before)
            if 0 <= passed * self.settings.panorama_fps < NS_PER_S:
                return False
        self._panorama_ns, self._panorama_s = now, now_s
        return True
