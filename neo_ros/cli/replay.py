"""`neo replay`: widen the camera of a bag without a ROS graph."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def replay(
    bag: Annotated[Path, typer.Argument(help='Bag folder (MCAP or sqlite3) or .mcap file.')],
    out: Annotated[Path, typer.Option(help='Folder of the new bag; must not exist yet.')],
    model: Annotated[Optional[Path], typer.Option(
        help='Model file (.onnx); default: the shipped demo_flat.onnx.')] = None,
    image_topic: Annotated[Optional[str], typer.Option(
        help='Camera image; default: the only image topic of the size the model takes.')] = None,
    truth_topic: Annotated[Optional[str], typer.Option(
        help='Wide images to score against, for instance /camera/wide/image_raw.')] = None,
    copy: Annotated[bool, typer.Option(
        help='Copy the other topics of the bag into the new one.')] = True,
) -> None:
    """Widen the camera of a bag: a new bag with its wide topics, and scores against truth."""
    from neo_ros.bags import replay as replay_bag
    from neo_ros.evaluation.metrics import score_frame
    from neo_ros.paths import share_dir
    from neo_ros.runtime import FovExtrapolator
    import numpy as np
    import rich
    from rich.markup import escape
    from rich.progress import Progress

    extrapolator = FovExtrapolator.load(model or share_dir() / 'models' / 'demo_flat.onnx')
    frames: list[dict[str, float]] = []

    def score(stamp_ns: int, truth: np.ndarray, wide_image: np.ndarray) -> None:
        frames.append({'stamp_ns': stamp_ns,
                       **score_frame(truth, wide_image, extrapolator.expansion)})

    with Progress(transient=True) as progress:
        task = progress.add_task('replaying', total=None)
        result = replay_bag(
            bag, extrapolator, out, image_topic, truth_topic, copy, score,
            lambda done, total: progress.update(task, completed=done, total=total))
    if result.recovered:
        rich.print(f'[yellow]{escape(result.recovered)}[/yellow]')
    rate = result.frames / result.wall_seconds
    model_rate = result.frames / result.expand_seconds if result.frames else 0.0
    rich.print(f'{result.image_topic}: {result.frames} frames at {rate:.1f} Hz '
               f'(the model alone: {model_rate:.1f} Hz)')
    for reason, count in sorted(result.rejected.items()):
        rich.print(f'[yellow]rejected: {count} x {reason}[/yellow]')
    if frames:
        _report_scores(frames, out / 'scores.json', {
            'bag': bag.name, 'image_topic': result.image_topic, 'truth_topic': truth_topic,
            'scene_id': extrapolator.card.scene_id, 'config_hash': extrapolator.card.config_hash})
    elif truth_topic is not None:
        rich.print(f'[yellow]no image of {truth_topic} has the stamp of a frame[/yellow]')
    rich.print(f'Written: {out}')


def _report_scores(frames: list[dict[str, float]], path: Path,
                   about: dict[str, Optional[str]]) -> None:
    """Print the mean scores and write them with those of every frame."""
    import json

    import rich
    from rich.table import Table

    names = [name for name in frames[0] if name != 'stamp_ns']
    mean = {name: sum(frame[name] for frame in frames) / len(frames) for name in names}
    path.write_text(json.dumps({**about, 'mean': mean, 'frames': frames}, indent=1) + '\n')
    table = Table('score', f'mean of {len(frames)} frames', 'lowest')
    for name in names:
        table.add_row(name, f'{mean[name]:.3f}', f'{min(frame[name] for frame in frames):.3f}')
    rich.print(table)
