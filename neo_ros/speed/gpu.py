"""Speed of the field and of the stream on a GPU, at the paper's full size."""
from collections.abc import Callable, Iterator
from dataclasses import replace
import math

from neo_ros.geometry import Intrinsics
from neo_ros.machine.host import Machine
from neo_ros.speed.field import measure_field
from neo_ros.speed.record import Effort, Record, time_calls
import torch

FULL = Intrinsics.from_hfov(512, 512, 2 * math.atan(2))
MATRIX_SIDE = 4096
# What lies in a GPU's cache, and what does not.
COPIED_BYTES = 1 << 23, 1 << 28


def measure_gpu(effort: Effort) -> Iterator[Record]:
    """Time `measure_field` where torch has a GPU; floors are of the GPU's own best rates."""
    if not torch.cuda.is_available():
        yield Record('gpu', 'gpu', skipped='no GPU that torch can use')
        return
    gpu = torch.device('cuda')
    machine = device_rates(gpu, effort.seconds / 3)
    for record in measure_field(machine, effort, 'cuda', FULL):
        yield replace(record, benchmark='gpu', details=record.details | {
            'gpu': torch.cuda.get_device_name(gpu), 'memory_gb_s': machine.memory_gb_s[1]})


def device_rates(device: torch.device, seconds: float, side: int = MATRIX_SIDE) -> Machine:
    """Measure a device's float32 matrix products and copies for about so many seconds each."""
    def fastest(call: Callable[[], torch.Tensor]) -> float:
        # Reading one number waits for the result.
        return float(time_calls(lambda: float(call().flatten()[-1]), seconds).min()) / 1e3

    def copy_rate(size: int) -> float:
        source = torch.ones(size, dtype=torch.uint8, device=device)
        copy = torch.empty_like(source)
        return 2 * size / fastest(lambda: copy.copy_(source)) / 1e9

    matrix = torch.rand(side, side, device=device)
    cached, memory = (copy_rate(size) for size in COPIED_BYTES)
    return Machine({1: 2 * side ** 3 / fastest(lambda: matrix @ matrix) / 1e9},
                   {1: memory}, {1: cached})
