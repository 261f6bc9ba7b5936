"""`neo evaluate`: score a model on the wide test frames of a scene, beside the floors."""
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Optional

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
    """
    Score a model on the test frames of a scene, beside edge replication and the mean photo.

    Of a model with a scene memory, the network alone is scored, too, and how true pose and
    covariance are goes into geometry.json, of the demo flat depth and map, too. Also says how true
    the confidence is.
    """
    from neo_ros.benchmark.protocols import split_walks
    from neo_ros.cli.progress import stage_progress
    from neo_ros.evaluation.baselines import EdgeReplication, MeanImage, Method, NeoModel
    from neo_ros.evaluation.evaluate import evaluate as score, TruthFrames
    from neo_ros.evaluation.evaluation_report import write_evaluation
    from neo_ros.machine.files import make_output_folder
    from neo_ros.scenes.upright import read_upright_scene
    import numpy as np

    scene_data = read_upright_scene(scene)  # Its poses are the memory's.
    neo = NeoModel(model)
    test = scene_data.test
    truth = TruthFrames(test and split_walks(test), neo.expansion, frames)
    folder = make_output_folder(out or Path(f'evaluation_{scene_data.name}'))
    train = scene_data.train
    with stage_progress() as show:
        def photos() -> Iterator[tuple[np.ndarray, np.ndarray]]:
            for index in range(len(train)):
                yield train.read_shown(index)
                show('mean photo', index + 1, len(train))

        alone: list[Method] = [NeoModel(model, guided=False)] if neo.guided else []
        methods: list[Method] = [
            neo, *alone, EdgeReplication(neo.expansion), MeanImage(neo.expansion, photos())]
        results = score(scene_data.name, truth, methods, progress=lambda done: show(
            'scoring', done, len(truth) * len(methods)))
        show('confidence', 0, 1)
        confidence = write_evaluation(folder, scene_data.name, truth, results, model)
        show('confidence', 1, 1)
        geometry = None
        if neo.guided:
            geometry = _score_geometry(scene, scene_data.name, model, truth, folder, lambda done:
                                       show('geometry', done, len(truth)))
    _tell(folder, results, confidence, geometry)


def _tell(folder: Path, results: Any, confidence: dict[str, dict[str, float]],
          geometry: dict[str, Any] | None) -> None:
    """Print the scores, and where they are written."""
    import rich
    from rich.markup import escape
    from rich.table import Table

    columns = {'ring_psnr': ('ring dB', 2), 'ring_ssim': ('ring SSIM', 3),
               'whole_psnr': ('whole dB', 2), 'whole_ssim': ('whole SSIM', 3),
               'latency_ms_median': ('ms', 1)}
    table = Table('method', *(title for title, _ in columns.values()))
    for result in results:
        table.add_row(result.method, *(f'{result.row[key]:.{digits}f}'
                                       for key, (_, digits) in columns.items()))
    rich.print(table)
    for result in results:
        if 'guided' in result.estimates:
            rich.print(f'{result.method}: the memory knew '
                       f'{result.estimates["guided"].mean:.0%} of the frames')
    for name, figures in confidence.items():
        rich.print(f'{name.replace("_", " ")}: off by '
                   f'{figures["expected_calibration_error"]:.1f} of 255 (expected calibration '
                   f'error), AUSE {figures["sparsification_error"]:.2f}')
    if geometry is not None and geometry['pose_share']:
        rich.print(f'pose: off by {geometry["position_cm_median"]:.2f} cm and '
                   f'{geometry["rotation_deg_median"]:.3f} degrees (medians); within the stated '
                   f'95 %: {geometry["position_covered_95"]:.1%} and '
                   f'{geometry["rotation_covered_95"]:.1%} of the frames')
    also = ', geometry.json' if geometry is not None else ''
    rich.print(f'Written: {escape(str(folder))}/scores.json{also} and report.html')


def _score_geometry(scene: Path, name: str, model: Path, truth: Any, folder: Path,
                    progress: Callable[[int], None]) -> dict[str, Any]:
    """Score pose and depth, write geometry.json, return its row."""
    import json

    from neo_ros.benchmark.true_depth import demo_depth, is_demo_flat
    from neo_ros.evaluation.geometry import OccupancyGrid, score_geometry
    from neo_ros.machine.files import write_bytes
    from neo_ros.runtime import FovExtrapolator

    exact = is_demo_flat(scene)
    row = score_geometry(name, truth, FovExtrapolator.load(model),
                         demo_depth(truth) if exact else None, OccupancyGrid() if exact else None,
                         progress)
    write_bytes(folder / 'geometry.json', json.dumps([row], indent=1, allow_nan=False).encode())
    return row
