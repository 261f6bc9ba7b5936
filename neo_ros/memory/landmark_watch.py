"""Whether landmarks agree with a camera that is tracked: asked beside the images."""
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor

from neo_ros.geometry import CameraPose
from neo_ros.memory.landmarks import Location
from neo_ros.memory.sight import CameraImage


class LandmarkWatch:
    """
    Locates one of some images by landmarks while the next ones are tracked.

    That takes as long as an image: done at once it would hold the camera up. What it says of an
    image comes a fixed number of images later, so that no result depends on the machine.
    """

    def __init__(self, locate: Callable[[CameraImage, CameraPose], Location | None],
                 every: int, later: int, threads: int) -> None:
        """
        locate: called in another thread, unless there is but one.

        No method of what owns the watch: the memory would outlive its guide until the next
        garbage collection.
        """
        self._locate, self._every, self._later = locate, every, later
        self._other = ThreadPoolExecutor(1, 'landmarks') if threads > 1 else None
        self.forget()

    def forget(self) -> None:
        """Forget the images so far, and locate the next one."""
        self._pending: tuple[Future[Location | None], CameraPose] | None = None
        self._since = self._every

    def follow(self, image: CameraImage, pose: CameraPose
               ) -> tuple[Location, CameraPose] | None:
        """Take in an image and its pose; return what is known by now of one before, and its."""
        self._since += 1
        if self._pending is None:
            if self._since >= self._every:
                self._pending, self._since = (self._start(image, pose), pose), 0
            return None
        if self._since < self._later:
            return None
        location, there = self._pending
        self._pending = None
        found = location.result()
        return None if found is None else (found, there)

    def _start(self, image: CameraImage, pose: CameraPose) -> 'Future[Location | None]':
        if self._other is not None:
            return self._other.submit(self._locate, image, pose)
        done: Future[Location | None] = Future()
        done.set_result(self._locate(image, pose))
        return done
