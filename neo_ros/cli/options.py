"""Options that commands share, or that do not go together, and the command that comes next."""
import shlex
from typing import Annotated, Optional

from neo_ros.errors import ConfigError
import typer

ImageTopic = Annotated[Optional[str], typer.Option(
    help='Camera image, raw or compressed; default: the only one of the size the model takes.')]
InfoTopic = Annotated[Optional[str], typer.Option(
    help='The CameraInfo of the images, where it is not beside them.')]
Rectify = Annotated[bool, typer.Option(
    '--rectify', help='Take the distortion out of the images first.')]


def refuse(why: str, **options: object) -> None:
    """Raise ConfigError for options that were given (not None or False) and would be ignored."""
    given = [f'--{name.replace("_", "-")}' for name, value in options.items()
             if value is not None and value is not False]
    if given:
        raise ConfigError(f'{", ".join(given)}: {why}; leave it out')


def tell_next(*words: object) -> None:
    """Print a command as it can be pasted: on one line, however narrow the terminal is."""
    typer.echo('Next: ' + shlex.join(map(str, words)))
