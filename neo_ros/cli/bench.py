"""`neo bench`: how fast every part is on this machine."""
from pathlib import Path
from typing import Annotated, Any, Optional

import typer


def bench(
    out: Annotated[Path, typer.Option(help='JSON file of the results.')] = Path(
        'results/bench.json'),
    only: Annotated[Optional[list[str]], typer.Option(
        help='expand, messages, guided, replay, field, gpu, networks or node; may be repeated. '
        'Default: all.')] = None,
    model: Annotated[Optional[Path], typer.Option(
        help='Model file (.onnx); default: the shipped demo_flat.onnx.')] = None,
    quick: Annotated[bool, typer.Option(
        '--quick', help='Only see that it runs: too short for figures to be quoted.')] = False,
) -> None:
    """
    Measure how fast every part is, beside what the machine can do at its best.

    Latencies of the model, messages, guidance, replay, radiance field (also on a GPU), networks
    and the node on a real ROS graph; run it on a machine that has nothing else to do.
    """
    from neo_ros.cli.progress import stage_progress
    from neo_ros.machine.files import make_output_folder, share_dir
    from neo_ros.speed.benchmarks import run_benchmarks, write_benchmarks
    import rich
    from rich.markup import escape

    make_output_folder(out.parent)
    with stage_progress() as show:
        results = run_benchmarks(
            model or share_dir() / 'models' / 'demo_flat.onnx', only or (), quick,
            lambda name, done, total: show('benchmarks', done, total, name))
    write_benchmarks(out, results)
    _print_table(results)
    rich.print(f'Written: {escape(str(out))}')


def _print_table(results: dict[str, Any]) -> None:
    """Show the figures, a line each."""
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console, host = Console(), results['host']
    best = ', '.join(f'{max(host[key].values()):.0f} {unit}' for key, unit in (
        ('matmul_gflops', 'GFLOP/s'), ('memory_gb_s', 'GB/s in memory'),
        ('cache_gb_s', 'GB/s in the cache')))
    console.print(f'{host["cpu"]}, load {host["load_average_1min"]:.1f}; at its best {best}')
    if host['busy']:
        console.print('[yellow]The machine is busy: these figures should not be quoted.[/yellow]')
    table = Table('measured', 'note')
    for column in ('median ms', 'p95', 'p99', 'max', 'per s', 'floor ms', 'x floor'):
        table.add_column(column, justify='right')
    for record in results['records']:
        figures = (record[key] for key in (
            'median_ms', 'p95_ms', 'p99_ms', 'max_ms', 'rate_hz', 'floor_ms',
            'measured_over_floor'))
        table.add_row(escape(f'{record["benchmark"]}: {record["name"]}'), escape(_note(record)),
                      *('' if figure is None else f'{figure:.3g}' for figure in figures))
    console.print(table)


def _note(record: dict[str, Any]) -> str:
    details = record['details']
    if record['skipped']:
        return record['skipped']
    if 'missed' in details:
        return (f'missed {details["missed"]} of {details["sent"]}, jitter '
                f'{details["jitter_ms"]:.1f} ms, CPU {details["cpu_percent"]:.0f} %, '
                f'{details["rss_mb"]:.0f} MB, outside inference '
                f'{details["outside_inference_ms"]:.1f} ms')
    if 'views_per_s' in details:
        share = details.get('share_of_stream')
        return f'{details["views_per_s"]:.0f} views/s' + (
            '' if share is None else f', {share:.0%} of the training')
    for key, words in (('share_of_model_rate', '{:.0%} of the rate of the model alone'),
                       ('views_per_s_with_panorama', '{:.0f} views/s with their panorama'),
                       ('rays_per_s', '{:.2g} rays/s')):
        if key in details:
            return words.format(details[key])
    return ''
