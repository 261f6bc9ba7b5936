"""Whether landmarks agree with a camera that is tracked: asked beside the images."""
from concurrent.futures import Future, ThreadPoolExecutor, wait

from neo_ros.geometry import CameraPose
from neo_ros.memory.landmarks import Location, Locator
from neo_ros.memory.sight import CameraImage


class LandmarkWatch:
    """
    Locates one of some images by landmarks while the next ones are tracked.

    That takes as long as an image: done at once it would hold the camera up. What it says of an
    image comes a fixed number of images later, so that no result depends on the machine.
    """

    def __init__(self, locator: Locator | None, every: int, later: int, threads: int) -> None:
        """Locate every so many images, beside the next ones unless there is but one thread."""
        self._locator, self._every, self._later = locator, every, later
        self._beside = threads > 1
        self._other = ThreadPoolExecutor(1, 'landmarks')
        self.forget()

    def forget(self) -> None:
        """Forget the images so far, and locate the next one."""
        self._pending: tuple[Future[Location | None], CameraPose] | None = None
        self._since = self._every

    def follow(self, image: CameraImage, pose: CameraPose
               ) -> tuple[Location, CameraPose] | None:
        """Take in an image and its pose; return what is known by now of one before, and its."""
        if self._locator is None:
            return None
        self._since += 1
        if self._pending is None:
            if self._since >= self._every:
                self._pending, self._since = (self._start(self._locator, image, pose), pose), 0
            return None
        if self._since < self._later:
            return None
        location, there = self._pending
        self._pending = None
        found = location.result()
        return None if found is None else (found, there)

    def _start(self, locator: Locator, image: CameraImage, pose: CameraPose
               ) -> 'Future[Location | None]':
        located = self._other.submit(lambda: locator.locate(image.features, pose))
        if not self._beside:
            wait([located])
        return located
