"""Speed of what runs on a robot without ROS: the model, the messages, the replay of a bag."""
from array import array
from collections.abc import Iterator
from pathlib import Path
import tempfile
import time
from types import SimpleNamespace

from neo_ros.bags import replay, write_demo_bag
from neo_ros.geometry import CameraPose, ViewExpansion
from neo_ros.machine.host import Machine
from neo_ros.messages import read_image
from neo_ros.runtime import FovExtrapolator
from neo_ros.speed.images import noise_image, SEED
from neo_ros.speed.model import count_flops
from neo_ros.speed.record import Effort, Record, time_calls, Work
import numpy as np

IMAGE_SIZE = (640, 480)
ENCODINGS = {'rgb8': 3, 'bgr8': 3, 'bayer_rggb8': 1}


def measure_expand(model: Path, machine: Machine, effort: Effort) -> Iterator[Record]:
    """Time the network, `FovExtrapolator.expand` without a memory, with one thread and all."""
    flops, size = count_flops(model), model.stat().st_size
    for threads, name in ((1, '1 thread'), (0, 'all threads')):
        extrapolator = FovExtrapolator.load(model, threads, guided=False)
        view = extrapolator.expansion
        image = noise_image(view.source)
        wide = extrapolator.expand(image)
        moved = size + image.nbytes + wide.wide_image.nbytes + wide.confidence.nbytes
        yield Record.of(
            'expand', f'{size_name(view)}, {name}',
            time_calls(lambda: extrapolator.expand(image), effort.seconds),
            {'model': model.name, 'threads': threads, 'config_hash': extrapolator.card.config_hash}
        ).with_floor(Work(flops, moved), machine, threads)


def measure_messages(machine: Machine, effort: Effort) -> Iterator[Record]:
    """Time the way of an image in and out of ROS messages, 640x480."""
    width, height = IMAGE_SIZE
    image = np.random.default_rng(SEED).integers(0, 256, (height, width, 3), np.uint8)
    for encoding, channels in ENCODINGS.items():
        data = array('B', image[..., :channels].tobytes())
        message = SimpleNamespace(height=height, width=width, encoding=encoding, is_bigendian=0,
                                  step=width * channels, data=data)
        record = Record.of('messages', f'read {encoding} {width}x{height}',
                           time_calls(lambda: read_image(message), effort.seconds))
        # An rgb8 image stays where it is: there is nothing to move, so there is no floor.
        yield record if encoding == 'rgb8' else record.with_floor(
            Work(None, len(data) + image.nbytes), machine, 1)
    outgoing = SimpleNamespace(data=array('B', bytes(image.nbytes)))

    def fill() -> None:
        # As the node does: into the buffer of a message that is used again and again.
        np.copyto(np.frombuffer(outgoing.data, np.uint8), image.reshape(-1))

    yield Record.of('messages', f'fill rgb8 {width}x{height}',
                    time_calls(fill, effort.seconds)).with_floor(
        Work(None, 2 * image.nbytes), machine, 1)


def measure_replay(model: Path, effort: Effort) -> Iterator[Record]:
    """Time `replay` of a bag against the extrapolator alone, which is timed before and after."""
    extrapolator = FovExtrapolator.load(model, guided=False)
    view = extrapolator.expansion
    random = np.random.default_rng(SEED)
    shape = (view.target.height, view.target.width, 3)
    frames = ((1_000_000_000 + index * 33_333_333, random.integers(0, 256, shape, np.uint8),
               CameraPose.from_planar(0.01 * index, 0, 1.5, 0)) for index in range(effort.frames))
    moments: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        write_demo_bag(Path(folder, 'in'), frames, view)
        image = noise_image(view.source)
        alone = [time_calls(lambda: extrapolator.expand(image), effort.seconds / 2)]
        result = replay(Path(folder, 'in'), extrapolator, Path(folder, 'out'),
                        on_progress=lambda done, total: moments.append(time.perf_counter()))
        alone.append(time_calls(lambda: extrapolator.expand(image), effort.seconds / 2))
    alone_hz = 1e3 / float(np.concatenate(alone).mean())
    rate_hz = result.frames / result.wall_seconds
    # Every frame is the same number of messages, behind one of /tf_static.
    per_frame = (len(moments) - 1) // result.frames
    record = Record.of('replay', f'{size_name(view)}, bag to bag',
                       1e3 * np.diff(moments[::per_frame]), {
                           'model': model.name, 'frames': result.frames,
                           'share_in_model': result.expand_seconds / result.wall_seconds,
                           'model_rate_hz': alone_hz,
                           'share_of_model_rate': rate_hz / alone_hz})
    record.rate_hz = rate_hz
    yield record


def size_name(view: ViewExpansion) -> str:
    """Name an expansion by its sizes, such as '256x256 to 512x512'."""
    source, target = view.source, view.target
    return f'{source.width}x{source.height} to {target.width}x{target.height}'
