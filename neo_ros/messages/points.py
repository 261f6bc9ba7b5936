"""`sensor_msgs/PointCloud2` of a depth image, with colours and confidence."""
from typing import Any

from neo_ros.geometry import Intrinsics
from neo_ros.messages.scene_outputs import Make
import numpy as np

POINTS = 'sensor_msgs/msg/PointCloud2'
FLOAT32 = 7  # PointField.FLOAT32
FIELDS = ('x', 'y', 'z', 'rgb', 'confidence')
POINT_BYTES = 4 * len(FIELDS)


class PointMaker:
    """
    Makes clouds of one view, taking every `every`-th pixel of every such row.

    Points are in the optical frame, metres; x, y, z are NaN where the depth is unknown (REP-117).
    rgb is packed as PCL does; confidence is that of the pixel, 0 ... 255. Pixels are left out, not
    averaged: between a chair and a wall there is nothing.
    """

    def __init__(self, view: Intrinsics, every: int = 1) -> None:
        self._every = slice(every // 2, None, every)
        rays = view.pixel_rays()[self._every, self._every]
        self._across, self._down = rays[0, :, 0].copy(), rays[:, :1, 1].copy()

    def fields(self, make: Make, depth: np.ndarray, image: np.ndarray,
               confidence: np.ndarray) -> dict[str, Any]:
        """
        Return the fields below the header.

        depth float32 (H, W), image RGB uint8 (H, W, 3), confidence uint8 (H, W).
        """
        every = (self._every, self._every)
        z = depth[every]
        height, width = z.shape
        points = np.zeros((height, width, len(FIELDS)), '<f4')
        # Field by field: along an axis of three NumPy takes three times as long.
        np.multiply(z, self._across, out=points[..., 0])
        np.multiply(z, self._down, out=points[..., 1])
        points[..., 2] = z
        for byte in range(3):
            points.view(np.uint8)[..., 12 + byte] = image[every][..., 2 - byte]
        points[..., 4] = confidence[every]
        return {
            'height': height, 'width': width, 'is_bigendian': False, 'is_dense': False,
            'fields': [make('sensor_msgs/msg/PointField', name=name, offset=4 * i,
                            datatype=FLOAT32, count=1) for i, name in enumerate(FIELDS)],
            'point_step': POINT_BYTES, 'row_step': POINT_BYTES * width,
            'data': points.view(np.uint8).reshape(-1)}
