"""The report of a training shows the places that a robot cannot tell apart."""
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from box_room import EXPANSION, twin_memory
from neo_ros.baking.twin_search import find_twins
from neo_ros.reports.report import Strip, Text
from neo_ros.training import look_alikes
from neo_ros.training.look_alikes import look_alike_sections
import pytest


@pytest.mark.slow
def test_a_pair_of_rooms_is_shown_once_and_from_both(
        tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = twin_memory(own_picture=False)
    path = tmp_path / 'room.memory'
    run: Any = SimpleNamespace(memory_path=path, expansion=EXPANSION,
                               experiment=SimpleNamespace(memory=True))
    memory.write(path)
    assert look_alike_sections(run) == []
    memory.twins = find_twins(memory, EXPANSION)
    memory.write(path)
    text, strip = look_alike_sections(run)
    assert isinstance(text, Text) and isinstance(strip, Strip)
    assert text.text.startswith('1 pair of places') and 'are shown' not in text.text
    here, there = (image for _, image in strip.images)
    assert abs(here.astype(int) - there).mean() < 3 and here.std() > 20
    monkeypatch.setattr(look_alikes, 'MOST_SHOWN', 0)
    text, = look_alike_sections(run)
    assert isinstance(text, Text) and '0 are shown' in text.text
    run.experiment.memory = None
    assert look_alike_sections(run) == []
