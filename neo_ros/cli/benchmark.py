"""`neo benchmark`: the paper's tables on any scene, rivals and bounds included."""
from pathlib import Path
from typing import Annotated, Any, Optional

import typer


def benchmark(
    suite: Annotated[Optional[str], typer.Option(
        help='Run a whole suite of config/benchmark: quarter or full; or real or unseen, which '
        'take every scene folder in --scenes.')] = None,
    scene: Annotated[Optional[Path], typer.Option(
        help='Benchmark one scene folder, with wide truth in transforms_test.json.')] = None,
    test_scene: Annotated[Optional[Path], typer.Option(
        help='Scene folder whose photos are the wide truth, where SCENE has no test frames.',
    )] = None,
    protocol: Annotated[Optional[str], typer.Option(
        help='square: photos are the view, grown to twice their size. horizontal: the middle '
        'half of the columns, grown to the photo. Default: square.')] = None,
    scale: Annotated[Optional[str], typer.Option(
        help='full, half, quarter or eighth of the resolution of the photos. Default: '
        'quarter.')] = None,
    config: Annotated[Optional[Path], typer.Option(
        help='Experiment file (YAML) with the settings for SCENE. Its view, scale, steps and '
        "minutes, and the network's name, patch and depth, are not read: they follow from "
        'protocol, scale, methods and budget.')] = None,
    methods: Annotated[Optional[str], typer.Option(
        help='Names, separated by commas. Default: all of the suite, or of quarter.')] = None,
    budget_minutes: Annotated[Optional[float], typer.Option(
        help='Training time of field and network; naive may take what the network takes. '
        'Default: 18.', min=0.01)] = None,
    frames: Annotated[Optional[int], typer.Option(
        min=1, help='Score only so many test frames, spread evenly; default: all.')] = None,
    scenes: Annotated[Optional[list[Path]], typer.Option(
        help='Folder that holds the scene folders of a suite, for real and unseen also a scene '
        'folder; may be given several times.',
    )] = None,
    out: Annotated[Optional[Path], typer.Option(
        help='File for the rows; default: results/NAME.json, where NAME is the suite or the '
        'scene; of a suite that was run in part, WORK/NAME.json.')] = None,
    work: Annotated[Path, typer.Option(
        help='Folder for fields, models, scores and the report.')] = Path('out/benchmark'),
    bundle: Annotated[Optional[Path], typer.Option(
        help='Also leave rows, tables, page and models in this folder, as one archive in files '
        'below 16 MB, also of a run that was broken off: for a borrowed machine.')] = None,
) -> None:
    """
    Score NEO beside its rivals (naive, warping, relocalised) and the bounds on the test frames.

    Writes the rows to OUT, NAME.md (tables) and NAME.html to WORK. Broken off? The same command
    goes on with the method it was at.
    """
    from contextlib import nullcontext

    from neo_ros.benchmark.bundle import bundled
    from neo_ros.benchmark.methods import check_methods
    from neo_ros.benchmark.run import installed, run_jobs
    from neo_ros.benchmark.suites import prepare_demo, read_suite, suite_jobs
    from neo_ros.benchmark.workbench import Job
    from neo_ros.cli.options import refuse
    from neo_ros.cli.progress import stage_progress
    from neo_ros.errors import ConfigError
    from neo_ros.machine.files import make_output_folder
    import rich
    from rich.markup import escape

    if (suite is None) == (scene is None):
        raise ConfigError('benchmark: expected either --suite NAME or --scene FOLDER')
    if scene is None:
        refuse('expected only with --scene', test_scene=test_scene, protocol=protocol, scale=scale,
               config=config, budget_minutes=budget_minutes, frames=frames)
    else:
        refuse('expected only with --suite', scenes=scenes or None)
    plan = read_suite(suite or 'quarter')
    settings = _read_settings(config) if config else None
    names = check_methods(methods.split(',') if methods else plan.methods)
    with stage_progress() as show:
        names = installed(names, show)
        whole = scene is None and set(plan.methods) <= set(names)
        if scene is None:
            jobs = suite_jobs(plan, scenes or [])
            prepare_demo(plan, jobs, show)
            name = str(suite)
        else:
            name = scene.resolve().name
            jobs = {name: Job(
                str(scene), protocol or 'square', scale or 'quarter', budget_minutes or 18.0,
                str(test_scene) if test_scene else None, frames, settings)}
        # What is kept of a suite is replaced by a whole one alone, and when it is through.
        kept = Path('results') / f'{name}.json'
        rows_file = out or (kept if scene else work / f'{name}.json')
        if whole and out is None:
            make_output_folder(kept.parent)
        with bundled(bundle, rows_file, work) if bundle else nullcontext():
            table = run_jobs(jobs, names, work, rows_file, name, show, frozen=(
                'no' if scene else 'noted' if plan.every else 'named'))
    print(table)  # As it is: rich would break its lines.
    if whole and out is None:
        _keep(table, rows_file, kept)
        rows_file = kept
    elif scene is None and not whole:
        missing = ', '.join(method for method in plan.methods if method not in names)
        rich.print(f'Not run: {escape(missing)}. What is kept of the whole suite '
                   f'({escape(str(kept))} and .md) stays as it was.')
    rich.print(f'Written: {escape(str(rows_file))}, '
               f'{escape(str(work / name))}.md and {escape(str(work / name))}.html')


def _read_settings(config: Path) -> dict[str, Any]:
    """Read an experiment but its view, whose tuples would come back from JSON as lists."""
    from dataclasses import asdict, replace

    from neo_ros.experiment import read_experiment

    return asdict(replace(read_experiment(config), view=None))


def _keep(table: str, rows_file: Path, kept: Path) -> None:
    """Replace what is kept of a suite by a whole run of it."""
    from neo_ros.machine.files import write_bytes

    write_bytes(kept.with_suffix('.md'), table.encode())
    write_bytes(kept, rows_file.read_bytes())
