"""Which photos are of which storey of a building, and where its floor is."""
import numpy as np

# Metres between photos one above the other from which on they are of two storeys; and how many a
# storey has at least, for a pose may be wrong.
APART, LEAST = 1.5, 10
# Metres that a floor is below every camera at least; of a layer of points; and how many tell.
BENEATH, LAYER, LEAST_POINTS = 0.1, 0.05, 1000


def storey_borders(z: np.ndarray) -> list[float]:
    """Return the heights between the storeys of photos at heights z (N,), from below; metres."""
    ordered = np.sort(z)
    gaps = np.flatnonzero(np.diff(ordered) >= APART)
    gaps = gaps[(gaps + 1 >= LEAST) & (len(z) - gaps - 1 >= LEAST)]
    return ((ordered[gaps] + ordered[gaps + 1]) / 2).tolist()


def floor_height(z: np.ndarray, lowest_camera: float) -> float | None:
    """
    Return the height of the floor: most of what is seen below the cameras lies at it.

    z (N,): heights of points that a storey's photos show, metres. None where too few tell.
    """
    below = z[z < lowest_camera - BENEATH]
    if len(below) < LEAST_POINTS:
        return None
    heights, counts = np.unique(np.floor(below / LAYER), return_counts=True)
    fullest = heights[counts.argmax()] * LAYER
    return float(np.median(below[(below >= fullest - LAYER) & (below < fullest + 2 * LAYER)]))
