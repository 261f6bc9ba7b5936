"""Several processes that train one network, a GPU each: torchrun starts them, DDP joins them."""
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
import gc
import os

import torch
from torch import distributed, nn
from torch.nn.parallel import DistributedDataParallel

# The others wait while the first process fits the field.
LONGEST_WAIT = timedelta(days=2)


@contextmanager
def process_group() -> Iterator[int]:
    """
    Join the processes that torchrun started, and give this one's number; 0 where it is alone.

    NCCL for what is on GPUs, gloo for the rest. What `shared_gradients` wrapped must be let go
    before the end.
    """
    if int(os.environ.get('WORLD_SIZE', '1')) == 1:
        yield 0
        return
    distributed.init_process_group(
        'cpu:gloo,cuda:nccl' if torch.cuda.is_available() else 'gloo', timeout=LONGEST_WAIT)
    try:
        if torch.cuda.is_available():
            torch.cuda.set_device(distributed.get_rank() % torch.cuda.device_count())
        yield distributed.get_rank()
    finally:
        # A network that is still shared holds the group's threads, and those must not meet the end
        # of the interpreter: "terminate called without an active exception".
        gc.collect()
        distributed.destroy_process_group()


def processes() -> tuple[int, int]:
    """Return the number of this process and how many there are."""
    if not distributed.is_initialized():
        return 0, 1
    return distributed.get_rank(), distributed.get_world_size()


def wait_for_all() -> None:
    """Return when every process has come here."""
    if distributed.is_initialized():
        distributed.barrier()


def shared_gradients(network: nn.Module) -> nn.Module:
    """Wrap a network so that its gradients are the mean over all processes."""
    return DistributedDataParallel(network) if distributed.is_initialized() else network


def from_first(value: float) -> float:
    """Return the first process's value in all of them."""
    if not distributed.is_initialized():
        return value
    shared = torch.tensor([value], dtype=torch.float64)
    distributed.broadcast(shared, 0)
    return float(shared)
