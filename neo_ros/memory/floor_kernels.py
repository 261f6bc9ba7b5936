"""The compiled loop that lays the points of a keyframe on a floor plan."""
from neo_ros.machine.compiled import njit
from neo_ros.memory.kernels import FAST
import numpy as np


@njit(**FAST)
def stack_points(rays, depth, colours, position, low, over_edge, over_step, sums):
    """
    Add a keyframe's points to the layers above a floor plan's cells.

    rays (h, w, 3) unit directions in the world, depth (h, w) metres along them (0 = unknown),
    colours uint8 (h, w, 3); position (3,) of the keyframe, metres. low (3,): the lower corner of
    the first cell's first layer; over_edge, over_step: cells and layers a metre.
    sums float32 (layers, rows, columns, 4): sum of colours and number of points.
    """
    layers, rows, columns = sums.shape[0], sums.shape[1], sums.shape[2]
    for i in range(depth.shape[0]):
        for j in range(depth.shape[1]):
            d = depth[i, j]
            if d <= 0:
                continue
            x = (position[0] + rays[i, j, 0] * d - low[0]) * over_edge
            y = (position[1] + rays[i, j, 1] * d - low[1]) * over_edge
            z = (position[2] + rays[i, j, 2] * d - low[2]) * over_step
            if not (0 <= x < columns and 0 <= y < rows and 0 <= z < layers):
                continue
            cell = sums[np.int64(z), np.int64(y), np.int64(x)]
            for c in range(3):
                cell[c] += colours[i, j, c]
            cell[3] += 1
