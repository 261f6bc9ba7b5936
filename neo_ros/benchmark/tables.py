"""The tables of a benchmark in Markdown, with the paper's figures beside ours."""
from collections.abc import Iterable, Sequence
from typing import Any

from neo_ros.benchmark.methods import METHODS
from neo_ros.benchmark.paper_figures import PAPER, PAPER_SCENES
from neo_ros.evaluation.evaluate import MethodScores
from neo_ros.evaluation.metrics import Estimate, summarise

# A table for each part of the wide image, with these columns.
_PARTS = ('ring', 'seam', 'whole')
_MEASURES = {'psnr': 'PSNR, dB', 'ssim': 'SSIM', 'lpips_vgg': 'LPIPS VGG',
             'lpips_alex': 'LPIPS Alex'}
NOTE = """\
Means over the test frames; in brackets bootstrap 95 % intervals over the walks. Of two or three
walks (RedKitchen has three) they are the range over the walks, not 95 %. In means over scenes they
are taken over the scenes. *Ring*: pixels that the
camera did not see; *seam*: the part of the ring within 1/16 of the camera's width.
Pasted: the observed centre is in the wide image as the camera gave it, which lifts the whole
scores; its difference to the truth is 0. Bold: the best PSNR of the table among the methods that
a robot could run. SSIM (its window is 11 pixels wide) and LPIPS look
across the border, so those of ring and seam gain by it, too. *Gap closed*: (ring PSNR - B1's)
/ (oracle's - B1's); by LPIPS: the same of the ring's LPIPS VGG. *Warping error*: mean squared
difference (colours 0 to 1) between the ring and the last wide image brought there by the true
motion. *Flicker*: standard deviation (grey levels) of the ring while the camera stands still
with sensor noise of 2 grey levels. *Training*: the field and the network, for `guided` also
the scene memory; for `naive` the network alone; for `warping` the photos' features alone; for
`relocalized` the field, the features and their triangulation, for `relocalized_neo` also the
network; for `oracle` the field alone. *MB*: the model file, for `guided` also the memory file;
for `warping` the photos and their features; for `relocalized` the field, the features and the
triangulated points, for `relocalized_neo` also the model file; for `oracle` the field.
*Memory*: what a process grows by when it loads and runs the method."""


def markdown(benchmarks: Sequence[Sequence[MethodScores]]) -> str:
    """Return the tables of some scenes, each a list of its methods' scores."""
    parts = [NOTE]
    for results in benchmarks:
        row = results[0].row
        parts += [f'### {row["scene"]}, {row["protocol"]}, {row["scale"]} scale, '
                  f'{row["n_frames"]} frames',
                  *(_score_table(results, part) for part in _PARTS), _cost_table(results),
                  *_remarks(results)]
    if len(benchmarks) > 1:
        parts += [f'### Mean over {len(benchmarks)} scenes', _mean_table(benchmarks)]
    protocols = dict.fromkeys(results[0].row['protocol'] for results in benchmarks)
    for protocol in protocols:
        parts += [f"### The paper's own figures, {protocol} protocol",
                  'On other data and at full scale: PSNR / SSIM / LPIPS-VGG of the whole image. '
                  'Whether the observed centre was pasted in is not known. NEO closed '
                  f'{paper_gap(protocol)} of the gap in PSNR from naive to oracle.',
                  paper_table(protocol)]
    return '\n\n'.join(parts) + '\n'


def paper_table(protocol: str) -> str:
    """Return the paper's table of a protocol."""
    scenes = PAPER_SCENES[protocol]
    return _table(['method', *scenes], (
        [name, *(_triple(PAPER[name][scene]) for scene in scenes)] for name in PAPER))


def paper_gap(protocol: str) -> str:
    """Return what share of the gap NEO closed on the paper's scenes, by whole PSNR."""
    shares = []
    for scene in PAPER_SCENES[protocol]:
        low, neo, high = (PAPER[name][scene][0] for name in ('naive', 'NEO', 'oracle'))
        shares.append(f'{_number((neo - low) / (high - low), 0, 100, " %")} ({scene})')
    return ', '.join(shares)


def best_practical(results: Sequence[MethodScores], score: str = 'ring_psnr') -> str | None:
    """Return the method with the best score among those a robot could run, None if unscored."""
    lowest = 'lpips' in score
    rivals = {result.method: result.estimates[score].mean for result in results
              if not METHODS[result.method].bound and score in result.estimates}
    if not rivals:
        return None
    return (min if lowest else max)(rivals, key=rivals.__getitem__)


def _score_table(results: Sequence[MethodScores], part: str) -> str:
    columns = {f'{part}_{measure}': words for measure, words in _MEASURES.items()
               if any(f'{part}_{measure}' in result.estimates for result in results)}
    best = best_practical(results, f'{part}_psnr')
    rows = []
    for result in results:
        name = f'**{result.method}**' if result.method == best else result.method
        cells = [_score(result, score) for score in columns]
        rows.append([name, *cells, 'yes' if result.observed_pasted else 'no'])
    return _table([part, *columns.values(), 'pasted'], rows)


def _mean_table(benchmarks: Sequence[Sequence[MethodScores]]) -> str:
    """Return the ring's scores of the methods that all scenes have; each scene counts alike."""
    of_scene = [{result.method: result.estimates for result in results} for results in benchmarks]
    columns = {f'ring_{measure}': words for measure, words in _MEASURES.items()}
    rows = []
    for method in of_scene[0]:
        if not all(method in scene for scene in of_scene):
            continue
        scores = summarise([{'path_id': number, **{
            score: scene[method][score].mean for score in columns if score in scene[method]}}
            for number, scene in enumerate(of_scene)])
        rows.append([method, *(_estimate(scores.get(score), score) for score in columns)])
    return _table(['ring', *columns.values()], rows)


def _score(result: MethodScores, score: str) -> str:
    return _estimate(result.estimates.get(score), score)


def _estimate(estimate: Estimate | None, score: str) -> str:
    if estimate is None:
        return ''
    digits = 2 if score.endswith('psnr') else 3
    text = f'{estimate.mean:.{digits}f}'
    if estimate.low is not None:
        text += f' ({estimate.low:.{digits}f} to {estimate.high:.{digits}f})'
    return text


def _cost_table(results: Sequence[MethodScores]) -> str:
    rows = []
    lpips = {result.method: result.row['ring_lpips_vgg'] for result in results}
    worst, best = lpips.get('naive'), lpips.get('oracle')
    for result in results:
        row, figures = result.row, result.figures
        rows.append([
            result.method, _number(row['oracle_gap_closed'], 0, 100, ' %'),
            _number(_closed(row['ring_lpips_vgg'], worst, best), 0, 100, ' %'),
            _number(row['warping_error'], 2, 1e3), _number(figures.get('flicker'), 2),
            _number(row['latency_ms_median'], 1), _number(row['latency_ms_p95'], 1),
            _number(figures.get('memory_mb'), 0), _number(row['train_minutes'], 1),
            _number(row['model_mb'], 1)])
    return _table(['method', 'gap closed', 'by LPIPS', 'warping error, 10^-3', 'flicker',
                   'ms median', 'ms p95', 'memory MB', 'training min', 'MB'], rows)


def _closed(value: float | None, worst: float | None, best: float | None) -> float | None:
    if value is None or worst is None or best is None or worst == best:
        return None
    return (worst - value) / (worst - best)


def _remarks(results: Sequence[MethodScores]) -> list[str]:
    """Say what the columns do not: pose errors, uncovered rings, and who is first."""
    lines = []
    for result in results:
        if any('pose_error_cm' in frame for frame in result.frames):
            lines.append(pose_remark(result))
        if 'guided' in result.estimates:
            found = sum(frame['guided'] > 0 for frame in result.frames)
            lines.append(f'{result.method}: the memory knew {found} of {len(result.frames)} '
                         'frames; the others are from the network alone.')
        if 'uncovered' in result.estimates:
            share = result.estimates['uncovered'].mean
            lines.append(f'{result.method}: no photo covered {share:.0%} of the ring; it is '
                         'extended from its edges.')
    truth = next((result.estimates['truth_warping_error'].mean for result in results
                  if 'truth_warping_error' in result.estimates), None)
    if truth is not None:
        lines.append(f'The true images have a warping error of {truth * 1e3:.2f} x 10^-3 '
                     'themselves: things that move or shine, and errors of the depth.')
    for score, words in (('ring_psnr', 'ring PSNR'), ('ring_lpips_vgg', 'ring LPIPS')):
        best = best_practical(results, score)
        if best is not None:
            line = f'First of the methods that a robot could run, by {words}: {best} '
            lines.append(f'{line}({METHODS[best].words})' + _ahead(results, score, best, (
                best_practical([one for one in results if one.method != best], score))))
    names = [result.method for result in results]
    if 'guided' in names and 'neo_fast' in names:
        lines.append('What the memory is worth, by ring PSNR' + _ahead(
            results, 'ring_psnr', 'guided', 'neo_fast'))
    minutes = sum(result.figures.get('minutes', 0) for result in results)
    commits = sorted({str(result.row['commit']) for result in results})
    lines.append(f'Trained and scored in {minutes:.0f} minutes, without attempts that were '
                 f'broken off; commit {", ".join(commits)}.')
    return ['\n'.join(f'- {line}' for line in lines)] if lines else []


def _ahead(results: Sequence[MethodScores], score: str, one: str, other: str | None) -> str:
    """End a sentence with how far one method is ahead of another, also on its worst walk."""
    if other is None:
        return '.'
    frames = {result.method: result.frames for result in results}
    pairs = [{'path_id': mine['path_id'], 'ahead': mine[score] - its[score]}
             for mine, its in zip(frames[one], frames[other])]
    ahead, digits = summarise(pairs)['ahead'], 3 if 'lpips' in score else 2
    text = f'; {one} minus {other}, frame by frame: {ahead.mean:.{digits}f}'
    if ahead.low is not None:
        walks = [summarise([pair for pair in pairs if pair['path_id'] == walk])['ahead'].mean
                 for walk in {pair['path_id'] for pair in pairs}]
        worst = max(walks) if 'lpips' in score else min(walks)
        text += (f' ({ahead.low:.{digits}f} to {ahead.high:.{digits}f}), on its worst walk '
                 f'{worst:.{digits}f}')
    return text + '.'


def pose_remark(result: MethodScores) -> str:
    """Say how far the estimated poses were off: medians, the worst, and the failures."""
    centimetres = sorted(frame['pose_error_cm'] for frame in result.frames)
    degrees = sorted(frame['pose_error_deg'] for frame in result.frames)
    failed = sum(frame['pose_failed'] > 0 for frame in result.frames)
    middle, high = len(degrees) // 2, min(int(0.95 * len(degrees)), len(degrees) - 1)
    return (f'{result.method}: pose error {centimetres[middle]:.1f} cm, {degrees[middle]:.2f} deg '
            f'in the median; {centimetres[high]:.1f} cm, {degrees[high]:.2f} deg at 95 %; '
            f'{failed} of {len(degrees)} frames not localised.')


def _number(value: Any, digits: int, factor: float = 1, unit: str = '') -> str:
    return '' if value is None else f'{value * factor:.{digits}f}{unit}'


def _triple(values: tuple[float, float, float]) -> str:
    return f'{values[0]:.2f} / {values[1]:.3f} / {values[2]:.3f}'


def _table(columns: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [columns, ['---'] * len(columns), *rows]
    return '\n'.join('| ' + ' | '.join(line) + ' |' for line in lines)
