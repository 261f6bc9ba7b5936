"""How long work tells how far it is."""
from collections.abc import Callable
from typing import Protocol

# Called with how much is done, and of how much.
Progress = Callable[[int, int], None]


def no_progress(done: int, total: int) -> None:
    """Show nothing."""


class StageProgress(Protocol):
    """Tell how far a stage of several is."""

    def __call__(self, stage: str, done: int, total: int, note: str = '') -> None:
        """Say that `done` of `total` are done; `note` is what the work has to say beside it."""


def no_stage_progress(stage: str, done: int, total: int, note: str = '') -> None:
    """Show nothing."""


def of_stage(progress: StageProgress, stage: str) -> Progress:
    """Return the progress of one stage."""
    return lambda done, total: progress(stage, done, total)


def of_several(progress: Progress, number: int, count: int) -> Progress:
    """Return the progress of one of several that are as long, as part of that of all."""
    return lambda done, total: progress(number * total + done, count * total)
