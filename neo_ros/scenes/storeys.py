"""Which photos are of which storey of a building, and where its floor is."""
import numpy as np

# Metres between photos one above the other from which on they are of two storeys; and how many a
# storey has at least, for a pose may be wrong.
APART, LEAST = 1.5, 10
# Metres that a floor is below every camera at least; how many points below them tell where it is,
# and how many of a hundred may lie deeper: stereo errs, and there are stairs.
BENEATH, LEAST_POINTS, WRONG_PERCENT = 0.1, 1000, 5


def storey_borders(z: np.ndarray) -> list[float]:
    """Return the heights between the storeys of photos at heights z (N,), from below; metres."""
    ordered = np.sort(z)
    gaps = np.flatnonzero(np.diff(ordered) >= APART)
    gaps = gaps[(gaps + 1 >= LEAST) & (len(z) - gaps - 1 >= LEAST)]
    return ((ordered[gaps] + ordered[gaps + 1]) / 2).tolist()


def floor_height(z: np.ndarray, low: float, high: float) -> float | None:
    """
    Return the height of a storey's floor: next to nothing of what is seen lies below it.

    z (N,): heights of points that its photos show, metres; some may be wrong, others lie out of
    the window. low: of the highest camera of the storey below; high: of its own lowest camera.
    None where too few tell.
    """
    between = z[(z > low) & (z < high - BENEATH)]
    return None if len(between) < LEAST_POINTS else float(np.percentile(between, WRONG_PERCENT))
