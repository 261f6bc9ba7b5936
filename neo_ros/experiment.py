"""One YAML file is one experiment: every setting of a training, with its hash."""
from dataclasses import asdict, dataclass, replace
import hashlib
import json
import math
from pathlib import Path
from typing import Any

from neo_ros.baking.keyframes import MemoryConfig
from neo_ros.errors import ConfigError, GeometryError
from neo_ros.field.config import FieldConfig, FIT_NEAR
from neo_ros.geometry import Intrinsics, ViewExpansion
from neo_ros.outpaint.fitting import OutpaintConfig
from neo_ros.outpaint.network import NetworkConfig
from neo_ros.outpaint.networks import fitted_expansion, fitting_expansion
from neo_ros.scenes.pose_sampling import SamplingConfig
from pydantic import TypeAdapter, ValidationError
import yaml

# Settings that had another name once. Files that say the old one are read; hashes are taken with
# it, so that runs and model cards of before keep theirs.
RENAMED = {('network', 'hidden'): 'memory'}


@dataclass(frozen=True)
class ViewConfig:
    """
    Sizes in pixels at the resolution of the photos.

    The source is the middle of the photo, wherever its optical axis is; the target grows it by
    as many pixels on either side.
    """

    __pydantic_config__ = {'extra': 'forbid'}
    source: tuple[int, int]   # width, height of the image that the robot's camera gives
    target: tuple[int, int]   # width, height of the wide image

    def expansion(self, camera: Intrinsics) -> ViewExpansion:
        """Return the view in photos of a camera; GeometryError names the size that is wrong."""
        try:
            source = camera.middle(*self.source)
        except GeometryError as error:
            raise GeometryError(f'view.source: {error}') from error
        try:
            return ViewExpansion.to_size(source, *self.target)
        except GeometryError as error:
            reason = str(error).partition(': ')[2]  # Without the name that it has there.
            raise GeometryError(f'view.target: {reason}') from error


@dataclass(frozen=True)
class Experiment:
    """Everything that decides a training's result, beside the photos."""

    __pydantic_config__ = {'extra': 'forbid'}
    seed: int = 0   # one seed on one machine gives one model; on a GPU nearly
    # resolution of the wide images, relative to the photos; field and network may see less
    scale: float = 1.0
    # default: as the test frames say, else the photos, and twice that
    view: ViewConfig | None = None
    field: FieldConfig = FieldConfig()             # how the radiance field is fitted
    sampling: SamplingConfig = SamplingConfig()    # where wide training views are rendered
    network: NetworkConfig = NetworkConfig()       # which outpainter, and its size
    outpaint: OutpaintConfig = OutpaintConfig()    # how the outpainter is trained
    memory: MemoryConfig | None = MemoryConfig()   # null: the network works alone

    def __post_init__(self) -> None:
        if not 0 < self.scale < math.inf:
            raise ConfigError(f'scale: expected a number > 0, got {self.scale}')
        if not 0 <= self.seed < 2 ** 63:
            raise ConfigError(f'seed: expected 0 or more, below 2^63, got {self.seed}')

    @property
    def field_scale(self) -> float:
        """Resolution that the field is fitted at, relative to the photos."""
        return self.scale / self.field.shrink

    @property
    def network_scale(self) -> float:
        """Resolution that the network works at, relative to the photos."""
        return self.scale / self.network.shrink

    @property
    def config_hash(self) -> str:
        """Twelve hex digits that change with any setting."""
        settings = asdict(self)
        for (part, name), old in RENAMED.items():
            settings[part][old] = settings[part].pop(name)
        return _digest(settings)

    def sampling_area(self, mapped: bool) -> str:
        """Return where poses are drawn: walkable, photos or free_space; mapped: by a floor map."""
        if self.sampling.area != 'auto':
            return self.sampling.area
        return 'walkable' if mapped else 'photos'

    def field_config(self, mapped: bool) -> FieldConfig:
        """
        Return the settings of the field of a scene with a floor map, or of one without.

        On a floor a robot may pass a wall nearer than any photo was taken: what is empty before
        the lens is not found from the photos there.
        """
        if self.field.near is None and self.sampling_area(mapped) != 'photos':
            return replace(self.field, near=FIT_NEAR)
        return self.field

    def field_hash(self, mapped: bool) -> str:
        """Return twelve hex digits that change with what decides the field."""
        return _digest({'seed': self.seed, 'scale': self.scale,
                        'field': asdict(self.field_config(mapped))})

    def expansion(self, camera: Intrinsics, stated: ViewExpansion | None) -> ViewExpansion:
        """
        Return the view expansion at working resolution.

        camera is that of the photos; stated is what the scene's test frames say of themselves.
        """
        if self.view is not None:
            return self.view.expansion(camera).scaled(self.scale)
        if stated is not None:
            return fitted_expansion(stated, self.scale, self.network)
        return fitting_expansion(camera.scaled(self.scale), self.network)


def _digest(settings: dict[str, Any]) -> str:
    # Runs of before there were these go on: at their defaults they change nothing. (A scene with
    # measured depth has another list of photos.)
    for part, name, default in (('field', 'depth', FieldConfig.depth), ('field', 'shrink', 1),
                                ('field', 'vignetting', False), ('field', 'sharpness', 0.0),
                                ('field', 'robust', 0.0), ('field', 'tile', None),
                                ('network', 'shrink', 1), ('memory', 'minutes', None)):
        found = settings.get(part) or {}
        if name in found and found[name] == default:
            settings = {**settings, part: {key: found[key] for key in found if key != name}}
    exposure = settings.get('field', {}).get('exposure', True)
    if not exposure:
        # Left open it counts as false, the default when it could not be left open.
        settings = {**settings, 'field': {
            **settings['field'], 'exposure': False if exposure is None else 'never'}}
    text = json.dumps(settings, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def read_experiment(path: Path) -> Experiment:
    """Read an experiment file; raises ConfigError naming unknown keys and wrong values."""
    try:
        document: Any = yaml.load(path.read_text(), _OnceLoader)
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ConfigError(f'{path}: expected a YAML file: {error}') from error
    except ConfigError as error:
        raise ConfigError(f'{path}: {error}') from error
    return experiment_from({} if document is None else document, str(path))


class _OnceLoader(yaml.SafeLoader):
    """Refuses a key that is written twice: YAML takes the last, and drops the first silently."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set[str]()
        for key, _ in node.value:
            name = str(key.value)
            if name in seen:
                raise ConfigError(f'{name}: expected once, got it again in line '
                                  f'{key.start_mark.line + 1}; write all of it in one place')
            seen.add(name)
        return super().construct_mapping(node, deep)


def experiment_from(document: Any, name: str) -> Experiment:
    """Check the settings of an experiment; `name` says in errors where they come from."""
    try:
        return TypeAdapter(Experiment).validate_python(in_new_words(document, name))
    except ValidationError as error:
        raise ConfigError(f'{name}: ' + '; '.join(map(_in_words, error.errors()))) from error


def in_new_words(document: Any, name: str) -> Any:
    """Return settings as a file gave them, old names of `RENAMED` replaced by today's."""
    for (part, new), old in RENAMED.items():
        settings = document.get(part) if isinstance(document, dict) else None
        if not isinstance(settings, dict) or old not in settings:
            continue
        if new in settings:
            raise ConfigError(f'{name}: {part}.{old} is the old name of {part}.{new}: expected '
                              f'one of the two, got both; leave {part}.{old} out')
        document = {**document, part: {
            new if key == old else key: value for key, value in settings.items()}}
    return document


def _in_words(item: Any) -> str:
    own = item.get('ctx', {}).get('error')
    if isinstance(own, ConfigError):  # It names the setting and what came.
        return str(own)
    return f'{".".join(map(str, item["loc"]))}: {item["msg"]}, got {item["input"]!r}'
