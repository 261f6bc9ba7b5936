"""
The one exception base of the package.

A message names the field, what was expected, what came, and what to do.
"""


class NeoError(Exception):
    """Anything the user can put right: bad input, bad file, bad setting."""


class GeometryError(NeoError, ValueError):
    """Intrinsics, poses or view expansions that describe no camera."""


class SceneError(NeoError, ValueError):
    """A capture or scene folder that cannot be read as posed images."""


class ConfigError(NeoError, ValueError):
    """An experiment file with unknown keys or values out of range."""


class ModelError(NeoError, ValueError):
    """A model file that is not a complete, valid neo_ros model."""


class ImageRejected(NeoError, ValueError):
    """
    An image or camera message that cannot be used.

    `reason` is a short stable word for counters ('encoding', 'size', 'step', ...).
    """

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


class BagError(NeoError, ValueError):
    """A bag that cannot be read or written."""
