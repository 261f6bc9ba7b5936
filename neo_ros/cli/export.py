"""`neo export`: a trained model as fp32, fp16 and int8 files, and what each of them costs."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def export(
    scene: Annotated[Path, typer.Argument(help='Scene folder that the model was trained on.')],
    out: Annotated[Path, typer.Option(help='Folder of the finished neo train.')],
    config: Annotated[Optional[Path], typer.Option(
        help='Experiment file (YAML) of that training, if it was with one and without '
             '--minutes.')] = None,
    threads: Annotated[int, typer.Option(min=0, help='Threads to time on; 0 = all.')] = 0,
) -> None:
    """
    Write SCENE.fp32.onnx, SCENE.fp16.onnx and SCENE.int8.onnx beside the trained model.

    Prints size, time on this machine's CPU, and the ring PSNR on photos held out of the
    training. fp16 is for GPUs. int8 needs a CPU with int8 instructions (VNNI) to be fast and
    as good as it is measured here.
    """
    from neo_ros.cli.progress import stage_progress
    from neo_ros.experiment import read_experiment
    from neo_ros.scenes.upright import read_upright_scene
    from neo_ros.training.folder import named_as_trained
    from neo_ros.training.run import TrainingRun
    from neo_ros.training.time_plan import settings_of
    from neo_ros.training.variants import export_variants
    import rich
    from rich.markup import escape
    from rich.table import Table

    experiment = settings_of(out, read_experiment(config) if config is not None else None)
    with stage_progress() as show:
        variants = export_variants(TrainingRun(
            named_as_trained(read_upright_scene(scene), out), experiment, out, show),
            threads=threads)
    table = Table('format', 'file', 'MB', 'ms', 'ring dB', 'loss dB')
    best = max(variant.ring_psnr for variant in variants)
    for variant in variants:
        table.add_row(variant.name, escape(variant.path.name), f'{variant.megabytes:.1f}',
                      f'{variant.milliseconds:.1f}', f'{variant.ring_psnr:.2f}',
                      f'{best - variant.ring_psnr:.2f}')
    rich.print(table)
