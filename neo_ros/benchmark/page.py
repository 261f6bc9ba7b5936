"""The page of a benchmark: tables, quality over cost, strips of the best and worst frames."""
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from neo_ros.benchmark.methods import METHODS
from neo_ros.benchmark.scoring import frame_picture
from neo_ros.benchmark.tables import best_practical, NOTE, pose_remark
from neo_ros.benchmark.workbench import Workbench
from neo_ros.evaluation.evaluate import MethodScores
from neo_ros.evaluation.evaluation_report import picture_strips
from neo_ros.reports.report import Plot, Section, Series, Table, Text, write_report

_COLUMNS = (('ring_psnr', 'ring PSNR, dB', 2, 1), ('ring_ssim', 'ring SSIM', 3, 1),
            ('ring_lpips_vgg', 'ring LPIPS', 3, 1), ('whole_psnr', 'whole PSNR, dB', 2, 1),
            ('oracle_gap_closed', 'gap closed, %', 0, 100),
            ('warping_error', 'warping error, 10^-3', 2, 1e3),
            ('latency_ms_median', 'ms', 1, 1), ('train_minutes', 'training, min', 1, 1),
            ('model_mb', 'MB', 1, 1))


def write_benchmark_report(path: Path, benches: Sequence[Workbench],
                           benchmarks: Sequence[Sequence[MethodScores]]) -> None:
    """Write one self-contained page about some scenes and their methods' scores."""
    sections: list[Section] = [Text(NOTE.replace('*', ''))]
    for bench, results in zip(benches, benchmarks):
        sections += _scene_sections(bench, results)
    names = ', '.join(bench.scene.name for bench in benches)
    write_report(path, f'Benchmark: {names}', sections)


def _scene_sections(bench: Workbench, results: Sequence[MethodScores]) -> list[Section]:
    row, expansion = results[0].row, bench.expansion
    source, target = expansion.source, expansion.target
    heading = (f'{row["n_frames"]} test frames, {source.width}x{source.height} widened to '
               f'{target.width}x{target.height} pixels, {row["scale"]} scale of the '
               f'{row["protocol"]} protocol. Latencies on {row["host"]}.')
    best = best_practical(results)
    strong = next((i for i, result in enumerate(results) if result.method == best), None)
    sections: list[Section] = [
        Text(heading, bench.scene.name),
        Table(['method', *(title for _, title, _, _ in _COLUMNS), 'pasted'], [
            [result.method, *(_cell(result, *column) for column in _COLUMNS),
             'yes' if result.observed_pasted else 'no'] for result in results],
            note='The best of the methods that a robot could run is marked.',
            strong_row=strong)]
    sections += _cost_plots(results)
    for result in results:
        words = METHODS[result.method].words
        remark = words[0].upper() + words[1:] + '.'
        if any('pose_error_cm' in frame for frame in result.frames):
            remark += ' ' + pose_remark(result)
        sections.append(Text(remark, f'{bench.scene.name}: {result.method}'))
        sections += picture_strips(bench.frames, result, partial(
            frame_picture, bench, result.method))
    return sections


def _cost_plots(results: Sequence[MethodScores]) -> list[Plot]:
    """Plot ring PSNR over what it costs; methods that cost nothing are left out."""
    plots = []
    for key, words in (('latency_ms_median', 'milliseconds a frame'),
                       ('train_minutes', 'minutes of training'), ('model_mb', 'model, MB')):
        series = [Series(result.method, [result.row[key]], [result.row['ring_psnr']])
                  for result in results if result.row[key] is not None]
        if series:
            plots.append(Plot(f'Ring PSNR over {words}', words, 'ring PSNR, dB', series,
                              'points'))
    return plots


def _cell(result: MethodScores, key: str, title: str, digits: int, factor: float) -> str:
    value = result.row[key]
    if value is None:
        return ''
    text = f'{value * factor:.{digits}f}'
    estimate = result.estimates.get(key)
    if estimate is not None and estimate.low is not None and estimate.high is not None:
        text += (f'\n{estimate.low * factor:.{digits}f} to {estimate.high * factor:.{digits}f}')
    return text
