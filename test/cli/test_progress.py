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


def test_a_long_note_leaves_the_stage_and_its_time_readable(
        monkeypatch: pytest.MonkeyPatch) -> None:
    text = io.StringIO()
    terminal = Console(file=text, force_terminal=True, width=80, height=40)
    monkeypatch.setattr(progress, 'Console', lambda: terminal)
    plan = '30 minutes: ' + 'a field of 8 million voxels, ' * 8 + 'what is left'
    with progress.stage_progress() as show:
        show('plan', 1, 1, plan)
        show('outpainter', 30, 120, '17.3 dB on held-out photos; 12 of 30 min left in all')
    shown = text.getvalue()
    assert plan.split(', ')[-1] in shown  # Above the bars, all of it.
    last = [line for line in shown.splitlines() if 'outpainter' in line][-1]
    assert '30/120' in last and '0:00:0' in last and '17.3' in last
