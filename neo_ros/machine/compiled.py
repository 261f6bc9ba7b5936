"""Numba's `njit` for a robot: what is compiled is kept on disk where that can be done."""
from collections.abc import Callable
from contextlib import suppress
import functools
from pathlib import Path
from typing import Any
import warnings

import numba
from numba.core.caching import FunctionCache

# What `set_num_threads` takes at most; `get_num_threads` tells what was set last.
ALL_THREADS: int = numba.config.NUMBA_NUM_THREADS  # type: ignore[attr-defined]


class _Cache(FunctionCache):
    """
    The cache of `cache=True`, but a full disk or a broken file only costs time.

    And what a kernel calls may lie in the other files of kernels beside it, which numba does not
    look at: where one of them has changed, all are compiled anew.
    """

    def __init__(self, kernel: Callable) -> None:
        super().__init__(kernel)
        beside = sorted(Path(kernel.__code__.co_filename).parent.glob('*kernels.py'))
        self._cache_file._source_stamp = [
            (path.name, path.stat().st_mtime, path.stat().st_size) for path in beside]

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # Unpickling what a power cut left of a file may raise anything.
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception as error:  # Among others, what could not be flushed.
            _warn(getattr(error, 'strerror', None) or type(error).__name__)


def njit(**options: Any) -> Callable[[Callable], Any]:
    """Compile a kernel when it is first called, and keep the code; a warning where it cannot."""
    def compiled(kernel: Callable) -> Any:
        dispatcher = numba.njit(**options)(kernel)
        try:
            dispatcher._cache = _Cache(kernel)
        except RuntimeError:  # With cache=True numba would not even import the kernel.
            _warn('neither the folder of the package nor the one of the user can be written')
        return dispatcher
    return compiled


@functools.cache
def _warn(reason: str) -> None:
    """Say it once for all kernels."""
    warnings.warn(f'compiled code cannot be kept ({reason}), every start takes some seconds '
                  'longer; set NUMBA_CACHE_DIR to a folder that can be written', RuntimeWarning)
