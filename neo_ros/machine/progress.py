"""How long work tells how far it is: called with what is done, and of how much."""
from collections.abc import Callable

Progress = Callable[[int, int], None]


def no_progress(done: int, total: int) -> None:
    """Show nothing."""
