"""One way to show long work: bars with the time left, or lines where there is no terminal."""
from collections.abc import Iterator
from contextlib import contextmanager
import time

from neo_ros.machine.progress import StageProgress
from rich.console import Console
from rich.progress import (
    BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeElapsedColumn,
    TimeRemainingColumn)
from rich.table import Column

LINE_EVERY_S = 30.0


@contextmanager
def stage_progress() -> Iterator[StageProgress]:
    """Give a function that shows the progress of named stages."""
    console = Console()
    if not console.is_terminal:
        yield _Lines(console)
        return
    tasks: dict[str, TaskID] = {}
    # Of a narrow terminal the note takes what is left, on several lines.
    whole = Column(no_wrap=True)
    with Progress(TextColumn('{task.description}', table_column=whole),
                  BarColumn(bar_width=20, table_column=whole),
                  MofNCompleteColumn(table_column=whole), TimeElapsedColumn(table_column=whole),
                  TimeRemainingColumn(table_column=whole),
                  TextColumn('{task.fields[note]}', markup=False, table_column=Column()),
                  console=console) as bar:
        def show(stage: str, done: int, total: int, note: str = '') -> None:
            if note and total == 1 and stage not in tasks:  # A remark, nothing to wait for.
                bar.console.print(f'{stage}: {note}', markup=False, highlight=False)
                return
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total, note='')
            elif done < bar.tasks[tasks[stage]].completed:  # The same for another model.
                bar.reset(tasks[stage])
            bar.update(tasks[stage], completed=done, total=total, note=note)

        yield show


class _Lines:
    """For log files: a line when a stage begins, now and then, and when it ends."""

    def __init__(self, console: Console) -> None:
        self._console = console
        # When a stage began, with how much done; how much is done now.
        self._stages: dict[str, tuple[float, int, int]] = {}
        self._last = 0.0

    def __call__(self, stage: str, done: int, total: int, note: str = '') -> None:
        now = time.monotonic()
        began, first, before = self._stages.get(stage, (now, done, done + 1))
        new = done < before  # For the first time, or the same for another model.
        if new:
            began, first = now, done
        self._stages[stage] = began, first, done
        if not (new or done >= total or now - self._last > LINE_EVERY_S):
            return
        self._last = now
        left = ''
        if 0 < done - first and done < total:
            seconds = (now - began) / (done - first) * (total - done)
            left = f', {seconds / 60:.1f} min left'
        self._console.print(
            f'{stage} {done}/{total} after {(now - began) / 60:.1f} min{left} {note}'.rstrip(),
            markup=False, highlight=False, soft_wrap=True)
