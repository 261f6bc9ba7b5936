"""How the radiance field is fitted: the settings `field` of an experiment."""
from dataclasses import dataclass

from neo_ros.errors import ConfigError

DEVICES = ('auto', 'cpu', 'cuda', 'torch')
# Metres before the lens that the photos' rays leave out in a fit.
FIT_NEAR = 0.1
# What lies outside can only be a mistake.
LIMITS = {
    'shrink': (1, 64),
    'voxels': (1000, 1_000_000_000), 'steps': (10, 1_000_000_000), 'minutes': (1e-6, 1_000_000),
    'rays_per_step': (4, 10_000_000), 'margin': (1e-6, 1000), 'shell': (0, 10), 'near': (0, 100),
    'learning_rate': (1e-6, 10), 'distortion': (0, 1000), 'pointwise': (0, 1000),
    'sparsity': (0, 1000), 'depth': (0, 1000),
    'sharpness': (0, 10), 'robust': (0, 10), 'tile': (0.5, 1_000_000)}


@dataclass(frozen=True)
class FieldConfig:
    """How the field is fitted."""

    __pydantic_config__ = {'extra': 'forbid'}
    # The field sees the photos shrunk by this whole number; its voxels are coarser than pixels.
    shrink: int = 1
    # Grid points at the last stage, most of them in air: not kept. From nine million on a pixel is
    # fitted as the mean of four rays; give such a field ten minutes.
    voxels: int = 3_000_000
    steps: int = 6000               # optimiser steps; not read where `minutes` is given
    # Of fitting time, instead of steps; the result depends on the speed of the machine.
    minutes: float | None = None
    rays_per_step: int = 4096       # rays in a batch
    sh_degree: int = 0              # view dependence: 0 none (matt), 1 or 2 for shiny scenes
    margin: float = 3.0             # metres around the cameras that the first guess covers
    shell: float = 0.2              # relative thickness of the contracted outside
    # Metres before the lens that views and keyframes leave out. None: 0.1 on a floor; around
    # photos three quarters of the way to what any photo came nearest to, at most 0.5.
    near: float | None = None
    learning_rate: float = 0.1      # of density and colour, decayed to a tenth
    distortion: float = 0.01        # weight of the distortion loss
    pointwise: float = 0.05         # weight of the samples' own colour error
    sparsity: float = 1e-3          # weight of the samples' opacity: clears the air
    # Weight of measured depth, of photos that have a depth map; without any, of the depth that
    # photos tell of one another by stereo.
    depth: float = 0.1
    # One gain per photo and channel, for cameras with automatic exposure. None: where the photos
    # prove to need them.
    exposure: bool | None = None
    # One falloff towards the corners for the camera, cleared from what the field shows.
    vignetting: bool = False
    # 0: photos count alike; 1: as sharp as they are, compared with those before and after them
    sharpness: float = 0.0
    # error of a colour, of 1, beyond which a pixel loses weight: it shows no static scene; 0: off
    robust: float = 0.0
    # Metres that a tile is wide, at most: a floor two tiles wide and more is fitted tile by tile,
    # each with all of `voxels` and `steps`. None: 6 where there is a floor map, else no tiles.
    tile: float | None = None
    # cpu: compiled kernels; cuda; auto: cuda where there is one; torch: what cuda does, on the CPU
    device: str = 'auto'

    def __post_init__(self) -> None:
        if self.device not in DEVICES:
            raise ConfigError(f'field.device: expected {", ".join(DEVICES)}, got {self.device!r}')
        if self.sh_degree not in (0, 1, 2):
            raise ConfigError(f'field.sh_degree: expected 0, 1 or 2, got {self.sh_degree}')
        for name, (least, most) in LIMITS.items():
            value = getattr(self, name)
            if value is not None and not least <= value <= most:
                raise ConfigError(f'field.{name}: expected {least:_} ... {most:_}, got {value}')


def fit_near(view_near: float | None) -> float:
    """Return what the rays of photos leave out, metres, where views leave out `view_near`."""
    return FIT_NEAR if view_near is None else min(view_near, FIT_NEAR)
