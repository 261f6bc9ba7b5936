"""Suites: which methods run on which scenes for how long, from a file in config/benchmark."""
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from neo_ros.benchmark.methods import check_methods
from neo_ros.benchmark.protocols import scale_within
from neo_ros.benchmark.workbench import Job
from neo_ros.errors import ConfigError
from neo_ros.flat.scene_writing import write_demo_scene
from neo_ros.machine.files import share_dir
from neo_ros.machine.names import listed
from neo_ros.scenes.scene import read_scene
from pydantic import TypeAdapter, ValidationError
import yaml

SPLITS_FILE = 'splits.json'
# The demo flat by the size of its photos: rendered where it is in no folder.
DEMO_SIZES = {'demo_flat': 128, 'demo_flat_256': 256}


@dataclass(frozen=True)
class SuiteScene:
    """
    How one scene is benchmarked.

    minutes is the training time of NEO; frames: score only so many, spread evenly; null: all.
    """

    __pydantic_config__ = {'extra': 'forbid'}
    protocol: str
    scale: str
    minutes: float
    frames: int | None = None
    settings: dict[str, Any] | None = None


@dataclass(frozen=True)
class EveryScene:
    """How all scene folders that a suite is given are benchmarked, whatever they are called."""

    __pydantic_config__ = {'extra': 'forbid'}
    protocol: str
    longest: int    # pixels of a photo's longer side: the scale follows from it
    minutes: float


@dataclass(frozen=True)
class Suite:
    """A file of config/benchmark: named scenes with frozen splits, or every folder it is given."""

    __pydantic_config__ = {'extra': 'forbid'}
    methods: list[str]
    settings: dict[str, Any]
    scenes: dict[str, SuiteScene] = field(default_factory=dict)
    folders: list[str] = field(default_factory=list)
    every: EveryScene | None = None


def config_folder() -> Path:
    """Return the folder of the suites and of the frozen splits."""
    return share_dir() / 'config' / 'benchmark'


def read_suite(name: str) -> Suite:
    """Read a suite by name; raises ConfigError for one that does not exist or is wrong."""
    path = config_folder() / f'{name}.yaml'
    if not path.is_file():
        known = ', '.join(sorted(found.stem for found in config_folder().glob('*.yaml')))
        raise ConfigError(f'suite: expected one of {known}, got {name!r}')
    try:
        suite = TypeAdapter(Suite).validate_python(yaml.safe_load(path.read_text()))
    except (yaml.YAMLError, ValidationError) as error:
        raise ConfigError(f'{path}: {error}') from error
    check_methods(suite.methods)
    return suite


def suite_jobs(suite: Suite, folders: list[Path]) -> dict[str, Job]:
    """
    Find the scenes of a suite; those in `folders` come before those that the suite names.

    The demo flat is where it was found, else in the first folder of the suite, where
    `prepare_demo` renders it. Raises ConfigError with the names of scenes that are missing, and
    for a suite of every scene without any.
    """
    if suite.every is not None:
        return _jobs_of_all(suite.every, suite.settings, folders)
    places = [*folders, *(Path(folder) for folder in suite.folders)]
    jobs, missing = {}, []
    for name, entry in suite.scenes.items():
        found = next((place / name for place in places
                      if (place / name / 'transforms_train.json').is_file()), None)
        if found is None and name in DEMO_SIZES:
            found = Path(suite.folders[0]) / name
        if found is None:
            missing.append(name)
            continue
        jobs[name] = Job(str(found), entry.protocol, entry.scale, entry.minutes,
                         most_frames=entry.frames,
                         settings=merged(suite.settings, entry.settings or {}))
    if missing:
        raise ConfigError(
            f'suite: the scenes {", ".join(missing)} are in none of the folders '
            f'{", ".join(map(str, places))}; name the one that holds them with --scenes')
    return jobs


def _jobs_of_all(every: EveryScene, settings: dict[str, Any], folders: list[Path]
                 ) -> dict[str, Job]:
    found = [scene for folder in folders for scene in (folder, *sorted(folder.glob('*/')))
             if (scene / 'transforms_train.json').is_file()]
    names = [scene.resolve().name for scene in found]
    if len(set(names)) < len(names) or not names:
        raise ConfigError(
            f'--scenes: expected scene folders, or folders of them, each of another name, got '
            f'{listed(names) if names else "none"} in {listed(list(map(str, folders)))}; '
            '`neo import CAPTURE SCENES/NAME --test-runs 3` makes one')
    jobs = {}
    for name, folder in zip(names, found):
        scene = read_scene(folder)
        if scene.test is None:
            raise ConfigError(f'{folder}: expected photos that are held back as test frames; '
                              'import it again with --test-runs 3')
        scale = scale_within(scene.train.intrinsics, every.longest)
        jobs[name] = Job(str(folder), every.protocol, scale, every.minutes,
                         settings=settings or None)
    return jobs


def prepare_demo(suite: Suite, jobs: dict[str, Job], progress: Any) -> None:
    """Render the demo flat of a suite that names it into its job's folder, if it is not there."""
    for name, size in DEMO_SIZES.items():
        if name in suite.scenes:
            write_demo_scene(Path(jobs[name].scene), image_size=size,
                             progress=lambda done, total: progress('demo flat', done, total, ''))


def merged(base: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Lay nested settings over others."""
    result = dict(base)
    for key, value in above.items():
        both = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merged(result[key], value) if both else value
    return result
