"""Options that commands share, or that do not go together, and the command that comes next."""
import math
from pathlib import Path
import re
import shlex
from typing import Annotated, Optional, TYPE_CHECKING

from neo_ros.errors import ConfigError
import typer

if TYPE_CHECKING:
    from neo_ros.geometry import Intrinsics

ImageTopic = Annotated[Optional[str], typer.Option(
    help='Camera image, raw or compressed; default: the only one of the size the model takes.')]
InfoTopic = Annotated[Optional[str], typer.Option(
    help='The CameraInfo of the images, where it is not beside them.')]
CameraInfo = Annotated[Optional[Path], typer.Option(
    help="A file with the calibration of the images instead: camera_calibration's YAML.")]
Rectify = Annotated[bool, typer.Option(
    '--rectify', help='Take the distortion out of the images first.')]


def refuse(why: str, **options: object) -> None:
    """Raise ConfigError for options that were given (not None or False) and would be ignored."""
    given = [f'--{name.replace("_", "-")}' for name, value in options.items()
             if value is not None and value is not False]
    if given:
        raise ConfigError(f'{", ".join(given)}: {why}; leave it out')


def camera_of(text: str) -> 'Intrinsics':
    """Return the camera that WIDTHxHEIGHT@DEGREES names; raises ConfigError for other words."""
    from neo_ros.geometry import Intrinsics

    match = re.fullmatch(r'(\d+)x(\d+)@(\d+(?:\.\d+)?)', text)
    if match is None or not 0 < float(match[3]) < 180 or min(int(match[1]), int(match[2])) < 16:
        raise ConfigError('--camera: expected WIDTHxHEIGHT@DEGREES, at least 16 pixels and below '
                          f'180 degrees, as 640x480@69, got {text!r}')
    return Intrinsics.from_hfov(int(match[1]), int(match[2]), math.radians(float(match[3])))


def tell_next(*words: object) -> None:
    """Print a command as it can be pasted: on one line, however narrow the terminal is."""
    typer.echo('Next: ' + shlex.join(map(str, words)))
