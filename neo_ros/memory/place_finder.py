"""Find a camera that may be anywhere in a scene, or about where somebody says."""
from dataclasses import replace

from neo_ros.geometry import CameraPose, Intrinsics
from neo_ros.memory.glancing import GlanceFinder
from neo_ros.memory.landmark_watch import LandmarkWatch
from neo_ros.memory.landmarks import Location, Locator
from neo_ros.memory.looking import Looker
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.memory.sight import CameraImage, is_near, located, Sight
from neo_ros.memory.thresholds import GuideThresholds


class PlaceFinder:
    """
    Finds where an image was taken, by landmarks or else by its looks.

    watch: asks landmarks beside the images; it begins anew where they say another place.
    """

    def __init__(self, looker: Looker, memory: SceneMemory, source: Intrinsics, threads: int,
                 thresholds: GuideThresholds) -> None:
        self._looker, self._thresholds = looker, thresholds
        self.locator = (None if memory.landmarks is None
                        else Locator(memory.landmarks, source, thresholds.landmarks))
        self.glances = GlanceFinder(memory.glances, thresholds)
        self.watch = LandmarkWatch(self.locator, thresholds.landmarks_every,
                                   thresholds.landmarks_later, threads)

    def search(self, image: CameraImage) -> tuple[Sight | None, list[CameraPose]]:
        """
        Find a camera that may be anywhere: by its landmarks, or else by its looks.

        Compares with all glances, aligns with the best ones, takes the pose that agrees most.
        Returns also from where else landmarks could look like this.
        """
        locations = self.locator.search(image.features) if self.locator else []
        for location in locations:
            found = self.look_from(location, image)
            if found.believed:
                return self._surest(image, found), [
                    one.pose for one in locations if one is not location]
        best = self._looker.best_of(image, self.glances.find(image.pixels), 'searched')
        return self._in_any_light(image, best), [one.pose for one in locations]

    def _surest(self, image: CameraImage, found: Sight) -> Sight:
        """Return what surely agrees near a place that landmarks told badly, else that place."""
        sure = self._thresholds.sure
        if found.agreement >= sure:
            return found
        closer = self._looker.best_of(image, [found.pose], 'searched')
        return closer if closer is not None and closer.agreement >= sure else found

    def _in_any_light(self, image: CameraImage, best: Sight | None) -> Sight | None:
        """Return what is believed if the light is another one; else what was found."""
        if best is None or best.believed or best.agreement < self._thresholds.least_located:
            return best
        lit = self._looker.look_in_any_light(image, best)
        return lit if lit.believed else best

    def look_around(self, image: CameraImage, prior: CameraPose) -> Sight | None:
        """Look around where somebody says that the camera is; None: nothing is like it."""
        limits = self._thresholds
        location = self.locate(image, prior)
        # A click on a map tells no height: the places around it do.
        if location is not None and is_near(location.pose, self.glances.on_storey(prior),
                                            limits.prior_metres, limits.prior_cosine):
            return replace(self.look_from(location, image), found='prior')
        starts = [prior, *self.glances.find(image.pixels, prior)]
        return self._looker.best_of(image, starts, 'prior')

    def locate(self, image: CameraImage, around: CameraPose) -> Location | None:
        """Return where landmarks say that a camera about there is; None: too few are seen."""
        return self.locator.locate(image.features, around) if self.locator else None

    def look_from(self, location: Location, image: CameraImage) -> Sight:
        """Look from where landmarks say, aligned with the image if they allow that."""
        pose = self._looker.aligner.align(image.photo, location.pose, 1, near=True)
        if not location.allows(pose):
            pose = location.pose
        self.watch.forget()  # What is tracked next may be off, too.
        return located(self._looker.look(image, pose, pose), self._thresholds.least_located,
                       location, 'landmarks')
