"""Whether a camera is in the scene that its model was trained in, told from scores."""

from dataclasses import dataclass


@dataclass(frozen=True)
class WatchThresholds:
    """Mean scores: apart, as a camera now and then unlike the scene must not flip the verdict."""

    unlike_above: float = 0.5
    like_below: float = 0.35


class SceneWatch:
    """Turns the mean score of the last images into a verdict that does not flicker."""

    def __init__(self, thresholds: WatchThresholds = WatchThresholds()) -> None:
        self._thresholds = thresholds
        self.unlike = False

    def update(self, score: float | None) -> bool:
        """Return whether the images are unlike the trained scene; None = nothing is known."""
        if score is None:
            return False
        self.unlike = score > (self._thresholds.like_below if self.unlike
                               else self._thresholds.unlike_above)
        return self.unlike
