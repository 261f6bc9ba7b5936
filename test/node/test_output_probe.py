"""Every output of the memory has a price, so `neo bench --only node` can name it."""
from neo_ros.flat.demo_flat import build_demo_flat, walking_paths
from neo_ros.machine.files import share_dir
from neo_ros.runtime import read_model_card
import numpy as np
import pytest

pytestmark = pytest.mark.slow


def test_all_outputs_are_measured_on_every_frame_after_the_first_ones() -> None:
    rclpy = pytest.importorskip('rclpy')
    from neo_ros.node.output_probe import MADE, measure, WARM_UP
    model, flat = share_dir() / 'models/demo_flat.onnx', build_demo_flat()
    view = read_model_card(model).expansion.source
    images = np.stack([flat.render(view, pose)[0] for pose in walking_paths(flat, 1, 6, 9)[0]])
    rclpy.init(args=[])
    try:
        found = measure(model, images)
    finally:
        rclpy.try_shutdown()
    assert {name: len(times) for name, times in found.items()} == {
        names[0]: len(images) - WARM_UP for names in MADE}
    assert all(time > 0 for times in found.values() for time in times)
