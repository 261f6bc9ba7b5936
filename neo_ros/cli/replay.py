"""`neo replay`: widen the camera of a bag without a ROS graph."""
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any, Optional

from neo_ros.cli.options import ImageTopic, InfoTopic, Rectify
import typer


def replay(
    bag: Annotated[Path, typer.Argument(help='Bag folder (MCAP or sqlite3), .mcap or .db3.')],
    out: Annotated[Path, typer.Option(help='Folder of the new bag; must not exist yet.')],
    model: Annotated[Optional[Path], typer.Option(
        help='Model file (.onnx); default: the shipped demo_flat.onnx.')] = None,
    image_topic: ImageTopic = None,
    info_topic: InfoTopic = None,
    start: Annotated[float, typer.Option(
        help='Begin so many seconds after the first message.', min=0)] = 0.0,
    end: Annotated[Optional[float], typer.Option(
        help='Stop so many seconds after the first message.')] = None,
    every: Annotated[int, typer.Option(
        help='Widen only every so many-th image.', min=1)] = 1,
    rectify: Rectify = False,
    side_by_side: Annotated[Optional[Path], typer.Option(
        help='Also write a video (.mp4): camera and widened view.')] = None,
    score: Annotated[bool, typer.Option(
        '--score', help='Score: against the wide images of the bag, or, if it has none, '
                        "against the camera's own border.")] = False,
    truth_topic: Annotated[Optional[str], typer.Option(
        help='Wide images to score against; default: the only ones of that size.')] = None,
    output: Annotated[Optional[list[str]], typer.Option(
        help='Also write what the scene memory knows: pose, status, depth, points, panorama, '
             'panorama_mask; may be given several times; default: pose and status.')] = None,
    learn: Annotated[bool, typer.Option(
        '--learn', help='Learn what has changed in the scene: kept in a journal beside the scene '
                        'memory, see neo memory.')] = False,
    copy: Annotated[bool, typer.Option(
        help='Copy the other topics of the bag into the new one.')] = True,
) -> None:
    """
    Widen the camera of a bag: a new bag with its wide topics beside all that was in it.

    With --score also scores.csv, scores.json and report.html in the new folder.
    """
    from neo_ros.bags import replay as replay_bag, Section
    from neo_ros.bags.replay_outputs import DEFAULT_OUTPUTS
    from neo_ros.cli.options import tell_next
    from neo_ros.cli.progress import stage_progress
    from neo_ros.machine.files import share_dir
    from neo_ros.runtime import FovExtrapolator
    import numpy as np
    import rich
    from rich.markup import escape

    model = model or share_dir() / 'models' / 'demo_flat.onnx'
    section = Section(start, end, every)
    extrapolator = FovExtrapolator.load(model, learn='at once' if learn else 'never')
    scores, truth_topic = _prepare_scores(
        bag, model, extrapolator, image_topic, truth_topic, score, info_topic)
    with ExitStack() as stack:
        takers = [scores.add_frame] if scores is not None and truth_topic is None else []
        if side_by_side is not None:
            from neo_ros.reports.side_by_side import SideBySide
            takers.append(stack.enter_context(
                SideBySide(side_by_side, extrapolator.expansion)).add)

        def on_frame(stamp_ns: int, image: np.ndarray, wide_image: np.ndarray) -> None:
            for take in takers:
                take(stamp_ns, image, wide_image)

        show = stack.enter_context(stage_progress())
        result = replay_bag(
            bag, extrapolator, out, image_topic, truth_topic, copy, section,
            rectify, on_frame if takers else None, None if scores is None else scores.add_pair,
            lambda done, total: show('replaying, messages', done, total),
            DEFAULT_OUTPUTS if output is None else output, info_topic)
    extrapolator.finish_learning()
    guided = None
    if extrapolator.card.memory is not None and result.frames:
        guided = round(result.guided / result.frames, 4)
    _print_result(result, guided)
    if scores is not None and scores.rows:
        about = {'bag': bag.name, 'image_topic': result.image_topic, 'truth_topic': truth_topic,
                 'model': model.name, 'scene_id': extrapolator.card.scene_id,
                 'config_hash': extrapolator.card.config_hash,
                 # What the camera scores against itself are other frames than these.
                 'guided': guided if truth_topic is not None else None}
        scores.write(out, about)
        _print_scores(scores, about)
    elif truth_topic is not None:
        rich.print(f'[yellow]no image of {escape(truth_topic)} has the stamp of a frame[/yellow]')
    for written in (out, side_by_side):
        if written is not None and written.exists():
            rich.print(f'Written: {escape(str(written))}')
    if result.frames:
        tell_next('neo', 'view', '--bag', out)


def _prepare_scores(bag: Path, model: Path, extrapolator: Any, image_topic: str | None,
                    truth_topic: str | None, score: bool, info_topic: str | None
                    ) -> tuple[Any, str | None]:
    """Return what scores the frames, and the topic of the truth; None for none."""
    if not score and truth_topic is None:
        return None, None
    from neo_ros.bags import BagReader
    from neo_ros.bags.camera_topics import find_camera, find_truth_topic
    from neo_ros.evaluation.bag_scores import BagScores
    from neo_ros.runtime import FovExtrapolator

    expansion = extrapolator.expansion
    if truth_topic is None:
        with BagReader(bag) as reader:
            camera = find_camera(reader, expansion.source, image_topic, info_topic).image
            found = find_truth_topic(reader, camera,
                                     (expansion.target.width, expansion.target.height))
        truth_topic = None if found is None else found.name
    if truth_topic is not None:
        return BagScores(expansion), truth_topic
    # An extrapolator of its own: the one that widens the bag may remember what it saw.
    other = FovExtrapolator.load(model)
    return BagScores(expansion, lambda image: other.expand(image).wide_image), None


def _print_result(result: Any, guided: float | None) -> None:
    """Print what a ReplayResult holds, and the share of its frames that the memory knew."""
    import rich
    from rich.markup import escape

    for damage in result.damages:
        rich.print(f'[yellow]{escape(str(damage))}[/yellow]')
    for reason, count in sorted(result.rejected.items()):
        words = escape(result.words[reason])
        rich.print(f'[yellow]rejected: {count} x {reason}, the first: {words}[/yellow]')
    rate = result.frames / result.wall_seconds
    model_rate = result.frames / result.expand_seconds if result.frames else 0.0
    rich.print(f'{escape(result.image_topic)}: {result.frames} frames at {rate:.1f} Hz '
               f'(the model alone: {model_rate:.1f} Hz)')
    if guided is not None:
        rich.print(f'guided: the memory knew {guided:.0%} of the frames')


def _print_scores(scores: Any, about: dict[str, Any]) -> None:
    import rich
    from rich.markup import escape
    from rich.table import Table

    rich.print(escape(scores.how(about)))
    table = Table('score', f'mean of {len(scores.rows)} frames', 'lowest')
    for name, value in scores.mean.items():
        table.add_row(name, f'{value:.3f}', f'{scores.lowest[name]:.3f}')
    rich.print(table)
