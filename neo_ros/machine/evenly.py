"""Some of many, evenly chosen."""
import numpy as np


def evenly(count: int, most: int) -> np.ndarray:
    """Choose at most so many of `count` places, int64 (N,), from the first to the last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(np.int64)
