"""`neo bag`: make a bag from the test frames of a scene, as if the robot had recorded it."""
from pathlib import Path
from typing import Annotated

import typer


def bag(
    scene: Annotated[Path, typer.Argument(help='Scene folder with transforms_test.json.')],
    out: Annotated[Path, typer.Option(help='Folder of the new bag; must not exist yet.')],
    model: Annotated[Path, typer.Option(
        help='Model file (.onnx) whose camera the bag shall have.')],
    rate: Annotated[float, typer.Option(help='Frames per second.', min=0.1)] = 10.0,
) -> None:
    """
    Make a bag of a scene's test frames: the camera's view, its poses, and the wide truth.

    Play it on a ROS graph with neo play, or run neo replay over it.
    """
    from neo_ros.bags.demo_bag import TRUTH_TOPIC, write_demo_bag
    from neo_ros.cli.options import tell_next
    from neo_ros.evaluation.evaluate import TruthFrames
    from neo_ros.runtime import read_model_card
    from neo_ros.scenes.upright import read_upright_scene
    import rich
    from rich.markup import escape
    from rich.progress import track

    found = read_upright_scene(scene)  # Its poses are the memory's.
    frames = TruthFrames(found.test, read_model_card(model).expansion)
    period_ns = int(1e9 / rate)
    height = found.walkable.camera_height if found.walkable is not None else 0.0
    count = write_demo_bag(
        out, ((index * period_ns + 1_000_000_000, frames.read(index)[1],
               frames.images.poses[index])
              for index in track(range(len(frames)), description='frames', transient=True)),
        frames.expansion, height)
    rich.print(f'{escape(str(out))}: {count} frames')
    tell_next('neo', 'replay', out, '--model', model, '--truth-topic', TRUTH_TOPIC,
              '--out', f'{out}_wide')
