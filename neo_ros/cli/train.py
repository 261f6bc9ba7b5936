"""`neo train`: from a scene folder to a model file."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def train(
    scene: Annotated[Path, typer.Argument(
        help='Scene folder with transforms_train.json, made by neo import.')],
    out: Annotated[Path, typer.Option(
        help='Folder for the model, the report and what a later run resumes from.')],
    config: Annotated[Optional[Path], typer.Option(
        help='Experiment file (YAML), see config/experiments; default: the default settings.',
    )] = None,
    minutes: Annotated[Optional[float], typer.Option(
        help='Be done in so many minutes, for any camera: shares them among field, memory and '
        'network, by the speed of this machine. 30 is a good start.', min=0)] = None,
    cache_gb: Annotated[float, typer.Option(
        help='Keep up to so many GB of panoramas in files of OUT instead of in memory; a training '
        'that was broken off reads them back. Several processes keep so many each.', min=0,
    )] = 0.0,
    field_of: Annotated[Optional[Path], typer.Option(
        help='Output folder of another run of the same photos, with the same settings of field, '
        'scale and seed: its field is taken instead of fitting one anew; without --minutes.'
        )] = None,
    geometry: Annotated[Optional[Path], typer.Option(
        help='A mesh with colours (.ply, .obj, .glb) or splats (.ply) of the scene, in the world '
        'of the photos: it is taken instead of fitting a field.')] = None,
    geometry_axes: Annotated[Optional[str], typer.Option(
        help='What x, y and z of the world of the photos are in axes and unit of --geometry, '
        'such as 0.01x,-0.01z,0.01y; default: x,y,z.')] = None,
    cluster: Annotated[bool, typer.Option(
        '--cluster',
        help='Fit the tiles of a large floor and make keyframes side by side on Ray: on the '
        'cores of this machine, or with RAY_ADDRESS on a cluster, all of whose machines need the '
        'same paths.',
    )] = False,
) -> None:
    """
    Fit the scene, render wide views of it, train the outpainter, make the memory, export.

    With --minutes 30 it is done in half an hour, whatever the camera. Leaves SCENE.onnx,
    SCENE.memory and report.html in OUT. Broken off? Run the same command again: it goes on
    after the last part that was done.
    """
    from neo_ros.cli.options import refuse
    from neo_ros.cli.progress import stage_progress
    from neo_ros.experiment import Experiment, read_experiment
    from neo_ros.field.given_geometry import GivenGeometry
    from neo_ros.pipeline import train as run_pipeline
    import rich
    from rich.markup import escape

    if geometry is not None:
        refuse('--geometry takes the place of a field', field_of=field_of)
    else:
        refuse('expected only with --geometry', geometry_axes=geometry_axes)
    if minutes is not None:
        refuse('--minutes plans a field of its own', field_of=field_of)
    experiment = read_experiment(config) if config is not None else Experiment()
    with stage_progress() as show:
        run = run_pipeline(scene, experiment, out, show, cache_gb, field_of, minutes,
                           None if geometry is None else GivenGeometry(
                               geometry, geometry_axes or 'x,y,z'), cluster)
    for name, value in run.figures.items():
        rich.print(f'{name}: {value:.2f} dB')
    files = [run.model_path, run.model_path.with_suffix('.memory')]
    names = ', '.join(escape(str(file)) for file in files if file.exists())
    rich.print(f'Written: {names} and report.html')
