"""Which places of a scene a robot cannot tell apart: for the report of a training."""
from neo_ros.geometry import CameraPose
from neo_ros.machine.files import sha256_of
from neo_ros.memory.rendering import MemoryRenderer
from neo_ros.memory.scene_memory import SceneMemory
from neo_ros.reports.report import Section, Strip, Text
from neo_ros.training.run import TrainingRun
import numpy as np

# Pairs of places that are shown; a building of equal rooms has hundreds.
MOST_SHOWN = 12


def look_alike_sections(run: TrainingRun) -> list[Section]:
    """Show the pairs of places that the scene memory knows to look alike; none: no section."""
    if run.experiment.memory is None:
        return []
    path = run.memory_path
    memory = SceneMemory.read(path, sha256_of(path))
    twins, renderer = memory.twins, MemoryRenderer(memory)
    if not len(twins):
        return []
    source = run.expansion.source
    strips = list[Section]()
    for T, pose in list(zip(twins.T, twins.T_world_cam))[:MOST_SHOWN]:
        ends = [CameraPose.nearest(end) for end in (pose, T @ pose)]
        strips.append(Strip(' and '.join('({:.1f}, {:.1f}, {:.1f})'.format(
            *end.position) for end in ends), [
                (name, renderer.render(end, source).image.clip(0, 255).astype(np.uint8))
                for name, end in zip(('here', 'and there'), ends)]))
    count = f'{len(twins)} pair{"s" * (len(twins) > 1)} of places'
    shown = f'; {MOST_SHOWN} are shown' if len(twins) > MOST_SHOWN else ''
    return [Text(f'{count} (x, y, z of the camera, metres){shown}. A robot that starts in one of '
                 'them says "ambiguous" until it sees what only one has. More photos of what '
                 'differs, in the doors above all, or a sign in one of them, tell them apart.',
                 'Places that look alike'), *strips]
