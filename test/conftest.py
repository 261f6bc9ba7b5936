"""What tests share, and what holds for all: no clock in hypothesis, no logs at home."""
from collections.abc import Iterator
from pathlib import Path
import re
from typing import Any

from hypothesis import settings
import pytest

# The machines that run the tests are shared: how long an example takes says nothing.
settings.register_profile('shared machine', deadline=None)
settings.load_profile('shared machine')
# What a file imports, and what fixtures a test uses, tell what it needs.
MARKS = {'ros': r'import.*\b(ros_graph|live_node|rclpy)\b|^from (ros_graph|live_node) ',
         'torch': r'\b(torch|tiny_training|tiny_model|live_node|onnx)\b'}
FIXTURES = {'tiny_run': {'slow', 'torch'}, 'graph': {'ros'}, 'model': {'torch'}}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """
    Mark tests by what they import and use, and keep those together that share what is dear.

    One worker trains the tiny run for all tests that use it; else a file stays with one worker.
    """
    needs: dict[Path, set[str]] = {}
    for item in items:
        if item.path not in needs:
            text = item.path.read_text()
            needs[item.path] = {mark for mark, words in MARKS.items()
                                if re.search(words, text, re.MULTILINE)}
        fixtures = getattr(item, 'fixturenames', ())
        for mark in needs[item.path].union(*(FIXTURES.get(name, set()) for name in fixtures)):
            item.add_marker(mark)
        item.add_marker(pytest.mark.xdist_group(
            'tiny run' if 'tiny_run' in fixtures else str(item.path)))


@pytest.fixture(scope='session', autouse=True)
def ros_logs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Send the log files of all ROS nodes to a temporary folder."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv('ROS_LOG_DIR', str(tmp_path_factory.mktemp('ros_logs')))
        yield


@pytest.fixture(scope='module')
def one_thread() -> Iterator[None]:
    """Compute on one torch thread: of many small operations several would only wait."""
    import torch
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope='session')
def tiny_run(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Train once, in seconds: the TrainingRun; its scene lies in `scene` beside its `out`."""
    from tiny_training import train_tiny, write_tiny_scene
    folder = tmp_path_factory.mktemp('tiny_training')
    write_tiny_scene(folder / 'scene')
    return train_tiny(folder / 'scene', folder / 'out')


@pytest.fixture(scope='session')
def flat_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a scene of `write_tiny_scene` in a folder called flat; nobody writes there."""
    from tiny_training import write_tiny_scene
    folder = tmp_path_factory.mktemp('scenes') / 'flat'
    write_tiny_scene(folder)
    return folder
