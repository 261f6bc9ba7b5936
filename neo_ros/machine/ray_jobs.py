"""Jobs that need nothing of each other, done by Ray: on this machine, or on a cluster."""
from collections.abc import Callable, Iterator, Sequence
import os
from pathlib import Path
import socket
from typing import Any, Protocol, TypeVar

from neo_ros.errors import ConfigError, NeoError

Job = TypeVar('Job')
Result = TypeVar('Result')


class FileJob(Protocol):
    """Something to make, and the file that it comes to lie in."""

    @property
    def out(self) -> Path:
        """The file, at a path that all machines know."""


Making = TypeVar('Making', bound=FileJob)
# How often a job is begun anew whose worker or machine died.
RETRIES = 3
CONNECT_S = 10.0
# Ray would set aside a third of the memory for what jobs hand over; ours hand over file names.
_STORE_BYTES = 100 << 20


def check_ray() -> None:
    """Raise ConfigError where Ray is not installed, or nobody answers at RAY_ADDRESS."""
    try:
        import ray
    except ModuleNotFoundError:
        raise ConfigError('--cluster: ray is not installed; this needs the extra cluster: make '
                          "dev-setup, or pip install '.[cluster]', in a checkout") from None
    if not ray.is_initialized():
        _check_answer(_address())


def map_on_ray(function: Callable[[Job], Result], jobs: Sequence[Job],
               retries: int = RETRIES) -> Iterator[tuple[int, Result | NeoError]]:
    """
    Yield the index of each job and its result, as they end; each takes one core.

    The cluster is that of RAY_ADDRESS, else one of this machine alone, which ends with the
    iteration. Where a worker or its machine dies, the job is done again, up to `retries` times;
    so a job may be begun more than once, and even run twice at a time. A job that cannot be done
    gives a NeoError that says why. Raises ConfigError without Ray, or where no cluster answers.
    """
    check_ray()
    import ray

    def on_one_core(job: Job) -> Result:
        from numba import set_num_threads
        set_num_threads(1)  # It does not go by what Ray says: it would take all cores.
        return function(job)

    mine = not ray.is_initialized()
    if mine:
        _join(ray)
    try:
        task = ray.remote(num_cpus=1, max_retries=retries)(on_one_core).options(
            name=function.__name__)
        waiting = {task.remote(job): index for index, job in enumerate(jobs)}
        while waiting:
            (done,), _ = ray.wait(list(waiting), num_returns=1)
            yield waiting.pop(done), _result(ray, done, retries)
    finally:
        if mine:
            ray.shutdown()


def make_on_ray(function: Callable[[Making], None], jobs: Sequence[Making], failed: str
                ) -> Iterator[int]:
    """
    Make files, see `map_on_ray`; yield the index of each job as its file is there.

    Raises NeoError for the first that cannot be made; failed: what to say of it.
    """
    if not jobs:
        return
    for index, error in map_on_ray(function, jobs):
        out = jobs[index].out
        if isinstance(error, NeoError):
            raise NeoError(f'{out}: {failed}: {error}; run the same command again')
        if not out.exists():
            raise NeoError(f'{out}: its worker wrote it, but it is not there: --out must be in a '
                           'folder that all machines of the cluster share')
        yield index


def _address() -> str:
    return os.environ.get('RAY_ADDRESS') or 'local'


def _join(ray: Any) -> None:
    """Connect to the cluster that the environment names, or start one here."""
    address = _address()
    own: dict[str, Any] = {}
    if address == 'local':
        # Else it would report its use to its makers.
        os.environ.setdefault('RAY_USAGE_STATS_ENABLED', '0')
        own = {'include_dashboard': False, 'object_store_memory': _STORE_BYTES}
    try:
        ray.init(address=address, log_to_driver=False, logging_level='error', **own)
    except (ConnectionError, RuntimeError, ValueError) as error:
        reason = str(error).strip().split('\n')[0]
        if 'AuthenticationError' in str(error.__cause__):
            reason = 'it asks for a token: see RAY_AUTH_MODE in the documentation of Ray'
        raise ConfigError(f'RAY_ADDRESS: expected a Ray cluster at {address}, got: {reason}'
                          ) from error


def _check_answer(address: str) -> None:
    """Raise ConfigError where nobody listens at host:port: Ray would try for minutes."""
    host, _, port = address.rpartition(':')
    if not port.isdecimal() or '/' in host:
        return
    try:
        socket.create_connection((host, int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise ConfigError(f'RAY_ADDRESS: expected a Ray cluster at {address}, got: {error}'
                          ) from error


def _result(ray: Any, done: Any, retries: int) -> Any:
    """Return what a job gave, or why there is nothing."""
    try:
        return ray.get(done)
    except ray.exceptions.RayTaskError as error:
        # Of a module that is missing there, the last line names it.
        reason = str(error.cause).strip().split('\n')[-1]
        return NeoError(f'{type(error.cause).__name__}: {reason}')
    except ray.exceptions.RayError as error:
        return NeoError(f'given up after {retries + 1} attempts, its worker died: '
                        + str(error).strip().split('\n')[0])
