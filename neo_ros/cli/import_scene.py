"""`neo import`: bring photos with poses into a scene folder."""
from pathlib import Path
from typing import Annotated

import typer


def import_scene(
    source: Annotated[str, typer.Argument(
        help='Folder with transforms_train.json or transforms.json (nerfstudio, instant-ngp), '
             'or the word "demo" for the built-in flat.')],
    scene: Annotated[Path, typer.Argument(help='Scene folder to write.')],
    size: Annotated[int, typer.Option(
        help='Demo only: edge of the training photos in pixels.', min=16)] = 128,
    photos: Annotated[int, typer.Option(help='Demo only: number of photos.', min=1)] = 1000,
) -> None:
    """
    Copy photos with poses into a scene folder and check them.

    Every image is read, every pose is checked; images that are listed but missing are named
    and left out.
    """
    from neo_ros.scenes.demo_captures import write_demo_scene
    from neo_ros.scenes.importing import import_transforms
    import rich
    from rich.markup import escape
    from rich.progress import (
        BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn)

    with Progress(TextColumn('{task.description}'), BarColumn(), MofNCompleteColumn(),
                  TimeRemainingColumn()) as bar:
        task = bar.add_task('images', total=None)

        def show(done: int, total: int) -> None:
            bar.update(task, completed=done, total=total)

        if source == 'demo':
            write_demo_scene(scene, image_size=size, n_train=photos, progress=show)
        else:
            import_transforms(Path(source), scene, show)
    from neo_ros.scenes.scene import read_scene
    found = read_scene(scene)
    camera = found.train.intrinsics
    tests = 'no test frames' if found.test is None else f'{len(found.test)} test frames'
    rich.print(f'{escape(str(scene))}: {len(found.train)} photos of '
               f'{camera.width}x{camera.height} pixels, {tests}')
    rich.print(f'Next: neo train {escape(str(scene))} --out out/{escape(found.name)}')
