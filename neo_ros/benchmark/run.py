"""From jobs to files: rows, tables in Markdown, the page; what `neo benchmark` does."""
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Literal

from neo_ros.benchmark.page import write_benchmark_report
from neo_ros.benchmark.protocols import check_own_split, check_split
from neo_ros.benchmark.scoring import run_benchmark, write_rows
from neo_ros.benchmark.suites import config_folder, SPLITS_FILE
from neo_ros.benchmark.tables import markdown
from neo_ros.benchmark.workbench import Job, Workbench
from neo_ros.errors import ConfigError
from neo_ros.evaluation.evaluate import MethodScores
from neo_ros.machine.files import make_output_folder, write_bytes
from neo_ros.machine.progress import StageProgress

# With which split a scene is compared before any work.
Frozen = Literal['no', 'named', 'noted']


def run_jobs(jobs: dict[str, Job], names: Sequence[str], work: Path, rows_file: Path, title: str,
             progress: StageProgress, frozen: Frozen = 'no') -> str:
    """
    Benchmark scenes one after the other; returns the tables.

    jobs by scene name; `frozen` compares every scene before any work with a frozen split: that of
    its name that is shipped ('named'), or that which its folder notes ('noted'); 'no': with none.
    Leaves the rows in `rows_file`, written again after every method, TITLE.md and TITLE.html in
    `work`.
    """
    make_output_folder(work)
    make_output_folder(rows_file.parent)
    benches = []
    for name, job in jobs.items():
        folder = work / f'{name}_{job.protocol}_{job.scale}'
        benches.append(Workbench(job, folder, _staged(name, progress)))
        if 'guided' in names and benches[-1].base.memory is None:
            raise ConfigError(f'{name}: guided needs a scene memory, got the setting memory: '
                              'null; leave guided out of --methods, or that setting away')
        if frozen == 'named':
            check_split(name, benches[-1].checksums, config_folder() / SPLITS_FILE)
        elif frozen == 'noted':
            check_own_split(Path(job.scene), benches[-1].checksums,
                            config_folder() / SPLITS_FILE)
    benchmarks: list[list[MethodScores]] = []
    for bench in benches:
        benchmarks.append(run_benchmark(
            bench, names,
            # What is through is in the file, also if the next method never ends.
            lambda results: write_rows(rows_file, [
                result.row for scene in (*benchmarks, results) for result in scene])))
    write_rows(rows_file, [result.row for results in benchmarks for result in results])
    table = markdown(benchmarks)
    write_bytes(work / f'{title}.md', table.encode())
    write_benchmark_report(work / f'{title}.html', benches, benchmarks)
    return table


def installed(names: Sequence[str], progress: StageProgress) -> list[str]:
    """Leave out the methods whose packages are not installed, and tell `progress`."""
    found = []
    for name in names:
        if name.startswith('relocalized') and find_spec('pycolmap') is None:
            progress(f'without {name}', 0, 1, 'pycolmap is not installed')
        else:
            found.append(name)
    return found


def _staged(name: str, progress: StageProgress) -> StageProgress:
    return lambda stage, done, total, note='': progress(f'{name}: {stage}', done, total, note)
