"""`neo evaluate`: score a model on the wide test frames of a scene, beside the floors."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def evaluate(
    scene: Annotated[Path, typer.Argument(
        help='Scene folder with transforms_test.json: wide frames that training never saw.')],
    model: Annotated[Path, typer.Option(help='Model file (.onnx) that neo train exported.')],
    out: Annotated[Optional[Path], typer.Option(
        help='Folder for scores.json and report.html; default: evaluation_<scene>.')] = None,
    frames: Annotated[Optional[int], typer.Option(
        min=1, help='Score only so many frames, spread evenly; default: all.')] = None,
) -> None:
    """Score a model on the test frames of a scene, beside edge replication and the mean photo."""
    from neo_ros.evaluation.baselines import EdgeReplication, MeanImage, Method, NeoModel
    from neo_ros.evaluation.evaluate import evaluate as score, TruthFrames
    from neo_ros.evaluation.evaluation_report import write_evaluation
    from neo_ros.evaluation.output import make_output_folder
    from neo_ros.scenes.scene import read_scene
    import rich
    from rich.markup import escape
    from rich.progress import (
        BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn)
    from rich.table import Table

    scene_data = read_scene(scene)
    neo = NeoModel(model)
    truth = TruthFrames(scene_data.test, neo.expansion, frames)
    folder = make_output_folder(out or Path(f'evaluation_{scene_data.name}'))
    train = scene_data.train
    with Progress(TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(),
                  TimeRemainingColumn()) as bar:
        task = bar.add_task('mean photo', total=len(train))
        photos = (train.read_image(i) for i in bar.track(range(len(train)), task_id=task))
        methods: list[Method] = [
            neo, EdgeReplication(neo.expansion), MeanImage(neo.expansion, photos)]
        task = bar.add_task('scoring', total=len(truth) * len(methods))
        results = score(scene_data.name, truth, methods,
                        progress=lambda done: bar.update(task, completed=done))
    write_evaluation(folder, scene_data.name, truth, methods, results)
    columns = {'ring_psnr': ('ring dB', 2), 'ring_ssim': ('ring SSIM', 3),
               'whole_psnr': ('whole dB', 2), 'whole_ssim': ('whole SSIM', 3),
               'latency_ms_median': ('ms', 1)}
    table = Table('method', *(title for title, _ in columns.values()))
    for result in results:
        table.add_row(result.method, *(f'{result.row[key]:.{digits}f}'
                                       for key, (_, digits) in columns.items()))
    rich.print(table)
    rich.print(f'Written: {escape(str(folder))}/scores.json and report.html')
