"""Which photos are of which storey of a building."""
import numpy as np

# Metres between photos one above the other from which on they are of two storeys; and how many a
# storey has at least, for a pose may be wrong.
APART, LEAST = 1.5, 10


def storey_borders(z: np.ndarray) -> list[float]:
    """Return the heights between the storeys of photos at heights z (N,), from below; metres."""
    ordered = np.sort(z)
    gaps = np.flatnonzero(np.diff(ordered) >= APART)
    gaps = gaps[(gaps + 1 >= LEAST) & (len(z) - gaps - 1 >= LEAST)]
    return ((ordered[gaps] + ordered[gaps + 1]) / 2).tolist()
