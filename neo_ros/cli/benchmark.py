"""`neo benchmark`: the paper's tables on any scene, rivals and bounds included."""
from pathlib import Path
from typing import Annotated, Optional

import typer


def benchmark(
    suite: Annotated[Optional[str], typer.Option(
        help='Run a whole suite of config/benchmark, for instance quarter.')] = None,
    scene: Annotated[Optional[Path], typer.Option(
        help='Benchmark one scene folder, with wide truth in transforms_test.json.')] = None,
    test_scene: Annotated[Optional[Path], typer.Option(
        help='Scene folder whose photos are the wide truth, where SCENE has no test frames.',
    )] = None,
    protocol: Annotated[str, typer.Option(
        help='square: photos are the view, grown to twice their size. horizontal: the middle '
        'half of the columns, grown to the photo.')] = 'square',
    scale: Annotated[str, typer.Option(
        help='full, half or quarter of the resolution of the photos.')] = 'quarter',
    methods: Annotated[Optional[str], typer.Option(
        help='Names, separated by commas. Default: all of the suite quarter.')] = None,
    budget_minutes: Annotated[float, typer.Option(
        help='Training time of field and network; naive may take what the network takes.',
        min=0.01)] = 18.0,
    frames: Annotated[Optional[int], typer.Option(
        min=1, help='Score only so many test frames, spread evenly; default: all.')] = None,
    scenes: Annotated[Optional[list[Path]], typer.Option(
        help='Folder that holds the scene folders of a suite; may be given several times.',
    )] = None,
    out: Annotated[Optional[Path], typer.Option(
        help='File for the rows; default: results/<suite>.json or results/<scene>.json.')] = None,
    work: Annotated[Path, typer.Option(
        help='Folder for fields, models, scores and the report.')] = Path('out/benchmark'),
    bundle: Annotated[Optional[Path], typer.Option(
        help='Also leave rows, tables, page and models in this folder, as one archive in files '
        'below 16 MB, also of a run that was broken off: for a borrowed machine.')] = None,
) -> None:
    """
    Score NEO beside its rivals (naive, warping, relocalised) and the bounds on the test frames.

    Writes the rows to OUT, tables (.md) and report.html to WORK. Broken off? The same command
    goes on with the method it was at.
    """
    from neo_ros.cli.progress import stage_progress
    from neo_ros.errors import ConfigError
    from neo_ros.benchmark.bundle import write_bundle
    from neo_ros.benchmark.methods import check_methods
    from neo_ros.benchmark.run import run_jobs
    from neo_ros.benchmark.suites import prepare_demo, read_suite, suite_jobs
    from neo_ros.benchmark.workbench import Job
    import rich
    from rich.markup import escape

    if (suite is None) == (scene is None):
        raise ConfigError('benchmark: expected either --suite NAME or --scene FOLDER')
    plan = read_suite(suite or 'quarter')
    names = check_methods(methods.split(',') if methods else plan.methods)
    with stage_progress() as show:
        if scene is None:
            jobs = suite_jobs(plan, scenes or [])
            if 'demo_flat' in jobs:
                prepare_demo(jobs['demo_flat'], show)
            name = str(suite)
        else:
            name = scene.resolve().name
            jobs = {name: Job(str(scene), protocol, scale, budget_minutes,
                              str(test_scene) if test_scene else None, frames)}
        rows_file = out or Path('results') / f'{name}.json'
        try:
            table = run_jobs(jobs, names, work, rows_file, name, frozen=suite is not None,
                             progress=show)
        finally:
            if bundle is not None:
                write_bundle(bundle, rows_file, work)
    rich.print(escape(table))
    rich.print(f'Written: {escape(str(rows_file))}, '
               f'{escape(str(work / name))}.md and {escape(str(work / name))}.html')
