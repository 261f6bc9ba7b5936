"""
Numba's `njit` for a robot: what is compiled is kept on disk where that can be done.

The one place that leans on private parts of numba, all of them in `kept_on_disk`. setup.py
bounds numba's version from above; with a version that lacks one of them kernels still run, but
every start compiles them, and a warning names what is missing.
"""
from collections.abc import Callable, Iterator
from contextlib import contextmanager, ExitStack, suppress
import fcntl
import functools
from pathlib import Path
from typing import Any
import warnings

import numba

# What `set_num_threads` takes at most; `get_num_threads` tells what was set last.
ALL_THREADS: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]


def njit(**options: Any) -> Callable[[Callable], Any]:
    """Compile a kernel when it is first called, and keep the code; a warning where it cannot."""
    # Else a process that compiles a kernel binds it to the code of what it calls as that was
    # compiled alone, and one that finds it on disk to the kernel's own copy: other last bits.
    options.setdefault('forceinline', not options.get('parallel'))

    def compiled(kernel: Callable) -> Any:
        dispatcher = numba.njit(**options)(kernel)
        if dispatcher is kernel:  # NUMBA_DISABLE_JIT is set.
            return kernel
        try:
            kept_on_disk(dispatcher, kernel)
        except (ImportError, AttributeError) as error:
            _warn(f'numba {numba.__version__} lacks what machine/compiled.py uses: {error}',
                  'install a version of numba that setup.py allows')
        except RuntimeError:  # With cache=True numba would not even import the kernel.
            _warn('neither the folder of the package nor the one of the user can be written')
        return dispatcher
    return compiled


def kept_on_disk(dispatcher: Any, kernel: Callable) -> None:
    """
    Keep the code of a kernel that `dispatcher` compiles, as `cache=True` would, but more surely.

    Raises ImportError or AttributeError where this numba lacks one of the private parts, and
    RuntimeError where no folder can be written.
    """
    cache = _cache_class()(kernel)
    # What a kernel calls may lie in the other files of kernels beside it, which numba does not
    # look at: where one of them has changed, all are compiled anew.
    beside = sorted(Path(kernel.__code__.co_filename).parent.glob('*kernels.py'))
    _replace(cache._cache_file, '_source_stamp', [
        (path.name, path.stat().st_mtime, path.stat().st_size) for path in beside])
    _replace(dispatcher, '_cache', cache)


@functools.cache
def _cache_class() -> type[Any]:
    from numba.core.caching import FunctionCache
    for method in ('load_overload', 'save_overload', 'flush'):
        getattr(FunctionCache, method)  # Numba calls the first two, or ours would be idle.

    class Cache(FunctionCache):
        """The cache of `cache=True`, but a full disk or a broken file only costs time."""

        def load_overload(self, sig: Any, target_context: Any) -> Any:
            try:
                with _alone_in(Path(self.cache_path)):
                    return super().load_overload(sig, target_context)
            except Exception:  # Unpickling what a power cut left of a file may raise anything.
                with suppress(OSError):
                    self.flush()
                return None

        def save_overload(self, sig: Any, data: Any) -> None:
            try:
                with _alone_in(Path(self.cache_path)):
                    super().save_overload(sig, data)
            except Exception as error:  # Among others, what could not be flushed.
                _warn(getattr(error, 'strerror', None) or type(error).__name__)

    return Cache


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """
    Keep other processes out of a folder of compiled code, where one may write there.

    Numba's index of a kernel and the files it names are written one after the other: of two
    processes that keep code for other types at once, one would find the other's code as its own.
    """
    with ExitStack() as held:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            fcntl.flock(held.enter_context(open(folder / 'neo_ros.lock', 'w')), fcntl.LOCK_EX)
        yield


def _replace(owner: Any, name: str, value: Any) -> None:
    """Set an attribute that is there; to set one that is not would silently do nothing."""
    getattr(owner, name)
    setattr(owner, name, value)


@functools.cache
def _warn(reason: str,
          remedy: str = 'set NUMBA_CACHE_DIR to a folder that can be written') -> None:
    """Say it once for all kernels."""
    warnings.warn(f'compiled code cannot be kept ({reason}), every start takes some seconds '
                  f'longer; {remedy}', RuntimeWarning)
