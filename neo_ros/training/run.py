"""One run of the pipeline: what is trained, on which photos, and where its files go."""
from dataclasses import dataclass
from pathlib import Path

from neo_ros.errors import ConfigError
from neo_ros.evaluation.evaluate import TruthFrames
from neo_ros.experiment import Experiment
from neo_ros.field.config import FieldConfig
from neo_ros.field.given_geometry import GivenGeometry
from neo_ros.geometry import ViewExpansion
from neo_ros.machine.progress import StageProgress
from neo_ros.outpaint.networks import check_network, shrunk_expansion
from neo_ros.scenes.posed_images import PosedImages
from neo_ros.scenes.scene import Scene
from neo_ros.training.time_plan import TimePlan
import numpy as np


@dataclass(frozen=True)
class HoldOutRules:
    """Which photos are kept from the field's fit, to see how well it shows new views."""

    every: int = 25  # one photo in so many: of 250 ten, enough for a mean

    @property
    def least_photos(self) -> int:
        """With fewer photos none is held out."""
        return self.every // 2 + 1

    def chosen(self, photos: int) -> range:
        """Return which of so many photos are held out."""
        return range(self.every // 2, photos, self.every)


@dataclass
class TrainingRun:
    """
    One run of the pipeline: what is trained, where its files go, and who watches.

    Raises NeoError where view, network and test frames do not fit the photos.
    """

    scene: Scene
    experiment: Experiment
    out: Path
    progress: StageProgress
    cache_gb: float = 0.0         # of panoramas in files; 0: all of them are in memory
    seconds: float = 0.0
    samples: int = 0              # wide views that the outpainter saw
    outpaint_seconds: float = 0.0
    plan: TimePlan | None = None  # where the user gave minutes for all of it
    hold_out: HoldOutRules = HoldOutRules()
    geometry: GivenGeometry | None = None  # in the place of a fitted field
    cluster: bool = False         # hands tiles and keyframes to Ray
    view: ViewExpansion | None = None  # of the model, where an earlier run tells it

    def __post_init__(self) -> None:
        if not self.cache_gb >= 0:  # nan is neither, and would be no limit.
            raise ConfigError(f'--cache-gb: expected GB, 0 or more, got {self.cache_gb}')
        camera = self.scene.train.intrinsics
        self.expansion: ViewExpansion = self.view or self.experiment.expansion(
            camera, self.scene.expansion)
        held_out = set(self.hold_out.chosen(len(self.scene.train)))
        self.fitted = self.scene.train.subset(
            [i for i in range(len(self.scene.train)) if i not in held_out])
        self.held_out: PosedImages | None = (
            self.scene.train.subset(sorted(held_out)) if held_out else None)
        self._check_view()
        # What the network sees and shows; a model file resizes to and from it.
        self.network_expansion = shrunk_expansion(self.expansion, self.experiment.network)
        check_network(self.network_expansion, self.experiment.network)
        if self.scene.test is not None:
            TruthFrames(self.scene.test, self.expansion)
        self.figures: dict[str, float] = {}
        self.log: dict[str, list[list[float]]] = {
            'field': [], 'outpainter': [], 'validation': []}

    @property
    def model_path(self) -> Path:
        """Where the exported model goes."""
        return self.out / f'{self.scene.name}.onnx'

    @property
    def memory_path(self) -> Path:
        """Where the scene memory goes: beside the model."""
        return self.model_path.with_suffix('.memory')

    @property
    def sampling_area(self) -> str:
        """Where poses are drawn: walkable, photos or free_space."""
        return self.experiment.sampling_area(self.scene.walkable is not None)

    @property
    def field_config(self) -> FieldConfig:
        """The experiment's settings of the field, for this scene."""
        return self.experiment.field_config(self.scene.walkable is not None)

    def _check_view(self) -> None:
        photo = self.scene.train.intrinsics.scaled(self.experiment.scale)
        source = self.expansion.source
        rows, columns = photo.window(source)
        if (min(rows.start, columns.start) < 0
                or rows.stop > photo.height or columns.stop > photo.width):
            raise ConfigError(
                f'view.source: expected at most the size of the photos, {photo.width}x'
                f'{photo.height} pixels at this scale, got {source.width}x{source.height} from '
                f'{columns.start}, {rows.start} on')
        if not np.allclose([photo.fx, photo.fy], [source.fx, source.fy], rtol=1e-3):
            raise ConfigError(
                f'view: expected the focal length of the photos at this scale, {photo.fx:.1f} x '
                f'{photo.fy:.1f} pixels, got {source.fx:.1f} x {source.fy:.1f}; bring photos and '
                'test frames to one resolution, or take the test frames out of the scene')
