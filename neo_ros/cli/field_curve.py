"""`neo field-curve`: how good the field is after how many minutes."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def field_curve(
    scene: Annotated[Path, typer.Argument(help='Scene folder with wide test frames.')],
    scale: Annotated[str, typer.Option(
        help='full, half, quarter or eighth of the photos.')] = 'quarter',
    minutes: Annotated[Optional[list[float]], typer.Option(
        help='Training time; may be repeated. Default: 1 and 5.', min=0.01)] = None,
    config: Annotated[Optional[Path], typer.Option(
        help='Experiment file (YAML) with the settings of the field.')] = None,
    views: Annotated[int, typer.Option(
        min=1, help='Test frames, and held-out photos, to look at, evenly spread.')] = 25,
    out: Annotated[Path, typer.Option(
        help='JSON file of the rows; those that it has are not measured again.')] = Path(
        'out/field_curve.json'),
) -> None:
    """
    Train a field for several times, and score each on held-out photos and wide test views.

    Choose a time by the held-out photos: the test views are for the last scoring.
    Where nerfstudio is installed, its nerfacto trains for the minutes that ours took.
    """
    from neo_ros.benchmark.field_curve import measure_field_curve
    from neo_ros.benchmark.protocols import SCALES
    from neo_ros.cli.progress import stage_progress
    from neo_ros.errors import ConfigError
    from neo_ros.experiment import Experiment, read_experiment
    import rich
    from rich.markup import escape

    if scale not in SCALES:
        raise ConfigError(f'scale: expected {", ".join(SCALES)}, got {scale!r}')
    experiment = read_experiment(config) if config else Experiment()
    with stage_progress() as show:
        table = measure_field_curve(
            scene, experiment, scale, minutes or (1.0, 5.0), views, out, show)
    print(table)
    rich.print(f'Written: {escape(str(out))}')
