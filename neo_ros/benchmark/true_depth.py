"""The depth that stability is measured with: exact in the demo flat, else the field's."""
import json
from pathlib import Path

from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.evaluation.stability import DepthOf
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view
from neo_ros.flat.demo_flat import build_demo_flat
from neo_ros.scenes.scene import DEMO_NOTE
import numpy as np


def is_demo_flat(scene_folder: Path) -> bool:
    """Tell whether a scene folder was rendered from the built-in flat."""
    try:
        return 'fingerprint' in json.loads((scene_folder / DEMO_NOTE).read_text())
    except (OSError, ValueError):
        return False


def demo_depth(frames: TruthFrames) -> DepthOf:
    """Cast the flat at the true pose of a frame: exact, metres along the optical axis."""
    flat = build_demo_flat()
    return lambda index: flat.depth(frames.expansion.target, frames.images.poses[index])


def field_depth(frames: TruthFrames, field: RadianceField) -> DepthOf:
    """Take the field's depth at the true pose, metres along the optical axis; NaN in fog."""
    camera = frames.expansion.target
    # The field measures along the ray.
    slant = np.linalg.norm(camera.pixel_rays(), axis=-1)

    def depth_of(index: int) -> np.ndarray:
        rendering = render_view(field, camera, frames.images.poses[index], 1)
        return np.where(rendering.opacity > 0.5, rendering.depth / slant, np.nan)

    return depth_of
