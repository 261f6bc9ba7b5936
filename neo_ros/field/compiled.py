"""Numba where it is installed; fitting and rendering a field on a GPU do without."""
from collections.abc import Callable
from typing import Any

from neo_ros.errors import ConfigError

__all__ = ['get_num_threads', 'njit', 'prange']

try:
    from neo_ros.memory.compiled import njit
    from numba import get_num_threads, prange
except ModuleNotFoundError:
    prange = range  # type: ignore[misc]

    def get_num_threads() -> int:
        """Return 1: nothing is compiled here."""
        return 1

    def njit(**options: Any) -> Callable[[Callable], Any]:
        """Replace a kernel by a function that says what is missing when it is called."""
        def missing(*arguments: Any) -> None:
            raise ConfigError('field.device: cpu needs numba: pip install numba, or choose '
                              'cuda')

        return lambda kernel: missing
