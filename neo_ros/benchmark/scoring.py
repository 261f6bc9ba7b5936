"""
Run methods on a scene under a protocol, one after the other, and keep what each scored.

Every method's scores lie in a file of their own as soon as it is through; a run that was broken
off goes on with the next method.
"""
from dataclasses import replace
import json
import os
from pathlib import Path
import shutil
import time
from typing import Any, Callable, Sequence

import cv2
from neo_ros.benchmark.method_memory import measure_memory
from neo_ros.benchmark.methods import make_method, METHODS
from neo_ros.benchmark.workbench import Workbench
from neo_ros.errors import ModelError
from neo_ros.evaluation.baselines import Method
from neo_ros.evaluation.evaluate import (
    method_scores, MethodScores, ROW_KEYS, score_frames, Scorer)
from neo_ros.evaluation.evaluation_report import pick_frames
from neo_ros.evaluation.metrics import Estimate, score_frame
from neo_ros.evaluation.output import write_bytes
from neo_ros.evaluation.stability import DepthOf, flicker, stored_depths, WarpingError
from neo_ros.evaluation.true_depth import demo_depth, field_depth, is_demo_flat
from neo_ros.pipeline import Progress
from neo_ros.scenes.posed_images import read_rgb_image
import numpy as np


def run_benchmark(bench: Workbench, names: Sequence[str],
                  through: Callable[[list[MethodScores]], None] = lambda results: None,
                  ) -> list[MethodScores]:
    """
    Score the named methods on the bench's scene; returns them in the order of the names.

    `through` gets what there is after every method.
    """
    depth_of: DepthOf | None = None
    results: list[MethodScores] = []
    scorers: list[Scorer] | None = None
    for name in names:
        stored = _read_scores(bench, name)
        if stored is None:
            started = time.monotonic()
            method = make_method(name, bench)
            if scorers is None:
                scorers, depth_of = load_scorers(bench.progress), true_depth(bench, names)
            stored = _score(bench, method, scorers, depth_of)
            # What an interrupted run had trained before is not in it.
            stored.figures['minutes'] = (time.monotonic() - started) / 60
            _write_scores(bench, stored)
        results.append(stored)
        fill_gap_closed([result.row for result in results])
        through(results)
    return results


def load_scorers(progress: Progress) -> list[Scorer]:
    """Return PSNR with SSIM, and LPIPS (VGG and Alex) where its weights can be had."""
    from neo_ros.evaluation.lpips import Lpips
    scorers: list[Scorer] = [score_frame]
    try:
        scorers += [Lpips('vgg'), Lpips('alex')]
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
    path = bench.folder / 'scores' / method / f'{index:05d}.png'
    return read_rgb_image(path, bench.expansion.target)


def _score(bench: Workbench, method: Method, scorers: Sequence[Scorer],
           depth_of: DepthOf | None) -> MethodScores:
    name = method.name
    pictures = bench.folder / 'scores' / f'{name}.partial'
    shutil.rmtree(pictures, ignore_errors=True)
    pictures.mkdir(parents=True)

    def keep(index: int, wide_image: np.ndarray) -> dict[str, float]:
        bgr = cv2.cvtColor(wide_image, cv2.COLOR_RGB2BGR)
        write_bytes(pictures / f'{index:05d}.png', cv2.imencode('.png', bgr)[1].tobytes())
        return {}

    frames = bench.frames
    watchers = [keep] + ([WarpingError(frames, depth_of)] if depth_of else [])
    scored = score_frames(frames, method, scorers, watchers, lambda done: bench.progress(
        f'scoring {name}', done, len(frames), ''))
    result = method_scores(bench.scene.name, frames, method, scored)
    result.row.update(protocol=bench.job.protocol, scale=bench.job.scale)
    figures = {'flicker': flicker(method, frames)}
    memory = measure_memory(bench.folder, name)
    if memory is not None:
        figures['memory_mb'] = memory
    picked = set(pick_frames(scored).values())
    for path in pictures.iterdir():
        if int(path.stem) not in picked:
            path.unlink()
    kept = bench.folder / 'scores' / name
    shutil.rmtree(kept, ignore_errors=True)
    os.replace(pictures, kept)
    return replace(result, figures=figures)


def true_depth(bench: Workbench, names: Sequence[str]) -> DepthOf | None:
    """
    Return the depth at the test frames' poses: exact in the demo flat, else the field's.

    None where it would need a field that none of the methods does.
    """
    frames = bench.frames
    if is_demo_flat(Path(bench.job.test_scene or bench.job.scene)):
        render = demo_depth(frames)
    elif any(METHODS[name].field for name in names):
        render = field_depth(frames, bench.field()[0])
    else:
        return None
    return stored_depths(frames, render, bench.folder / 'depths.npz',
                         lambda done, total: bench.progress('depth', done, total, ''))


def _write_scores(bench: Workbench, result: MethodScores) -> None:
    text = json.dumps({**result.to_dict(), 'row': result.row},
                      allow_nan=False, indent=1)
    path = bench.folder / 'scores' / f'{result.method}.json'
    write_bytes(path.with_suffix('.partial'), text.encode())
    os.replace(path.with_suffix('.partial'), path)


def _read_scores(bench: Workbench, name: str) -> MethodScores | None:
    """Return the scores that an earlier run wrote for the same frames, if it did."""
    path = bench.folder / 'scores' / f'{name}.json'
    try:
        stored = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    wanted = [path.name for path in bench.frames.images.image_paths]
    if ([frame['frame'] for frame in stored['frames']] != wanted
            or tuple(stored['row']) != ROW_KEYS):
        return None
    return MethodScores(
        stored['method'], stored['observed_pasted'], stored['frames'],
        {score: Estimate(**estimate) for score, estimate in stored['estimates'].items()},
        stored['row'], stored['figures'])


def write_rows(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    """Write a file of results: a list of rows with the keys ROW_KEYS."""
    wrong = [row['method'] for row in rows if tuple(row) != ROW_KEYS]
    assert not wrong, wrong
    partial = path.with_suffix('.partial')
    write_bytes(partial, (json.dumps(list(rows), indent=1, allow_nan=False) + '\n').encode())
    os.replace(partial, path)
