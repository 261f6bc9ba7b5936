"""From the scores of an evaluation to its files: scores.json and report.html."""
import json
from pathlib import Path
from typing import Any, Sequence

from neo_ros.evaluation.baselines import Method
from neo_ros.evaluation.evaluate import MethodScores, TruthFrames
from neo_ros.evaluation.metrics import Estimate
from neo_ros.evaluation.output import write_bytes
from neo_ros.evaluation.report import (
    Plot, Section, Series, Strip, Table, Text, write_report)
from neo_ros.evaluation.strips import frame_strip

_COLUMNS = {'ring_psnr': ('Ring PSNR, dB', 2), 'ring_ssim': ('Ring SSIM', 3),
            'seam_psnr': ('Seam PSNR, dB', 2), 'whole_psnr': ('Whole PSNR, dB', 2),
            'whole_ssim': ('Whole SSIM', 3)}


def write_evaluation(out: Path, scene_name: str, frames: TruthFrames,
                     methods: Sequence[Method], results: Sequence[MethodScores]) -> None:
    """
    Write scores.json and report.html into the folder `out`.

    scores.json holds `rows` (one per method, keys ROW_KEYS) and `methods` (estimates with
    intervals, and every frame). Raises NeoError when a file cannot be written.
    """
    scores = {'rows': [result.row for result in results],
              'methods': [result.to_dict() for result in results]}
    write_bytes(out / 'scores.json', json.dumps(scores, indent=1, allow_nan=False).encode())
    write_report(out / 'report.html', f'How well {scene_name} is widened',
                 evaluation_sections(scene_name, frames, methods, results))


def evaluation_sections(scene_name: str, frames: TruthFrames, methods: Sequence[Method],
                        results: Sequence[MethodScores]) -> list[Section]:
    """Describe an evaluation: what was scored, the table, ring PSNR by frame, and strips."""
    expansion = frames.expansion
    source, target = expansion.source, expansion.target
    share = expansion.extrapolated_mask.mean()
    n_paths = len(set(frames.images.path_ids))
    intro = (f'{len(frames)} test frames on {n_paths} path{"s" * (n_paths > 1)} of '
             f'{scene_name}: {source.width}x{source.height} widened to '
             f'{target.width}x{target.height} pixels. The ring is what the camera did not see, '
             f'{share:.0%} of the wide image; the whole score also counts the observed centre.')
    sections: list[Section] = [Text(intro), scores_table(results), _psnr_plot(results)]
    for method, result in zip(methods, results):
        sections.append(Text('Best, median and worst frame by ring PSNR.', method.name))
        sections += _strips(frames, method, result)
    return sections


def scores_table(results: Sequence[MethodScores]) -> Table:
    """Tabulate mean and 95 % interval of the scores; the best ring PSNR is marked."""
    names = [name for name in _COLUMNS if all(name in r.estimates for r in results)]
    rows = [[result.method,
             *(_cell(result.estimates[name], _COLUMNS[name][1]) for name in names),
             f'{result.row["latency_ms_median"]:.1f}',
             'yes' if result.observed_pasted else 'no'] for result in results]
    best = max(range(len(results)), key=lambda i: results[i].estimates['ring_psnr'].mean)
    note = ('Mean over the frames; below it the bootstrap 95 % interval over the paths. '
            'Milliseconds are the median per frame on ' + results[0].row['host'] + '. '
            'Pasted: the observed centre is in the wide image as the camera gave it.')
    if any(result.estimates['ring_psnr'].low is None for result in results):
        note += ' One path alone gives no interval.'
    columns = ['Method', *(_COLUMNS[name][0] for name in names), 'ms', 'Pasted']
    return Table(columns, rows, 'Scores', note, strong_row=best)


def pick_frames(frames: Sequence[dict[str, Any]], score: str = 'ring_psnr') -> dict[str, int]:
    """Return the indices of the best, the median and the worst frame by a score."""
    order = sorted(range(len(frames)), key=lambda i: frames[i][score])
    return {'best': order[-1], 'median': order[len(order) // 2], 'worst': order[0]}


def _strips(frames: TruthFrames, method: Method, result: MethodScores) -> list[Strip]:
    strips = []
    for name, index in pick_frames(result.frames).items():
        narrow_image, truth = frames.read(index)
        scores = result.frames[index]
        strips.append(frame_strip(
            f'{name.capitalize()}: {scores["frame"]}', frames.expansion, narrow_image,
            method.expand(narrow_image), truth,
            f'ring {scores["ring_psnr"]:.2f} dB, SSIM {scores["ring_ssim"]:.3f}'))
    return strips


def _psnr_plot(results: Sequence[MethodScores]) -> Plot:
    series = [Series(result.method, list(range(len(result.frames))),
                     [frame['ring_psnr'] for frame in result.frames]) for result in results]
    return Plot('Ring PSNR along the walks', 'test frame', 'ring PSNR, dB', series)


def _cell(estimate: Estimate, digits: int) -> str:
    mean = f'{estimate.mean:.{digits}f}'
    if estimate.low is None:
        return mean
    return f'{mean}\n{estimate.low:.{digits}f} to {estimate.high:.{digits}f}'
