"""From the scores of an evaluation to its files: scores.json and report.html."""
from collections.abc import Callable, Sequence
import json
from pathlib import Path

from neo_ros.evaluation.calibration import judge_confidence
from neo_ros.evaluation.evaluate import MethodScores, TruthFrames
from neo_ros.evaluation.metrics import Estimate
from neo_ros.machine.files import write_bytes
from neo_ros.reports.kept_pictures import pick_frames
from neo_ros.reports.report import Plot, Section, Series, Strip, Table, Text, write_report
from neo_ros.reports.strips import frame_strip
import numpy as np

_COLUMNS = {'ring_psnr': ('Ring PSNR, dB', 2), 'ring_ssim': ('Ring SSIM', 3),
            'seam_psnr': ('Seam PSNR, dB', 2), 'whole_psnr': ('Whole PSNR, dB', 2),
            'whole_ssim': ('Whole SSIM', 3)}


def write_evaluation(out: Path, scene_name: str, frames: TruthFrames,
                     results: Sequence[MethodScores], model: Path) -> dict[str, dict[str, float]]:
    """
    Write scores.json and report.html into the folder `out`; returns how true the confidence is.

    scores.json holds `rows` (one per method, keys ROW_KEYS), `methods` (estimates with
    intervals, and every frame) and the figures of the model file's confidence, see
    `judge_confidence`. Raises NeoError when a file cannot be written.
    """
    confidence, judged = judge_confidence(model, frames)
    scores = {**confidence, 'rows': [result.row for result in results],
              'methods': [result.to_dict() for result in results]}
    write_bytes(out / 'scores.json', json.dumps(scores, indent=1, allow_nan=False).encode())
    write_report(out / 'report.html', f'How well {scene_name} is widened',
                 [*evaluation_sections(scene_name, frames, results), *judged])
    return confidence


def evaluation_sections(scene_name: str, frames: TruthFrames,
                        results: Sequence[MethodScores]) -> list[Section]:
    """
    Describe an evaluation: what was scored, the table, ring PSNR by frame, and strips.

    results: as of `evaluate`, with their pictures.
    """
    expansion = frames.expansion
    source, target = expansion.source, expansion.target
    share = expansion.extrapolated_mask.mean()
    n_paths = len(set(frames.images.path_ids))
    intro = (f'{len(frames)} test frames on {n_paths} path{"s" * (n_paths > 1)} of '
             f'{scene_name}: {source.width}x{source.height} widened to '
             f'{target.width}x{target.height} pixels. The ring is what the camera did not see, '
             f'{share:.0%} of the wide image; the whole score also counts the observed centre.')
    sections: list[Section] = [Text(intro), scores_table(results), _psnr_plot(results)]
    for result in results:
        sections.append(Text('Best, median and worst frame by ring PSNR.', result.method))
        sections += picture_strips(frames, result, result.pictures.__getitem__)
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
    n_paths = len({frame['path_id'] for frame in results[0].frames})
    if n_paths == 1:
        note += ' One path alone gives no interval.'
    elif n_paths <= 3:
        note += f' Of {n_paths} paths it is the range over the paths, not 95 %.'
    columns = ['Method', *(_COLUMNS[name][0] for name in names), 'ms', 'Pasted']
    return Table(columns, rows, 'Scores', note, strong_row=best)


def picture_strips(frames: TruthFrames, result: MethodScores,
                   picture_of: Callable[[int], np.ndarray]) -> list[Strip]:
    """Show the best, the median and the worst frame; `picture_of` gives the image scored."""
    strips = []
    for name, index in pick_frames(result.frames).items():
        narrow_image, truth = frames.read(index)
        scores = result.frames[index]
        strips.append(frame_strip(
            f'{name.capitalize()}: {scores["frame"]}', frames.expansion, narrow_image,
            picture_of(index), truth,
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
