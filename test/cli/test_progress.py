"""How long work is shown."""
import io

from neo_ros.cli import progress
import pytest
from rich.console import Console


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(progress.time, 'monotonic', lambda: now[0])
    return now


def test_a_stage_that_comes_again_has_a_time_of_its_own(clock: list[float]) -> None:
    text = io.StringIO()
    show = progress._Lines(Console(file=text, width=80))
    show('scoring', 0, 10)
    for done, minute in ((5, 5), (10, 10)):
        clock[0] = 100 + 60 * minute
        show('scoring', done, 10)
    show('scoring', 2, 10, 'of another model')
    clock[0] += 120
    show('scoring', 6, 10)
    assert text.getvalue().splitlines() == [
        'scoring 0/10 after 0.0 min',
        'scoring 5/10 after 5.0 min, 5.0 min left',
        'scoring 10/10 after 10.0 min',
        'scoring 2/10 after 0.0 min of another model',
        'scoring 6/10 after 2.0 min, 2.0 min left']


def test_a_bar_that_comes_again_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Console(file=io.StringIO(), force_terminal=True, width=100)
    monkeypatch.setattr(progress, 'Console', lambda: terminal)
    begun: list[int] = []
    monkeypatch.setattr(progress.Progress, 'reset', lambda bar, task: begun.append(task))
    with progress.stage_progress() as show:
        show('outpainter', 5, 10)
        show('outpainter', 10, 10)
        assert begun == []
        show('outpainter', 1, 10)
        assert begun == [0]
