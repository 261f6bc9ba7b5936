"""Frames of a video as robots record them."""
from fractions import Fraction
from typing import Any

import numpy as np


def video_packets(images: np.ndarray, codec: str = 'libx264', key_every: int = 5) -> list[bytes]:
    """Encode RGB uint8 (N, H, W, 3), a packet an image, with a key frame every so often."""
    import av
    context: Any = av.CodecContext.create(codec, 'w')
    context.height, context.width = images.shape[1:3]
    context.pix_fmt, context.time_base = 'yuv420p', Fraction(1, 10)
    context.gop_size = key_every
    context.options = {'tune': 'zerolatency', 'preset': 'ultrafast', 'x265-params': (
        f'keyint={key_every}:min-keyint={key_every}:repeat-headers=1:log-level=none')} if (
            codec == 'libx265') else {'tune': 'zerolatency', 'preset': 'ultrafast'}
    packets = []
    for image in images:
        packet, = context.encode(av.VideoFrame.from_ndarray(image, format='rgb24'))
        packets.append(bytes(packet))
    return packets
