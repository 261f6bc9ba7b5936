"""`neo replay`: widen the camera of a bag, or of many, without a ROS graph."""
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Optional

from neo_ros.cli.options import CameraInfo, ImageTopic, InfoTopic, Rectify
from neo_ros.errors import ConfigError
import typer


def replay(
    bag: Annotated[list[Path], typer.Argument(
        help='Bag folder (MCAP or sqlite3), .mcap or .db3; may be several.')],
    out: Annotated[Path, typer.Option(
        help='Folder of the new bag; must not exist yet. Of several, or where several were '
             'written before: folder of the new bags; what is finished there is not done again.')],
    model: Annotated[Optional[Path], typer.Option(
        help='Model file (.onnx); default: the shipped demo_flat.onnx.')] = None,
    image_topic: ImageTopic = None,
    info_topic: InfoTopic = None,
    camera_info: CameraInfo = None,
    start: Annotated[float, typer.Option(
        help='Begin so many seconds after the first message.', min=0)] = 0.0,
    end: Annotated[Optional[float], typer.Option(
        help='Stop so many seconds after the first message.')] = None,
    every: Annotated[int, typer.Option(
        help='Widen only every so many-th image.', min=1)] = 1,
    rectify: Rectify = False,
    side_by_side: Annotated[Optional[Path], typer.Option(
        help='Also write a video (.mp4): camera and widened view; of one bag.')] = None,
    score: Annotated[bool, typer.Option(
        '--score', help='Score: against the wide images of the bag, or, if it has none, '
                        "against the camera's own border.")] = False,
    truth_topic: Annotated[Optional[str], typer.Option(
        help='Wide images to score against; default: the only ones of that size in the frame of '
             'the camera, with its stamps.')] = None,
    output: Annotated[Optional[list[str]], typer.Option(
        help='Also write what the scene memory knows: pose, status, depth, points, panorama, '
             'panorama_mask; may be given several times; default: pose and status.')] = None,
    learn: Annotated[bool, typer.Option(
        '--learn', help='Learn what has changed in the scene: kept in a journal beside the scene '
                        'memory, see neo memory; from one bag.')] = False,
    copy: Annotated[bool, typer.Option(
        help='Copy the other topics of the bag into the new one.')] = True,
    cluster: Annotated[bool, typer.Option(
        '--cluster', help='Hand several bags to Ray: to the cluster of RAY_ADDRESS, else to all '
                          'cores of this machine.')] = False,
) -> None:
    """
    Widen the camera of a bag: a new bag with its wide topics beside all that was in it.

    With --score also scores.csv, scores.json and report.html in the new folder.

    Of several bags each becomes a new bag of its name in the folder, beside bags.json and
    report.html of all. One that fails does not stop the others; the exit code is then 1.
    """
    from neo_ros.bags import Section
    from neo_ros.bags.camera_choice import CameraChoice
    from neo_ros.bags.replay_outputs import DEFAULT_OUTPUTS
    from neo_ros.cli.options import refuse
    from neo_ros.machine.files import share_dir
    from neo_ros.replaying.bag_replayer import ReplayOptions
    from neo_ros.replaying.summary import SUMMARY_FILE

    model = model or share_dir() / 'models' / 'demo_flat.onnx'
    options = ReplayOptions(
        CameraChoice(image_topic, info_topic, camera_info, rectify), Section(start, end, every),
        score, truth_topic, tuple(DEFAULT_OUTPUTS if output is None else output), copy)
    if len(bag) == 1 and not (out / SUMMARY_FILE).is_file():
        refuse('it shares out several bags, and there is one', cluster=cluster)
        _replay_one(bag[0], model, out, options, side_by_side, learn)
        return
    refuse(f'of one bag only, and {out} is of several', side_by_side=side_by_side)
    refuse('what is learnt from one bag would change the next', learn=learn)
    _replay_many(bag, model, out, options, cluster)


def _replay_one(bag: Path, model: Path, out: Path, options: Any, side_by_side: Path | None,
                learn: bool) -> None:
    """Replay a bag and print what became of it; `options` are ReplayOptions."""
    from contextlib import ExitStack

    from neo_ros.cli.options import tell_next
    from neo_ros.cli.progress import stage_progress
    from neo_ros.replaying.bag_replayer import BagReplayer
    import rich
    from rich.markup import escape

    if side_by_side is not None and out.resolve() in side_by_side.resolve().parents:
        raise ConfigError(f'--side-by-side: expected a file outside of {out}, which --out makes '
                          f'anew, got {side_by_side}')
    replayer = BagReplayer(model, learn=learn)
    with ExitStack() as stack:
        on_frame = None
        if side_by_side is not None:
            from neo_ros.reports.side_by_side import SideBySide
            on_frame = stack.enter_context(
                SideBySide(side_by_side, replayer.extrapolator.expansion)).add
        show = stack.enter_context(stage_progress())
        found = replayer.replay(bag, out, options, on_frame,
                                lambda done, total: show('replaying, messages', done, total))
    replayer.extrapolator.finish_learning()
    _print_result(found.result, found.guided)
    if found.scores is not None:
        found.scores.write(out, found.about)
        _print_scores(found.scores, found.about)
    elif found.truth_topic is not None:
        rich.print(
            f'[yellow]no image of {escape(found.truth_topic)} has the stamp of a frame[/yellow]')
    for written in (out, side_by_side):
        if written is not None and written.exists():
            rich.print(f'Written: {escape(str(written))}')
    tell_next('neo', 'view', '--bag', out)


def _replay_many(bags: Sequence[Path], model: Path, out: Path, options: Any, cluster: bool
                 ) -> None:
    """Replay bags into a folder and print what became of them; ends with 1 where one failed."""
    from neo_ros.cli.progress import stage_progress
    from neo_ros.replaying.many_bags import replay_bags
    from neo_ros.replaying.summary import REPORT_FILE, summary_table
    import rich
    from rich.markup import escape
    from rich.table import Column, Table

    with stage_progress() as show:
        rows = replay_bags(bags, model, out, options, cluster, show)
    (first, *columns), (*lines, last) = summary_table(rows)
    table = Table(Column(first, overflow='fold'),
                  *(Column(name, justify='right') for name in columns))
    for line in lines:
        table.add_row(*map(escape, line))
    table.add_section()
    table.add_row(*map(escape, last))
    rich.print(table)
    for row in rows:
        for words in filter(None, (row.assumed, *row.damages)):
            rich.print(f'[yellow]{escape(row.name)}: {escape(words)}[/yellow]')
    failed = [row for row in rows if row.error]
    for row in failed:
        rich.print(f'[red]{escape(row.name)} failed: {escape(row.error)}[/red]')
    rich.print(f'Written: {escape(str(out / REPORT_FILE))}')
    if failed:
        raise typer.Exit(1)


def _print_result(result: Any, guided: float | None) -> None:
    """Print what a ReplayResult holds, and the share of its frames that the memory knew."""
    import rich
    from rich.markup import escape

    for damage in result.damages:
        rich.print(f'[yellow]{escape(str(damage))}[/yellow]')
    if result.assumed:
        rich.print(f'[yellow]{escape(result.assumed)}[/yellow]')
    for reason, count in sorted(result.rejected.items()):
        words = escape(result.words[reason])
        rich.print(f'[yellow]rejected: {count} x {reason}, the first: {words}[/yellow]')
    rate = result.frames / result.wall_seconds
    model_rate = result.frames / result.expand_seconds
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
