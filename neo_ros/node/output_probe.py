"""
What each output of the memory costs: made of a widened frame, and given to its publisher.

A program of its own, because rclpy is no part of the rooms that measure; prints one JSON object:
milliseconds of every frame by output. `neo_ros.speed.node` runs it.
"""
import argparse
from collections.abc import Sequence
import json
from pathlib import Path
import time

from neo_ros.messages import FrameProcessor, image_fields
from neo_ros.messages.memory_messages import MEMORY_OUTPUTS, MemoryMessages, MemorySettings
from neo_ros.node.fastdds_profile import use_large_image_profile
from neo_ros.node.interface import OUTPUTS
from neo_ros.node.message_types import make_message
from neo_ros.runtime import FovExtrapolator
import numpy as np
import rclpy
from rclpy.time import Time

# What is made in one go is measured in one.
MADE = (('pose',), ('status',), ('depth',), ('points',), ('panorama', 'panorama_mask'))
# Frames before the clock starts: what is compiled or kept at first use.
WARM_UP = 3


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure once and print the result."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument('--model', type=Path, required=True)
    parser.add_argument('--images', type=Path, required=True)
    options = parser.parse_args(arguments)
    use_large_image_profile()
    rclpy.init(args=[])
    try:
        print(json.dumps(measure(options.model, np.load(options.images))))
    finally:
        rclpy.try_shutdown()


def measure(model: Path, images: np.ndarray) -> dict[str, list[float]]:
    """Widen images, uint8 RGB (N, h, w, 3); return the milliseconds of each output's messages."""
    node = rclpy.create_node('output_probe')
    publishers = {name: node.create_publisher(OUTPUTS[name].kind, OUTPUTS[name].name, 1)
                  for name in MEMORY_OUTPUTS}
    processor = FrameProcessor(FovExtrapolator.load(model))
    messages = MemoryMessages(make_message, MemorySettings('map', 'output_probe',
                                                           panorama_fps=1e9))
    found: dict[str, list[float]] = {names[0]: [] for names in MADE}
    for number, image in enumerate(images):
        fields = image_fields(image)
        message = make_message('sensor_msgs/msg/Image', **fields)
        message.header.stamp = Time(seconds=number + 1).to_msg()
        frame = processor.process(message, None)
        for names in MADE:
            started = time.perf_counter()
            sent = 0
            for made, output in messages.of(message.header, frame, names, 0.0):
                publishers[made].publish(output)
                sent += 1
            if sent and number >= WARM_UP:
                found[names[0]].append(1e3 * (time.perf_counter() - started))
    return found


if __name__ == '__main__':
    main()
