"""`neo compare`: train several experiments on one scene and put them side by side."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def compare(
    scene: Annotated[Path, typer.Argument(help='Scene folder, made by neo import.')],
    configs: Annotated[list[Path], typer.Argument(
        help='Experiment files (YAML), for example config/experiments/networks/*.yaml.')],
    out: Annotated[Path, typer.Option(help='Folder: one run in it for each experiment.')],
    minutes: Annotated[Optional[list[float]], typer.Option(
        help='Train every outpainter for so many minutes, instead of what its file says; may be '
        'repeated, to see what more time brings.')] = None,
    steps: Annotated[Optional[int], typer.Option(
        min=1, help='Train every outpainter for so many steps; not with --minutes.')] = None,
) -> None:
    """
    Arithmetic against quality: of the three networks, or of ablations.

    Experiments with the same field settings share one field. Leaves comparison.html and
    comparison.json in OUT. Broken off? Run the same command again.
    """
    from neo_ros.benchmark.comparison import compare as run_comparison
    from neo_ros.cli.progress import stage_progress
    import rich
    from rich.markup import escape
    from rich.table import Table

    with stage_progress() as show:
        rows = run_comparison(scene, configs, out, minutes or (), steps, show)
    table = Table('experiment', 'GFLOP', 'ms', 'samples', 'held out dB', 'test dB', 'front')
    for row in rows:
        scores = ('' if score is None else f'{score:.2f}'
                  for score in (row.validation_psnr, row.ring_psnr))
        table.add_row(escape(row.name), f'{row.gflop:.2f}', f'{row.milliseconds:.1f}',
                      str(row.samples), *scores, 'yes' if row.on_front else '')
    rich.print(table)
    rich.print(f'Written: {escape(str(out))}/comparison.html')
