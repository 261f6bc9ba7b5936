"""Whether a camera is in the scene that its model was trained in, told from scores."""

# A camera that is now and then unlike the scene must not flip the verdict every second.
UNLIKE_ABOVE, LIKE_BELOW = 0.5, 0.35


class SceneWatch:
    """Turns the mean score of the last images into a verdict that does not flicker."""

    def __init__(self) -> None:
        self.unlike = False

    def update(self, score: float | None) -> bool:
        """Return whether the images are unlike the trained scene; None = nothing is known."""
        if score is None:
            return False
        self.unlike = score > (LIKE_BELOW if self.unlike else UNLIKE_ABOVE)
        return self.unlike
