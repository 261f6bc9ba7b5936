"""
Run methods on a scene under a protocol, one after the other, and keep what each scored.

Every method's scores lie in a file of their own as soon as it is through; a run that was broken
off goes on with the next method.
"""
from collections.abc import Callable, Sequence
from dataclasses import replace
import json
import os
from pathlib import Path
import shutil
import time
from typing import Any

from neo_ros.benchmark.method_memory import measure_memory
from neo_ros.benchmark.methods import make_method, METHODS
from neo_ros.benchmark.true_depth import demo_depth, field_depth, is_demo_flat
from neo_ros.benchmark.workbench import Workbench
from neo_ros.errors import ModelError
from neo_ros.evaluation.baselines import Method
from neo_ros.evaluation.evaluate import (
    method_scores, MethodScores, ROW_KEYS, score_frames, Scorer, Watcher)
from neo_ros.evaluation.metrics import Estimate, score_frame
from neo_ros.evaluation.stability import DepthOf, flicker, stored_depths, WarpingError
from neo_ros.machine.files import write_bytes
from neo_ros.machine.progress import StageProgress
from neo_ros.reports.kept_pictures import KeptPictures, read_picture
import numpy as np


def run_benchmark(bench: Workbench, names: Sequence[str],
                  through: Callable[[list[MethodScores]], None] = lambda results: None,
                  ) -> list[MethodScores]:
    """
    Score the named methods on the bench's scene; returns them in the order of the names.

    What an earlier run scored is taken, unless it lacks a measure that this one has.
    `through` gets what there is after every method.
    """
    depth_of: DepthOf | None = None
    results: list[MethodScores] = []
    scorers, depth = load_scorers(bench.progress), depth_source(bench, names)
    measures = [*scorers, *([f'{depth} depth'] if depth else [])]
    for name in names:
        stored = _read_scores(bench, name, measures)
        if stored is None:
            started = time.monotonic()
            method = make_method(name, bench)
            if depth is not None and depth_of is None:
                depth_of = true_depth(bench, depth)
            stored = _score(bench, method, list(scorers.values()), depth_of)
            # What an interrupted run had trained before is not in it.
            stored.figures['minutes'] = (time.monotonic() - started) / 60
            _write_scores(bench, stored, measures)
        results.append(stored)
        fill_gap_closed([result.row for result in results])
        through(results)
    return results


def load_scorers(progress: StageProgress) -> dict[str, Scorer]:
    """Return by name PSNR with SSIM, and LPIPS (VGG, Alex) where its weights can be had."""
    from neo_ros.evaluation.lpips import Lpips
    import torch

    scorers: dict[str, Scorer] = {'psnr_ssim': score_frame}
    device = 'cuda' if torch.cuda.is_available() else 'cpu'
    try:
        scorers |= {'lpips_vgg': Lpips('vgg').to(device), 'lpips_alex': Lpips('alex').to(device)}
    except ModelError as error:
        progress('without LPIPS', 0, 1, str(error))
    return scorers


def fill_gap_closed(rows: Sequence[dict[str, Any]]) -> None:
    """Fill oracle_gap_closed: (ring PSNR - that of B1) / (that of the oracle - that of B1)."""
    psnr = {row['method']: row['ring_psnr'] for row in rows}
    if 'naive' not in psnr or 'oracle' not in psnr or psnr['oracle'] == psnr['naive']:
        return
    for row in rows:
        gap = psnr['oracle'] - psnr['naive']
        row['oracle_gap_closed'] = (row['ring_psnr'] - psnr['naive']) / gap


def frame_picture(bench: Workbench, method: str, index: int) -> np.ndarray:
    """Return a kept wide image of a method (best, median or worst), RGB uint8."""
    return read_picture(bench.folder / 'scores' / method, index, bench.expansion.target)


def _score(bench: Workbench, method: Method, scorers: Sequence[Scorer],
           depth_of: DepthOf | None) -> MethodScores:
    name = method.name
    pictures = KeptPictures(bench.folder / 'scores' / f'{name}.partial')
    frames = bench.frames
    watchers: list[Watcher] = [pictures]
    if depth_of is not None:
        watchers.append(WarpingError(frames, depth_of))
    scored = score_frames(frames, method, scorers, watchers, lambda done: bench.progress(
        f'scoring {name}', done, len(frames), ''))
    result = method_scores(bench.scene.name, frames, method, scored)
    result.row.update(protocol=bench.job.protocol, scale=bench.job.scale)
    figures = {'flicker': flicker(method, frames)}
    memory = measure_memory(bench.folder, name)
    if memory is not None:
        figures['memory_mb'] = memory
    pictures.drop_others(scored)
    kept = bench.folder / 'scores' / name
    shutil.rmtree(kept, ignore_errors=True)
    os.replace(pictures.folder, kept)
    return replace(result, figures=figures)


def depth_source(bench: Workbench, names: Sequence[str]) -> str | None:
    """
    Say where the depth at the test frames' poses is from: exact in the demo flat, else field.

    None where it would need a field that none of the methods does.
    """
    if is_demo_flat(Path(bench.job.test_scene or bench.job.scene)):
        return 'exact'
    return 'field' if any(METHODS[name].field for name in names) else None


def true_depth(bench: Workbench, source: str) -> DepthOf:
    """Return the depth at the test frames' poses from what `depth_source` says."""
    frames = bench.frames
    render = (demo_depth(frames) if source == 'exact'
              else field_depth(frames, bench.field()[0]))
    return stored_depths(frames, render, bench.folder / 'depths.npz',
                         lambda done, total: bench.progress('depth', done, total, ''))


def _write_scores(bench: Workbench, result: MethodScores, measures: list[str]) -> None:
    text = json.dumps({**result.to_dict(), 'row': result.row, 'measures': measures},
                      allow_nan=False, indent=1)
    write_bytes(bench.folder / 'scores' / f'{result.method}.json', text.encode())


def _read_scores(bench: Workbench, name: str, measures: list[str]) -> MethodScores | None:
    """Return what an earlier run scored on the same frames with at least these measures."""
    path = bench.folder / 'scores' / f'{name}.json'
    try:
        stored = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    wanted = [path.name for path in bench.frames.images.image_paths]
    if ([frame['frame'] for frame in stored['frames']] != wanted
            or tuple(stored['row']) != ROW_KEYS
            or not set(measures) <= set(stored.get('measures', []))):
        return None
    return MethodScores(
        stored['method'], stored['observed_pasted'], stored['frames'],
        {score: Estimate(**estimate) for score, estimate in stored['estimates'].items()},
        stored['row'], stored['figures'])


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a file of results: a list of rows with the keys ROW_KEYS."""
    wrong = [row['method'] for row in rows if tuple(row) != ROW_KEYS]
    assert not wrong, wrong
    write_bytes(path, (json.dumps(list(rows), indent=1, allow_nan=False) + '\n').encode())
