"""Speed of the stream of training views, alone and while a network is trained on it."""
from collections.abc import Callable, Iterator
import itertools
import math
import time

from neo_ros.evaluation.metrics import psnr
from neo_ros.field.radiance_field import RadianceField
from neo_ros.field.rendering import render_view, to_uint8
from neo_ros.geometry import CameraPose, Intrinsics, ViewExpansion
from neo_ros.machine.host import Machine
from neo_ros.outpaint.fitting import OutpaintConfig, OutpaintTrainer
from neo_ros.outpaint.networks import NetworkConfig
from neo_ros.outpaint.pair_stream import PairStream
from neo_ros.scenes.pose_sampling import PoseSampler
from neo_ros.speed.record import Effort, Record, time_calls, Work
import numpy as np
import torch

BATCH = 16
LEVEL = ((0.0, 0.0), (0.0, 0.0))


def measure_stream(field: RadianceField, poses: list[CameraPose], wide: Intrinsics,
                   work: Callable[[int], Work], machine: Machine,
                   effort: Effort) -> Iterator[Record]:
    """
    Time views as the stream gives them: with new panoramas, without, and in a training.

    A call is as many batches as there are for each new panorama. `work` tells what rendering so
    many rays takes at least.
    """
    sampler = PoseSampler(np.stack([pose.position[:2] for pose in poses]),
                          (-math.pi, 2 * math.pi), LEVEL, (float(poses[0].position[2]), 0.0), 72)
    stream = PairStream(field, sampler, wide, 10_000, seed=0)
    stream.pool.fill(stream.rules.first)
    steps = itertools.count(1)
    image = stream.pool.panoramas[0].image
    rays = image.shape[0] * image.shape[1]
    views = BATCH * stream.steps_per_panorama
    cuts = 8 * views * wide.width * wide.height
    render = work(rays)
    assert render.flops is not None

    def with_views(record: Record, rendered: bool) -> Record:
        assert record.mean_ms is not None
        record.details['views_per_s'] = 1e3 * views / record.mean_ms
        floor = Work(render.flops, render.bytes + cuts, render.footprint) if rendered else (
            Work(None, cuts))
        return record.with_floor(floor, machine, 0)

    def batches() -> None:
        for _ in range(stream.steps_per_panorama):
            _ready(stream.batch(next(steps), BATCH))

    fresh = with_views(Record.of(
        'field', f'{views} views of the stream, with a new panorama',
        time_calls(batches, effort.seconds)), True)
    fresh.details['psnr_against_rendered'] = _faithfulness(stream, wide)
    yield fresh
    stream.pool.positions = len(stream.pool.panoramas)
    yield with_views(Record.of(
        'field', f'{views} views of the stream, panoramas there',
        time_calls(batches, effort.seconds)), False)
    yield with_views(_while_training(stream, wide, steps, effort), True)


def _faithfulness(stream: PairStream, wide: Intrinsics) -> float:
    """Return the mean PSNR of cut views against rendered ones, dB."""
    scores = []
    random = np.random.default_rng(0)
    for panorama in stream.pool.panoramas[:4]:
        T = np.eye(4)
        T[:3, :3] = stream.pool.sampler.draw_rotation(random)
        T[:3, 3] = panorama.position
        rendered = to_uint8(render_view(stream.pool.field, wide, CameraPose(T)).image)
        cut = stream.pool.cut_view(panorama, T[:3, :3])
        scores.append(psnr(rendered, cut[..., :3].cpu().numpy()))
    return float(np.mean(scores))


def _while_training(stream: PairStream, wide: Intrinsics, steps: Iterator[int],
                    effort: Effort) -> Record:
    """Time the stream's batches, with new panoramas, between steps of a training."""
    stream.pool.positions = 10_000
    narrow = wide.cropped(wide.width // 4, wide.height // 4, wide.width // 2, wide.height // 2)
    trainer = OutpaintTrainer(ViewExpansion.to_size(narrow, wide.width, wide.height),
                              NetworkConfig(), OutpaintConfig(batch=BATCH), seed=0)
    trainer.train_step(stream.batch(next(steps), BATCH))  # The first step sets things up.
    times: list[float] = []
    views = BATCH * stream.steps_per_panorama
    began = time.perf_counter()
    while len(times) < 3 or time.perf_counter() < began + effort.seconds:
        spent = 0.0
        for _ in range(stream.steps_per_panorama):
            started = time.perf_counter()
            batch = _ready(stream.batch(next(steps), BATCH))
            spent += 1e3 * (time.perf_counter() - started)
            trainer.train_step(batch)
        times.append(spent)
    whole = 1e3 * (time.perf_counter() - began)
    record = Record.of('field', f'{views} views of the stream, while training', times)
    record.details |= {'training_views_per_s': 1e3 * views * len(times) / whole,
                       'share_of_stream': sum(times) / whole}
    return record


def _ready(batch: torch.Tensor) -> torch.Tensor:
    """Wait until a GPU has made the batch."""
    batch[-1, -1, -1, 3].item()
    return batch
