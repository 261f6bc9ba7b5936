"""`neo inspect`: what a model file says of itself, and how fast it runs here."""  # noqa: A005
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from neo_ros.runtime import ModelCard

TIMED_RUNS = 15


def inspect(
    model: Annotated[Path, typer.Argument(help='Model file (.onnx) that neo train exported.')],
    threads: Annotated[int, typer.Option(min=0, help='Threads to run on; 0 = all.')] = 0,
) -> None:
    """Check a model file, print its card and measure its speed on this machine."""
    import statistics
    import time

    from neo_ros.speed.model import count_flops
    from neo_ros.runtime.fov_extrapolator import FovExtrapolator, memory_path
    import numpy as np
    import rich
    from rich.markup import escape
    from rich.table import Table

    extrapolator = FovExtrapolator.load(model, threads, guided=False)
    source = extrapolator.expansion.source
    image = np.random.default_rng(0).integers(0, 256, (source.height, source.width, 3), np.uint8)
    milliseconds = []
    for _ in range(TIMED_RUNS):
        started = time.perf_counter()
        extrapolator.expand(image)
        milliseconds.append(1e3 * (time.perf_counter() - started))
    table = Table('model', escape(str(model)))
    for name, value in _card_rows(extrapolator.card):
        table.add_row(name, escape(value))
    gflop = extrapolator.card.gflop or (count_flops(model) or 0) / 1e9
    table.add_row('arithmetic', f'{gflop:.2f} GFLOP per image' if gflop else
                  'not known: the card does not say, and counting needs the package onnx')
    table.add_row('file size', f'{model.stat().st_size / 1e6:.2f} MB')
    if extrapolator.card.memory is not None:
        from neo_ros.memory.scene_memory import SceneMemory

        path = memory_path(model, extrapolator.card.memory)
        memory = SceneMemory.read(path, extrapolator.card.memory.sha256)
        landmarks = 0 if memory.landmarks is None else len(memory.landmarks.points)
        table.add_row('scene memory', f'{escape(path.name)}: {len(memory.positions)} keyframes, '
                      f'{landmarks} landmarks, {path.stat().st_size / 1e6:.2f} MB')
    table.add_row('time per image', f'{statistics.median(milliseconds):.2f} ms '
                  f'(network alone, median of {TIMED_RUNS}, CPU, {threads or "all"} threads)')
    rich.print(table)


def _card_rows(card: 'ModelCard') -> list[tuple[str, str]]:
    """Put a card into words."""
    import math

    expansion = card.expansion
    rows = [('scene', card.scene_id), ('network', card.network)]
    for name, camera in (('camera view', expansion.source), ('wide view', expansion.target)):
        rows.append((name, f'{camera.width}x{camera.height} pixels, '
                     f'{math.degrees(camera.hfov):.2f} x {math.degrees(camera.vfov):.2f} deg, '
                     f'fx {camera.fx:.2f} fy {camera.fy:.2f}'))
    rows.append(('growth', f'left {expansion.left}, right {expansion.right}, '
                 f'top {expansion.top}, bottom {expansion.bottom} pixels'))
    for tensor in (card.input, card.outputs.wide, card.outputs.confidence):
        rows.append((f'tensor {tensor.name}', ' '.join(
            str(value) for name, value in asdict(tensor).items() if name != 'name')))
    rows += [('mask', card.mask_polarity), ('config', card.config_hash)]
    rows += [(f'score {name}', f'{value:.3f}') for name, value in card.scores.items()]
    rows += [('updated', f'{update.at} UTC with {update.bag} ({update.photos} photos)')
             for update in card.updates]
    rows += [
        ('export parity', f'at most {card.parity.max_abs_error}/255 from torch, '
         f'{100 * card.parity.share_within_1:.2f} % of the pixels within 1/255'),
        ('trained for', f'{card.trained_seconds / 60:.1f} min'),
        ('made with', f'neo_ros {card.neo_ros_version}, card schema {card.schema_version}')]
    return rows
