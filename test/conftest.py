"""What tests share, and what holds for all: no clock in hypothesis, no logs at home."""
from collections.abc import Iterable, Iterator
import gc
import os
from pathlib import Path
import re
import shutil
import sys
from typing import Any

from hypothesis import settings
import pytest

# The machines that run the tests are shared: how long an example takes says nothing.
settings.register_profile('shared machine', deadline=None)
settings.load_profile('shared machine')
# Side by side a training has one thread: several would wait for one another most of the time.
os.environ.setdefault('LOCAL_WORLD_SIZE', os.environ.get('PYTEST_XDIST_WORKER_COUNT', '1'))
# What a file imports, and what fixtures a test uses, tell what it needs.
MARKS = {'ros': r'import.*\b(ros_graph|live_node|rclpy)\b|^from (ros_graph|live_node) ',
         'torch': r'^ *(import|from) (torch|onnx|tiny_training|tiny_graph|plain_field)\b'}
FIXTURES = {'tiny_run': {'slow', 'torch'}, 'flat_scene': {'torch'}, 'graph': {'ros'}}
# What the extra train brings; a robot has none of it.
TRAINER = {'onnx', 'onnxscript', 'pycolmap', 'pydantic', 'scipy', 'tensorboard', 'torch'}
# What a robot runs; their tests find neither torch nor onnx, here as there.
ROBOT_ROOMS = {'bags', 'geometry', 'machine', 'memory', 'messages', 'node', 'pictures', 'viewer'}


class RobotModule(pytest.Module):
    """A file of tests, skipped as a whole where it imports what only the trainer needs."""

    def collect(self) -> Iterable[pytest.Item | pytest.Collector]:
        try:
            return super().collect()
        except self.CollectError as error:
            missing = getattr(error.__cause__, 'name', None) or ''
            if missing.partition('.')[0] in TRAINER:
                pytest.skip(f'needs {missing}, of the extra train', allow_module_level=True)
            raise


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    """Let a robot's install, without torch and onnx, run all tests that it can."""
    return RobotModule.from_parent(parent, path=module_path)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """
    Mark tests by what they import and use.

    Several workers begin with the slow files: else one would end minutes after the others.
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
    if 'PYTEST_XDIST_WORKER' in os.environ:
        slow = {item.path for item in items
                if item.get_closest_marker('slow') or item.get_closest_marker('ros')}
        items.sort(key=lambda item: item.path not in slow)


def pytest_collection_finish() -> None:
    """
    Leave what was imported out of every garbage collection to come.

    Each ROS graph of a test begins with one, which would look at all of torch for half a second.
    """
    gc.freeze()


@pytest.fixture(scope='session', autouse=True)
def ros_logs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Send the log files of all ROS nodes to a temporary folder."""
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv('ROS_LOG_DIR', str(tmp_path_factory.mktemp('ros_logs')))
        yield


@pytest.fixture(scope='module', autouse=True)
def robots_install(request: pytest.FixtureRequest) -> Iterator[None]:
    """Hide torch and onnx from the tests of a robot's rooms: they use the models of test/data."""
    with pytest.MonkeyPatch.context() as modules:
        if request.path.parent.name in ROBOT_ROOMS:
            for name in ('torch', 'onnx'):
                modules.setitem(sys.modules, name, None)
        yield


@pytest.fixture(scope='module')
def one_thread() -> Iterator[None]:
    """Compute on one torch thread: of many small operations several would only wait."""
    import torch
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope='module')
def ray() -> Iterator[Any]:
    """One cluster for all tests of a file: it takes seconds to start, and its workers, too."""
    found = pytest.importorskip('ray', reason='needs Ray: the extra cluster is not installed')
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv('RAY_USAGE_STATS_ENABLED', '0')
        # Else they would wait for all other tests.
        environment.setenv('RAY_worker_niceness', '0')
        # Workers find the helpers of the tests as this process does.
        environment.setenv('PYTHONPATH', os.pathsep.join(path for path in sys.path if path))
        found.init(address='local', num_cpus=2, include_dashboard=False, logging_level='error',
                   log_to_driver=False, object_store_memory=100 << 20)
        yield found
        found.shutdown()


@pytest.fixture(scope='session')
def tiny_run(flat_scene: Path, tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Train once, in seconds: the TrainingRun; its scene lies in `scene` beside its `out`."""
    from tiny_training import train_tiny
    folder = tmp_path_factory.mktemp('tiny_training')
    shutil.copytree(flat_scene, folder / 'scene')
    return train_tiny(folder / 'scene', folder / 'out')


@pytest.fixture(scope='session')
def flat_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a scene of `write_tiny_scene` in a folder called flat; nobody writes there."""
    pytest.importorskip('torch')
    from tiny_training import write_tiny_scene
    folder = tmp_path_factory.mktemp('scenes') / 'flat'
    write_tiny_scene(folder)
    return folder
